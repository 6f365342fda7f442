"""Fused weight-sharing kernels at the frame's resolution (Fan et al. 2021, section 4)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.families.box_filter import filter_rows
from stillray.families.cost import fused_kernels_cost
from stillray.families.depth_to_space import DepthToSpace
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.model_spec.decoders import FusedKernels
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import ImportanceNetwork
from stillray.stages.state import Filterable
from stillray.timing import timed_pass


class FusedKernelsModel(TemporalKernels):
    """A model of the family ``weight-sharing-kernels``."""

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, FusedKernels)
        assert isinstance(spec.network, ImportanceNetwork)
        self._options, self._block = spec.decoder, spec.network.block
        self.method = f"{len(spec.decoder.kernel_sizes)} fused kernels"
        self.cost = fused_kernels_cost(len(spec.decoder.kernel_sizes))
        field = sum(size // 2 for size in spec.network.kernel_sizes)
        looks = Looks(
            reach=max(spec.decoder.kernel_sizes) // 2,
            # and a pixel lies anywhere in its block
            receptive_field=self._block * field + self._block - 1,
            alignment=self._block,
        )
        super().__init__(spec, looks)

    def reconstruct(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """Filter and remodulate, see `TemporalKernels`."""
        (logits,) = outputs
        blocks = DepthToSpace(logits, strips) if self._block > 1 else None
        mean, by = light.mean, light.remodulation_albedo
        height, width = mean.shape[:2]
        image = np.empty((height, width, 3), np.float32)
        with timed_pass(timings) as part:

            def work(rows: slice) -> None:
                near, own = with_halo(rows, self.looks.reach, height)
                with part("reconstruct"):
                    given = logits[:, near] if blocks is None else blocks.near(near, width)
                    filter_rows(
                        mean[near], given, own, self._options, image[rows], strips.workspace
                    )
                if by is not None:
                    with part("remodulate"):
                        image[rows] *= by[rows]

            strips.run(work, height, width)
        return image
