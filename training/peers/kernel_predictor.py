"""A stream of frames through direct kernel prediction: a user's way of a frame, other kernels."""

from __future__ import annotations

import numpy as np

from stillray.denoiser import Denoiser
from stillray.prepare import Prepared
from stillray.strips import with_halo
from stillray.timing import timed
from stillray.training.peers.kernel_prediction import filter_rows, options_of


class KernelPredictor(Denoiser):
    """`stillray.Denoiser` of a network that gives a channel a kernel weight.

    Everything but the reconstruction is inherited: preparation, features, ONNX Runtime, history.
    Its file holds the specification of the shared-weight model that the peer stands beside, which
    is why such a file must not be given to `stillray.Denoiser`.
    """

    def _filter(
        self, prepared: Prepared, previous: np.ndarray | None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        options = options_of(self.model.spec)
        features = self._encode(self.model.spec, prepared, previous)
        with timed(self.last_timings, "network"):
            (logits,) = self._network.run(features)
        mean = prepared.history.mean
        height, width = mean.shape[:2]
        image = np.empty((height, width, 3), np.float32)

        def work(rows: slice) -> None:
            near, own = with_halo(rows, options.kernel_size // 2, height)
            image[rows] = filter_rows(mean[near], logits[:, near], own, options)

        with timed(self.last_timings, "reconstruct"):
            self._strips.run(work, height, width)
        if prepared.divisor is not None:
            with timed(self.last_timings, "modulate"):
                image *= prepared.divisor
        return image, [logits]
