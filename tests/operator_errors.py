"""Every numeric operator of the runtime beside its definition in float64.

Each operator draws its inputs as named float32 arrays, says how far any of their values may be
moved, and gives its largest error for them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stillray.arrays.strips import Strips, planes_of
from stillray.families import box_filter as kernels
from stillray.families import kernel_pyramid as pyramid
from stillray.families import pyramid_logits as pyramid_layout
from stillray.model_spec import load
from stillray.model_spec.decoders import FusedKernels, PyramidKernels
from stillray.stages import (
    accumulate,
    albedo_history,
    demodulate,
    previous_output,
    repair,
    reproject,
)
from stillray.stages import features as encode
from stillray.stages.state import Filterable
from tests import oracles

Inputs = dict[str, np.ndarray]
SPEC = load("wskp-3s")
_STRIPS = Strips(1)
_MAX = repair.MAX_RADIANCE


@dataclass(frozen=True, kw_only=True)
class Operator:
    """One operator.

    Attributes
    ----------
    name
        As the table names it.
    ranges
        Of each array's values: shape, least, largest, and whether they are spread over orders of
        magnitude.
    error
        Largest error, relative unless ``unit`` says otherwise.
    limit
        What the error must stay below: rounding of float32, as often as it happens.
    unit
        What the error is measured in.
    """

    name: str
    ranges: dict[str, tuple[tuple[int, ...], float, float, bool]]
    error: Callable[[Inputs], float]
    limit: float
    unit: str = "relative"

    def values(self, name: str, rng: np.random.Generator, count: int) -> np.ndarray:
        """So many values that an array may hold."""
        _, low, high, logarithmic = self.ranges[name]
        if logarithmic:
            return np.exp(rng.uniform(np.log(low), np.log(high), count)).astype(np.float32)
        return rng.uniform(low, high, count).astype(np.float32)

    def draw(self, rng: np.random.Generator) -> Inputs:
        """Random inputs."""
        return {
            name: self.values(name, rng, int(np.prod(shape))).reshape(shape)
            for name, (shape, *_) in self.ranges.items()
        }


def _relative(got: np.ndarray, wanted: np.ndarray) -> float:
    """Largest error relative to what is wanted; not finite where it should be is infinite."""
    got = np.asarray(got, np.float64)
    if not np.isfinite(got).all():
        return float("inf")
    # below the smallest normal float32 there are fewer digits
    return float((np.abs(got - wanted) / np.maximum(np.abs(wanted), 1e-37)).max())


def _absolute(got: np.ndarray, wanted: np.ndarray) -> float:
    got = np.asarray(got, np.float64)
    return float(np.abs(got - wanted).max()) if np.isfinite(got).all() else float("inf")


def _repair(given: Inputs) -> float:
    color = given["color"].copy()
    broken = given["broken"] < given["share"]
    if broken.all():
        broken[0, 0] = False
    color[broken] = np.nan
    got, _ = repair.repair_radiance(color)
    wanted = color.astype(np.float64)
    for y, x in np.argwhere(broken):
        reach = 1
        while True:
            window = (slice(max(y - reach, 0), y + reach + 1),
                      slice(max(x - reach, 0), x + reach + 1))  # fmt: skip
            if (~broken[window]).any():
                wanted[y, x] = color[window][~broken[window]].astype(np.float64).mean(0)
                break
            reach *= 2
    return _relative(got, wanted)


def _divisor(given: Inputs) -> float:
    albedo, options = given["albedo"], SPEC.demodulate
    got = demodulate.demodulation_albedo(albedo, options)
    wanted = np.clip(albedo.astype(np.float64), options.floor, 1)
    wanted[(albedo <= options.black).all(-1)] = 1
    return _relative(got, wanted)


def _modulate(given: Inputs) -> float:
    by = demodulate.demodulation_albedo(given["albedo"], SPEC.demodulate)
    return _relative(given["radiance"] / by * by, given["radiance"].astype(np.float64))


def _expose(given: Inputs) -> float:
    light = given["light"]
    height, width = light.shape
    blocks = light.astype(np.float64).reshape(height // 8, 8, width // 8, 8).mean((1, 3))
    wanted = SPEC.transfer.middle / np.median(blocks)
    return _relative(np.float64(encode.frame_exposure(light, SPEC.transfer)), wanted)


def _luminance(given: Inputs) -> float:
    wanted = given["color"].astype(np.float64) @ [0.2126, 0.7152, 0.0722]
    return _relative(encode.luminance(given["color"]), wanted)


def _tone(light: np.ndarray, exposure: float) -> np.ndarray:
    exposed = light.astype(np.float64) * np.float64(np.float32(exposure))
    return exposed / (1 + exposed)


def _tone_map(given: Inputs) -> float:
    return _absolute(encode.tone_map(given["light"], 1.5), _tone(given["light"], 1.5))


def _local(given: Inputs) -> float:
    toned, size = given["toned"], SPEC.transfer.local_size
    padded = np.pad(toned.astype(np.float64), size // 2, mode="edge")
    windows = np.lib.stride_tricks.sliding_window_view(padded, (size, size))
    return _relative(encode.local_luminance(toned, SPEC.transfer), windows.mean((2, 3)))


def _weight(given: Inputs) -> float:
    light, local, held = given["light"], given["local"], given["held"]
    got = accumulate.sample_weight(light, local, held, 1.5, SPEC.temporal)
    toned = np.clip(local.astype(np.float64), 0, 0.9999)
    ratio = accumulate.FIRST_SHARE * SPEC.temporal.outlier_ratio
    many = 1 + held.astype(np.float64)
    relative = light.astype(np.float64) * 1.5
    relative /= ratio * many * (toned / (1 - toned) + accumulate.DARK)
    return _relative(got, 1 / (1 + relative**2 / (1 + relative)))


def _accumulate(given: Inputs) -> float:
    planes = np.concatenate([given["past"], given["held"]]).copy()
    light, weight = given["light"], given["weight"]
    accumulate.accumulate(planes_of(light), weight, planes, SPEC.temporal)
    past = np.minimum(given["held"][0].astype(np.float64), SPEC.temporal.max_samples)
    total = past + weight
    wanted = np.einsum("cyx,yx->cyx", given["past"].astype(np.float64), past / total)
    wanted += np.einsum("yxc,yx->cyx", light.astype(np.float64), weight / total)
    return max(_relative(planes[:3], wanted), _relative(planes[3], total))


def _features(given: Inputs) -> float:
    names = ("irradiance.r", "samples", "depth")
    mean = np.dstack([given["light"]] * 3 + [given["held"]])
    out = np.empty((3, *given["light"].shape), np.float32)
    inputs = encode.FeatureInputs(
        mean=mean, local=given["local"], exposure=1.5, sample=given["light"],
        depth=given["depth"], depth_unit=3.0,
    )  # fmt: skip
    encode.feature_planes(inputs, SPEC.temporal, names, out=out)
    held, depth = given["held"].astype(np.float64), given["depth"].astype(np.float64)
    samples = np.sqrt(held / (held + SPEC.temporal.max_samples / 4))
    wanted = np.array([np.sqrt(_tone(given["light"], 1.5)), samples, depth / (depth + 3)])
    return _absolute(out, wanted)


def _reproject(given: Inputs) -> float:
    shape = given["at"].shape[:2]
    # two surfaces that no rounding confuses, and fractions of pixels that are exact
    normal = np.where(given["side"][..., None] > 0.1, [0.0, 0, 1], [1.0, 0, 0]).astype(np.float32)
    before = np.where(given["side_before"][..., None] > 0.1, [0.0, 0, 1], [1.0, 0, 0])
    before = before.astype(np.float32)
    depth = np.ones(shape, np.float32)
    motion = np.round(given["at"] * 256) / np.float32(256)
    history = np.dstack([given["past"], given["held"]])
    packed = reproject.pack(before, depth)
    discontinuous = np.zeros((shape[0] + 1, shape[1] + 1), np.uint8)
    rows = slice(0, shape[0])
    reproject.mark_discontinuities(packed, rows, discontinuous)
    positions = reproject.positions_of(motion, rows)
    now = planes_of(reproject.pack(normal, depth))
    got = reproject.reproject(
        reproject.PreviousFrame(history, packed, discontinuous), now, positions, rows, SPEC.temporal
    )
    wanted = oracles.reproject(history, before, depth, normal, depth, motion, SPEC.temporal)
    return _relative(got, wanted)


def _positions(given: Inputs, steps: int) -> np.ndarray:
    """Where each pixel was, rounded to so many steps a pixel."""
    motion = np.round(given["at"] * steps) / np.float32(steps)
    return reproject.positions_of(motion, slice(0, motion.shape[0]))


def _resample(given: Inputs) -> float:
    output = previous_output.keep(given["past"], _STRIPS)
    positions = _positions(given, 256)
    got = previous_output.resample(output, positions, _STRIPS)
    height, width = output.shape[:2]
    wanted = np.zeros(output.shape)
    for y, x in np.ndindex(height, width):
        at_x, at_y = map(float, positions[y, x])
        left, top = int(np.floor(at_x)), int(np.floor(at_y))
        for ty, tx in ((top, left), (top, left + 1), (top + 1, left), (top + 1, left + 1)):
            if 0 <= ty < height and 0 <= tx < width:
                share = (1 - abs(at_x - tx)) * (1 - abs(at_y - ty))
                wanted[y, x] += share * output[ty, tx].astype(np.float64)
    whole = np.maximum(wanted[..., 3:], 1e-3)  # below, light fades instead of being normalised
    wanted[..., :3] /= np.where(wanted[..., 3:] > 0, whole, 1)
    return _relative(got, wanted)


def _accumulate_albedo(given: Inputs) -> float:
    by = demodulate.demodulation_albedo(given["albedo"], SPEC.demodulate)
    before = demodulate.demodulation_albedo(given["before"], SPEC.demodulate)
    past, positions = previous_output.keep(before, _STRIPS), _positions(given, 256)
    samples = SPEC.temporal.albedo_samples
    got, picture = np.empty_like(past), np.empty_like(by)
    albedo_history.accumulate(by, past, samples, positions, (got, picture), _STRIPS)
    wanted, _ = oracles.accumulated_albedo(by, past, samples, positions)
    return _relative(got, wanted)


def _sharp_resample(given: Inputs) -> float:
    output = previous_output.keep(given["past"], _STRIPS)
    positions = _positions(given, 32)  # what cubic convolution rounds to itself
    got = previous_output.resample(output, positions, _STRIPS, sharp=True)
    wanted, brightest = oracles.sharp_resample(output, positions)
    return float((np.abs(got - wanted).max(-1) / np.maximum(brightest, 1e-30)).max())


_KERNELS = load("wskp-6").decoder
_PYRAMID = load("kpyr-5").decoder


def _fused_kernels(given: Inputs) -> float:
    assert isinstance(_KERNELS, FusedKernels)
    mean = np.dstack([given["light"], given["held"]])
    got = kernels.filter_rows(mean, given["logits"], slice(0, mean.shape[0]), _KERNELS)
    wanted = oracles.fused_kernels(given["light"], given["held"], given["logits"], _KERNELS)
    return _relative(got, wanted)


def _pyramid(given: Inputs) -> float:
    assert isinstance(_PYRAMID, PyramidKernels)
    mean, sample = (np.dstack([given[n], given["held"]]) for n in ("light", "new"))
    sample = planes_of(sample)
    by = demodulate.demodulation_albedo(given["albedo"], SPEC.demodulate)
    past = np.dstack([given["past"], given["valid"]])
    logits, start = [], 0
    for level in range(2):
        count = pyramid_layout.level_logits(level, 2, _PYRAMID)
        size = tuple(extent >> level for extent in mean.shape[:2])
        part = given["logits"][start : start + count * size[0] * size[1]]
        logits.append(part.reshape(count, *size))
        start += part.size
    light = Filterable(mean=mean, sample=sample, remodulation_albedo=by, previous=past)
    got = pyramid.filter_pyramid(light, logits, _PYRAMID, _STRIPS)
    wanted = oracles.kernel_pyramid(mean, sample, by, past, logits, _PYRAMID)
    return _relative(got, wanted)


def _fuse(given: Inputs) -> float:
    """A block's branches, fused into one convolution in float32, beside the branches in float64."""
    import torch

    from stillray_training.networks.fuse import fuse
    from stillray_training.networks.repvgg import RepVGGBlock, by_branches

    block = RepVGGBlock(4, 4, (3, 1), identity=True, activation=True)
    weights = torch.from_numpy(given["weights"].copy())
    torch.nn.utils.vector_to_parameters(weights, block.parameters())
    image = torch.from_numpy(given["image"])[None]
    with torch.no_grad():
        got = fuse(block)(image)
        with by_branches(block):
            wanted = block.double()(image.double())
        size = torch.nn.utils.parameters_to_vector(block.parameters()).abs()
        torch.nn.utils.vector_to_parameters(size, block.parameters())
        with by_branches(block):
            products = block(image.double().abs())
    return float(((got - wanted).abs() / products).max())


def _radiance(*shape: int) -> tuple[tuple[int, ...], float, float, bool]:
    return shape, 1e-20, _MAX, True


_H, _W = 8, 10
_SAMPLES = ((_H, _W), 1e-6, 17.0, True)
_LOGITS = sum(
    pyramid_layout.level_logits(level, 2, _PYRAMID) * (_H >> level) * (_W >> level)  # type: ignore[arg-type]
    for level in range(2)
)

OPERATORS = [
    Operator(
        name="repair", error=_repair, limit=2e-6,
        ranges={
            "color": _radiance(_H, _W, 3), "broken": ((_H, _W), 0, 1, False),
            "share": ((1, 1), 0, 1, False),
        },
    ),
    Operator(
        name="demodulate", error=_divisor, limit=1e-7,
        ranges={"albedo": ((_H, _W, 3), 1e-5, 1, True)},
    ),
    Operator(
        name="demodulate, then remodulate", error=_modulate, limit=2e-7,
        ranges={"albedo": ((_H, _W, 3), 1e-5, 1, True), "radiance": _radiance(_H, _W, 3)},
    ),
    Operator(
        name="luminance", error=_luminance, limit=5e-7, ranges={"color": _radiance(_H, _W, 3)}
    ),
    Operator(
        name="expose", error=_expose, limit=2e-6, ranges={"light": ((24, 40), 1e-20, 1e20, True)}
    ),
    Operator(
        name="tone map", error=_tone_map, limit=2e-7, unit="of white, 1",
        ranges={"light": _radiance(_H, _W)},
    ),
    Operator(
        name="local luminance", error=_local, limit=2e-6,
        ranges={"toned": ((20, 22), 1e-12, 1, True)},
    ),
    Operator(
        name="outlier weight", error=_weight, limit=2e-6,
        ranges={
            "light": _radiance(_H, _W), "local": ((_H, _W), 1e-6, 0.9998, True),
            "held": ((_H, _W), 0, 17, False),
        },
    ),
    Operator(
        name="accumulate", error=_accumulate, limit=2e-6,
        ranges={
            "light": _radiance(_H, _W, 3), "weight": ((_H, _W), 1e-6, 1, True),
            "past": _radiance(3, _H, _W), "held": ((1, _H, _W), 1e-6, 40, True),
        },
    ),
    Operator(
        name="encode planes", error=_features, limit=6e-4, unit="of white, 1",
        ranges={
            "light": _radiance(_H, _W), "held": _SAMPLES, "local": ((_H, _W), 1e-6, 1, True),
            "depth": ((_H, _W), 1e-10, 1e30, True),
        },
    ),
    Operator(
        name="reproject", error=_reproject, limit=2e-5,
        ranges={
            "past": _radiance(_H, _W, 3), "held": _SAMPLES, "at": ((_H, _W, 2), -4, 4, False),
            "side": ((_H, _W), 0, 1, False), "side_before": ((_H, _W), 0, 1, False),
        },
    ),
    Operator(
        name="resample output", error=_resample, limit=2e-5,
        ranges={"past": _radiance(_H, _W, 3), "at": ((_H, _W, 2), -4, 4, False)},
    ),
    Operator(
        name="accumulate albedo", error=_accumulate_albedo, limit=2e-5,
        ranges={
            "albedo": ((_H, _W, 3), 1e-5, 1, True), "before": ((_H, _W, 3), 1e-5, 1, True),
            "held": ((_H, _W), 1, 9, False), "at": ((_H, _W, 2), -4, 4, False),
        },
    ),
    Operator(
        name="resample output, sharp", error=_sharp_resample, limit=2e-5,
        unit="the brightest of 4x4",
        ranges={"past": _radiance(_H, _W, 3), "at": ((_H, _W, 2), -4, 4, False)},
    ),
    Operator(
        name="fused kernels", error=_fused_kernels, limit=1e-5,
        ranges={
            "light": _radiance(_H, _W, 3), "held": _SAMPLES,
            "logits": ((12, _H, _W), -60, 60, False),
        },
    ),
    # 2e-5 without the last filters: distances of features at their bound are what squares of 144
    # leave of each other
    Operator(
        name="pyramid: renew, pool, blend, resolve", error=_pyramid, limit=2e-4,
        ranges={
            "light": _radiance(_H, _W, 3), "new": _radiance(_H, _W, 3), "held": _SAMPLES,
            "albedo": ((_H, _W, 3), 1e-5, 1, True), "past": _radiance(_H, _W, 3),
            "valid": ((_H, _W), 0, 1, False), "logits": ((_LOGITS,), -15, 15, False),
        },
    ),
    Operator(
        name="fuse a block's branches", error=_fuse, limit=1e-6, unit="its terms' sizes",
        ranges={
            "weights": ((4 * 4 * (9 + 1) + 8,), -3, 3, False), "image": ((4, 7, 9), -10, 10, False)
        },
    ),
]  # fmt: skip


def narrowed(operator: Operator, stops: float) -> Operator:
    """The same with radiance of so many powers of ten around 1."""
    ranges = {
        name: (shape, 10.0**-stops, 10.0**stops, True) if high >= 1e20 else (shape, low, high, log)
        for name, (shape, low, high, log) in operator.ranges.items()
    }
    return replace(operator, ranges=ranges)
