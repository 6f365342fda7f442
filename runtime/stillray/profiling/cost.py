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

from stillray.families.cost import EXP, WINDOW_SUM
from stillray.families.feature_filters import FeatureFiltersModel
from stillray.families.online import OnlineModel
from stillray.families.registry import family_of
from stillray.families.temporal_kernels import TemporalKernels
from stillray.frame import Frame
from stillray.models.precision import integers_a_float
from stillray.models.registry import ModelInfo, find_model
from stillray.models.session import open_session
from stillray.pipeline.prefilter import PREFILTER, guides_of, prefilter_stages
from stillray.profiling.machine import PeakRates

_BYTES = 4  # of a float32
_CHANNELS = {
    "color": 3, "albedo": 3, "normal": 3, "depth": 1, "motion": 2, "roughness": 1,
    "specular_albedo": 3,
}  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Cost:
    """What has to be done.

    Attributes
    ----------
    operations
        A multiply-add is two.
    bytes
        Read from and written to memory.
    lanes
        Operations that are done in the place of one of float32.
    """

    operations: float
    bytes: float
    lanes: int = 1

    def roofline(self, peaks: PeakRates) -> float:
        """Milliseconds that a machine needs at least: for the dearer of both."""
        return 1e3 * max(
            self.operations / (self.lanes * peaks.operations), self.bytes / peaks.bandwidth
        )


def stage_costs(info: ModelInfo, frame: Frame, precision: str = "float32") -> dict[str, Cost]:
    """The work of every stage that a frame with a past may call for, by its name in the timings.

    Parameters
    ----------
    info
        The model. Of one that learns while it denoises network, regression and filter are known,
        of a frame graph, whose stages are not told apart, nothing.
    frame
        Its size and the buffers that it holds count, not its values.
    precision
        Of the network: ``"float32"`` or ``"int8"``.
    """
    if info.ports is not None:
        return {}
    family = family_of(info.spec)
    scale = family.traits.scale
    height, width = (size * scale for size in frame.shape)
    if isinstance(family, FeatureFiltersModel):
        network = _network(info, height, width, family.alignment)
        stages = _each_target_pixel(family, frame)
    elif isinstance(family, TemporalKernels):
        network = _network(info, height, width, family.traits.tile_alignment)
        stages = _each_pixel(family, frame)
        operations, planes = stages["reconstruct"]
        stages["reconstruct"] = (family.ensemble * operations, family.ensemble * planes)
        network = Cost(
            operations=family.ensemble * network.operations, bytes=family.ensemble * network.bytes
        )
    elif isinstance(family, OnlineModel):
        network = _network(info, height, width, family.alignment)
        stages = family.costs
    else:
        return {}
    if precision == "int8":
        # four bytes in a lane of a float, whether or not they are multiplied as fast
        lanes = integers_a_float()
        network = Cost(operations=network.operations, bytes=network.bytes / 4, lanes=lanes)
    pixels = height * width
    costs = {
        "network": network,
        **{
            name: Cost(operations=operations * pixels, bytes=_BYTES * planes * pixels)
            for name, (operations, planes) in stages.items()
        },
    }
    if frame.albedo is not None and any(s.runs for s in prefilter_stages(frame, info.spec)):
        prefilter = find_model(info.spec.prefilter.albedo)
        first = stage_costs(prefilter, guides_of(frame, frame.albedo), precision)
        costs[PREFILTER] = Cost(
            operations=sum(cost.operations / cost.lanes for cost in first.values()),
            bytes=sum(cost.bytes for cost in first.values()),
        )
    return costs


#: Of small lamps where none was lost: light times albedo, two luminances; for three sizes of blocks
#: the least sample and the largest pixel of the picture, of four comparisons each; which are lost.
LAMPS = (3 + 2 * 5 + 1 + 3 * 2 * 4 + 4 * 2, 4 + 3 + 3 + 2 + 2)
#: Of rare light two luminances, the picture around, how far above it and next to it, each limited
#: and halved thrice; of blocks nothing to speak of.
RARE_LIGHT = (2 * 5 + 4 + 2 + 1 + 2 * 2, 2 * 3 + 2)
#: Weight, luminance of the past, four planes halved; at half resolution and a third more of it,
#: four window sums, the error of a difference and what it leaves, twice at the finest.
REJECT_HISTORY = (8 + 5 + 7 + 4 + 1 / 3 * (4 * WINDOW_SUM + 2 * 14), 2 + 1 + 4 + 4 / 3 * 8)


def _each_target_pixel(family: FeatureFiltersModel, frame: Frame) -> dict[str, tuple[float, float]]:
    """Operations and planes of a stage, a pixel of the picture."""
    spec = family.spec
    share = 1 / family.scale**2  # pixels of the frame
    buffers = sum(_CHANNELS[name] for name in frame.given if name in _CHANNELS)
    surfaces = sum(_CHANNELS[name] for name in frame.given & {"normal", "depth", "roughness"})
    features = len(spec.network.features)
    enlarged = 3 + 3 + 3 + surfaces
    remembered = 4 * 4  # light, both albedos, the last output
    local = 3 + WINDOW_SUM + 1
    operations, planes = family.cost
    return {
        "inspect": (share * 2 * buffers, share * buffers),
        "repair": (share * 3 * buffers, share * 2 * buffers),
        # luminance, its surroundings, the bound of three channels
        "expose": (share * (5 + local + 3), share * (3 + 1 + 3)),
        "enlarge": (0, share * buffers + enlarged),
        # nine depths looked at; of what is remembered four taps
        "warp": (share * 9 * 2 + 8 + 4 * 2 * remembered, share * 3 + 2 * remembered),
        # means of the past's pixels; what is let go of it is next to nothing
        "reject_history": (4 + share * REJECT_HISTORY[0], 4 + share * REJECT_HISTORY[1]),
        # nine channels toned, counts as sines and cosines
        "encode": (9 * (4 + EXP) + 10 * EXP, enlarged + remembered + features),
        "reconstruct": (operations, planes),
        "lamps": (share * LAMPS[0] + 3, 3 + share * LAMPS[1]),
        # of a picture of the frame's size
        "rare_light": (3 + share * RARE_LIGHT[0], 3 + share * RARE_LIGHT[1]),
        "remember": (EXP, 2 * remembered),
    }


def _each_pixel(family: TemporalKernels, frame: Frame) -> dict[str, tuple[float, float]]:
    """Operations and planes of a stage, a pixel."""
    spec = family.spec
    albedo = 3 if frame.albedo is not None else 0
    surfaces = sum(
        _CHANNELS[name] for name in ("normal", "depth") if getattr(frame, name) is not None
    )
    features = len(spec.network.features)
    buffers = sum(_CHANNELS[name] for name in frame.given if name in _CHANNELS)
    local = 3 + WINDOW_SUM + 1  # tone map, window, scale
    operations, planes = family.cost
    return {
        "inspect": (2 * buffers, buffers),
        "repair": (3 * buffers, 2 * buffers),
        # of some rows and columns alone; next to nothing
        "find_filter": (1, buffers / 8),
        # limit, divide and luminance
        "demodulate": (2 * albedo + 3 + 5, 3 + 2 * albedo + 1),
        "expose": (local + 2, 2),
        "reject_history": REJECT_HISTORY,
        # two images toned and halved; at half resolution, a depth: positions, a tap, a window sum
        "specular_motion": (
            2 * (5 + 4 + 1) + 4 / 4 * (4 + 9 + 2 + WINDOW_SUM),
            4 + 1 + albedo + 1 + 2 + 2,
        ),
        "surface_guides": (7, surfaces + 4),
        # four taps of history and surface guides, and the test of each
        "reproject": (4 * (2 * 8 + 9) + 12, 2 + 4 + 4 + 4),
        # weight, running mean of three channels, local luminance
        "accumulate": (8 + 3 * 4 + local + 5, 3 + albedo + 2 + 4 + 2),
        # four taps, the least and the most of nine, limits and the mean, of each channel
        "accumulate_albedo": (3 * (4 * 2 + 4 + 4 + 2 + 3), albedo + 2 + 4 + 4 + albedo),
        "resample_output": (4 * 2 * 4 + 6, 2 + 4 + 4),
        "encode": (3 * (4 + EXP) + 4 + 2, 4 + 1 + albedo + surfaces + features),
        "reconstruct": (operations, planes),
        "remodulate": (3, 3),
        "lamps": LAMPS,
        "rare_light": RARE_LIGHT,
        # three window sums, what pixels count, two luminances and what was taken; fifteen products
        # and their sums; three slopes between blocks, the gain of three channels
        "relief": (
            3 * (WINDOW_SUM + 2) + (9 + EXP) + (WINDOW_SUM + 5) + 2 * 5 + 4 + 15 * 2 + 3 * 7 + 4,
            3 + albedo + surfaces + 1 + 3,
        ),
        # an albedo smoothed, its luminance, inverse and window sum; the light's product and
        # luminance, that of the picture, what was taken; six products and their sums, the gain
        "texture": (
            3 * 10 + 5 + 1 + WINDOW_SUM + 1 + 3 + 2 * 5 + 4 + 6 * 2 + 7 + 4 + 3,
            albedo + albedo + 4 + 3 + 1 + 3,
        ),
        "keep_output": (0, 3 + 4),
    }


def _network(info: ModelInfo, height: int, width: int, multiple: int) -> Cost:
    """The work of a network on a frame rounded up to a multiple of pixels."""
    # work is proportional to the pixels, so that a small frame tells
    side = max(multiple, 16)
    small = network_cost(info.path, side, side)
    full = (-(-height // multiple) * multiple) * (-(-width // multiple) * multiple)
    scale = full / side**2
    return Cost(operations=small.operations * scale, bytes=small.bytes * scale)


def network_cost(path: Path, height: int, width: int) -> Cost:
    """Cost of a network's convolutions for one input, from the shapes that ONNX Runtime reports.

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
    return Cost(operations=operations, bytes=moved)
