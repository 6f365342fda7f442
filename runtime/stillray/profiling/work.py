"""What a stage has to do at least: operations and bytes, and so the time that no code goes below.

Counts are of the method, not of its code: each plane that a stage needs is read or written once,
and a window's sum is two additions an axis however large the window is.
"""

from __future__ import annotations

import json
import tempfile
from dataclasses import dataclass
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from stillray.families.pyramid_logits import level_logits
from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.model_spec.loader import BilateralGrids, FusedKernels, ModelSpec, PyramidKernels
from stillray.models.registry import ModelInfo
from stillray.models.session import open_session
from stillray.profiling.machine import Peaks

_BYTES = 4  # of a float32
_CHANNELS = {"color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2}
_WINDOW_SUM = 4  # operations: one value comes in and one goes out, along each axis
_EXP = 1  # operations of an exponential, a root or a logarithm: instructions of their own in time


@dataclass(frozen=True, kw_only=True)
class Work:
    """What has to be done.

    Attributes
    ----------
    operations
        Float32 operations; a multiply-add is two.
    bytes
        Read from and written to memory.
    """

    operations: float
    bytes: float

    def floor(self, peaks: Peaks) -> float:
        """Milliseconds that a machine needs at least: for the dearer of both."""
        return 1e3 * max(self.operations / peaks.operations, self.bytes / peaks.bandwidth)


def stage_work(info: ModelInfo, frame: Frame) -> dict[str, Work]:
    """The work of every stage that a frame with a past may call for, by its name in the timings.

    Parameters
    ----------
    info
        The model.
    frame
        Its size and the buffers that it holds count, not its values.
    """
    pixels = frame.shape[0] * frame.shape[1]
    return {
        "network": _network(info, *frame.shape),
        **{
            name: Work(operations=operations * pixels, bytes=_BYTES * planes * pixels)
            for name, (operations, planes) in _each_pixel(info.spec, frame).items()
        },
    }


def _each_pixel(spec: ModelSpec, frame: Frame) -> dict[str, tuple[float, float]]:
    """Operations and planes of a stage, a pixel."""
    albedo = 3 if frame.albedo is not None else 0
    guides = sum(
        _CHANNELS[name] for name in ("normal", "depth") if getattr(frame, name) is not None
    )
    features = len(spec.network.features)
    buffers = sum(_CHANNELS[name] for name in frame.given if name in _CHANNELS)
    local = 3 + _WINDOW_SUM + 1  # tone map, window, scale
    operations, planes = _RECONSTRUCTION[spec.family](spec)
    return {
        "repair": (2 * buffers, buffers),
        # limit, divide and luminance; color and albedo are in the cache, which repair has read
        "demodulate": (2 * albedo + 3 + 5, albedo + 1),
        "expose": (local + 2, 2),
        # two images toned and halved; at half resolution, a depth: positions, a tap, a window sum
        "mirror": (2 * (5 + 4 + 1) + 4 / 4 * (4 + 9 + 2 + _WINDOW_SUM), 4 + 1 + albedo + 1 + 2 + 2),
        "guides": (7, guides + 4),
        # four taps of history and guides, and the test of each
        "warp": (4 * (2 * 8 + 9) + 12, 2 + 4 + 4 + 4),
        # weight, running mean of three channels, local luminance
        "accumulate": (8 + 3 * 4 + local + 5, 3 + albedo + 2 + 4 + 2),
        # four taps, the least and the most of nine, limits and the mean, of each channel
        "antialias": (3 * (4 * 2 + 4 + 4 + 2 + 3), albedo + 2 + 4 + 4 + albedo),
        "recall": (4 * 2 * 4 + 6, 2 + 4 + 4),
        "encode": (3 * (4 + _EXP) + 4 + 2, 4 + 1 + albedo + guides + features),
        "reconstruct": (operations, planes),
        "modulate": (3, 3),
    }


def _kernels(spec: ModelSpec) -> tuple[float, float]:
    assert isinstance(spec.decoder, FusedKernels)
    maps = len(spec.decoder.kernel_sizes)
    # two exponentials, importance, sums of it and of three channels, the share, three additions
    one = 2 * _EXP + 1 + 3 + 4 * _WINDOW_SUM + 1 + 3 * 2 + 1
    return maps * one + 3, 2 * maps + 4 + 3


def _pyramid(spec: ModelSpec) -> tuple[float, float]:
    assert isinstance(spec.decoder, PyramidKernels)
    levels = FAMILIES[spec.family].multiple(spec).bit_length()
    operations, planes = 0.0, 3.0 + 3.0 + 4.0  # divisor, image, the previous output
    for level in range(levels):
        share = 0.25**level
        logits = level_logits(level, levels, spec.decoder)
        maps = len(spec.decoder.kernel_sizes) if level or spec.decoder.finest_kernels else 0
        # kernels as above; itself and the coarser level; what is pooled; four pixels for one, with
        # their shares and of each channel three products
        kernels = maps * (1 + 3 + 4 * _WINDOW_SUM + 1 + 3 * 2 + 1)
        doubled = 4 * (6 + 3 * 5) if level else 0
        neighbours = 8 * (1 + 3 * 2) if level and spec.decoder.predicted else 0
        operations += share * (logits * _EXP + kernels + 3 * 4 + 4 * 2 + doubled + neighbours)
        planes += share * (logits + 4 + 4)  # light read and the level's result written
    resolve = 9 * (1 + 3 * 2) + 3 + 3  # eight neighbours and the past; normalised, modulated
    return operations + resolve, planes


def _grids(spec: ModelSpec) -> tuple[float, float]:
    from stillray.families.bilateral_grid import grid_cells

    assert isinstance(spec.decoder, BilateralGrids)
    operations, planes = 3.0, 4.0 + 3.0  # modulated; light and image
    for scale in range(spec.decoder.grids):
        spacing = spec.decoder.spacing << scale
        cells = grid_cells(1, 1, spec.decoder, scale)[2] / spacing  # of a slab, a pixel
        corners = 2 * (2 - 1 / spacing)  # those beside a pixel in its row's slab, one depth or two
        # splatted, added up; interpolated, read; guide, two depths, share and blend of each channel
        operations += 2 * (corners * 4 * 2) + cells * 4 * (4 + 3) + 10 + 4 * 8
        planes += 2 * (1 + 4 + 4 * cells) + 1
    return operations, planes


def _multires(spec: ModelSpec) -> tuple[float, float]:
    operations, planes = 0.0, 0.0
    coarsest = FAMILIES[spec.family].multiple(spec).bit_length() - 1
    filtered, moved = _kernels(spec)
    for level in range(coarsest + 1):
        share = 0.25**level
        operations += share * filtered
        planes += share * moved
        if level < coarsest:
            # weighted means for the coarser level; the share that gives way, and of each channel
            # a block's mean, least and most, the step to the coarser level and two limits
            operations += share * (3 + 4 + _EXP + 2 + 3 * (3 + 2 + 2))
            planes += share * (1 + 3 / 4)
    return operations, planes


_RECONSTRUCTION = {
    "weight-sharing-kernels": _kernels,
    "kernel-pyramid": _pyramid,
    "multi-resolution-kernels": _multires,
    "bilateral-grids": _grids,
}


def _network(info: ModelInfo, height: int, width: int) -> Work:
    multiple = FAMILIES[info.spec.family].multiple(info.spec)
    # work is proportional to the pixels, so that a small frame tells
    side = max(multiple, 16)
    small = network_work(info.path, side, side)
    full = (-(-height // multiple) * multiple) * (-(-width // multiple) * multiple)
    scale = full / side**2
    return Work(operations=small.operations * scale, bytes=small.bytes * scale)


def network_work(path: Path, height: int, width: int) -> Work:
    """Work of a network's convolutions for one input, from the shapes that ONNX Runtime reports.

    What is element-wise can be done while a convolution's result is at hand, and counts nothing.

    Parameters
    ----------
    path
        The .onnx file of a network alone.
    height, width
        Of its input, pixels. It is run at that size, unoptimised.

    Raises
    ------
    InputError
        The file cannot be loaded.
    """
    with tempfile.TemporaryDirectory() as folder:
        session = open_session(path, threads=1, trace=Path(folder) / "trace")
        (source,) = session.get_inputs()
        session.run(None, {source.name: np.zeros((1, source.shape[1], height, width), np.float32)})
        events = json.loads(Path(session.end_profiling()).read_text())
    operations = moved = 0
    for event in events:
        facts: dict[str, Any] = event.get("args", {})
        if facts.get("op_name") != "Conv" or not facts.get("input_type_shape"):
            continue
        (taken, weights), (given,) = (
            [shape for typed in facts[key] for shape in typed.values()][:2]
            for key in ("input_type_shape", "output_type_shape")
        )
        # every output element is a sum over input channels and the kernel's window
        operations += 2 * prod(given) * prod(weights[1:])
        moved += _BYTES * (prod(taken) + prod(given))
    return Work(operations=operations, bytes=moved)
