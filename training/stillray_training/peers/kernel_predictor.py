"""A stream of frames through direct kernel prediction: a user's way of a frame, other kernels."""

from __future__ import annotations

import numpy as np

from stillray.pipeline.denoiser import Denoiser
from stillray.stages.prepare import Prepared
from stillray.timing import timed
from stillray_training.peers import kernel_prediction, multi_resolution_prediction

#: By the family of the model that the peer stands beside.
_RECONSTRUCTIONS = {
    "weight-sharing-kernels": kernel_prediction.reconstruct,
    "multi-resolution-kernels": multi_resolution_prediction.reconstruct,
}


class KernelPredictor(Denoiser):
    """`stillray.Denoiser` of a network that gives a channel a kernel weight.

    Everything but the reconstruction is inherited: preparation, features, ONNX Runtime, history.
    Its file holds the specification of the shared-weight model that the peer stands beside, which
    is why such a file must not be given to `stillray.Denoiser`.
    """

    def _filter(
        self, prepared: Prepared, previous: np.ndarray | None
    ) -> tuple[np.ndarray, list[np.ndarray]]:
        spec = self.model.spec
        features = self._encode(spec, prepared, previous)
        with timed(self.last_timings, "network"):
            outputs = self._network.run(features)
        image = _RECONSTRUCTIONS[spec.family](
            prepared, previous, outputs, spec, self._strips, self.last_timings
        )
        return image, outputs
