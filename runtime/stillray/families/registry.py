"""What differs between families of models in the runtime: one reconstruction each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stillray.arrays.strips import Strips
from stillray.families import bilateral_grid as grid
from stillray.families import box_filter as kernels
from stillray.families import kernel_pyramid as pyramid
from stillray.families import multi_resolution as multires
from stillray.model_spec.loader import ModelSpec
from stillray.stages.prepare import Prepared


@dataclass(frozen=True)
class Family:
    """One family of models.

    Attributes
    ----------
    reconstruct
        From a prepared frame, the previous output at its pixels (or None), the network's outputs
        without their batch axis, the specification, where to run and the timings to fill in, to
        the ``(h, w, 3)`` float32 radiance.
    multiple
        Height and width of the network's input must be multiples of this, pixels.
    reach
        Pixels from which light can come to a pixel, to each side, in one frame.
    receptive_field
        Pixels that one output of the network looks to each side; None where a frame cannot be cut
        into tiles, because what it is built from spans all of it.
    recalls
        Whether the previous output is used.
    renews
        Whether this frame's sample is used beside what was accumulated.
    method
        What the reconstruction does, in a few words.
    settle
        From a prepared frame, the network's outputs, the specification and where to run, to the
        outputs by which `reconstruct` filters other layers as it filters the frame's light. None
        where the outputs say it all, whatever light they meet.
    """

    reconstruct: Callable[
        [
            Prepared,
            np.ndarray | None,
            Sequence[np.ndarray],
            ModelSpec,
            Strips,
            dict[str, float],
        ],
        np.ndarray,
    ]
    multiple: Callable[[ModelSpec], int]
    reach: Callable[[ModelSpec], int]
    receptive_field: Callable[[ModelSpec], int] | None
    recalls: bool
    renews: bool
    method: Callable[[ModelSpec], str]
    settle: (
        Callable[[Prepared, Sequence[np.ndarray], ModelSpec, Strips], Sequence[np.ndarray]] | None
    ) = None


#: By the name that specifications use.
FAMILIES = {
    "weight-sharing-kernels": Family(
        kernels.reconstruct,
        kernels.multiple,
        kernels.reach,
        kernels.receptive_field,
        recalls=False,
        renews=False,
        method=kernels.method,
    ),
    "kernel-pyramid": Family(
        pyramid.reconstruct,
        pyramid.multiple,
        pyramid.reach,
        pyramid.receptive_field,
        recalls=True,
        renews=True,
        method=pyramid.method,
    ),
    "multi-resolution-kernels": Family(
        multires.reconstruct,
        pyramid.multiple,
        multires.reach,
        pyramid.receptive_field,
        recalls=False,
        renews=False,
        method=multires.method,
        settle=multires.settle,
    ),
    "bilateral-grids": Family(
        grid.reconstruct,
        lambda spec: 1,
        grid.reach,
        None,
        recalls=False,
        renews=False,
        method=grid.method,
    ),
}
