"""Hard cases of the features and the network: albedo, normals, depth, motion, sizes, logits."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np

import stillray
from stillray.families.contract import Engine
from stillray.frame import Frame
from tests.conftest import make_frame, remembered
from tests.hard_cases.case import (
    HEIGHT,
    ROUNDING,
    WIDTH,
    Case,
    apart,
    case,
    changed,
    clean,
    flat,
    noisy,
    run,
    still,
    truth,
)

#: Set to test a frame of 7680x4320, which takes minutes and about 40 GB.
ON_DEMAND = "STILLRAY_HARD_CASES_8K"


@case("albedo 0 everywhere", "relative error of a flat frame", ROUNDING)
def zero_albedo(denoiser: stillray.Denoiser) -> float:
    return apart(run(denoiser, [flat(0.7, albedo=np.zeros((HEIGHT, WIDTH, 3)))] * 2), 0.7)


@case("albedo 0 in every second pixel", "relative error of a flat frame", ROUNDING)
def zero_albedo_here_and_there(denoiser: stillray.Denoiser) -> float:
    albedo = np.ones((HEIGHT, WIDTH, 3))
    albedo[::2, ::2] = 0
    return apart(run(denoiser, [flat(0.7, albedo=albedo)] * 2), 0.7)


@case("albedo of 1.5 to 1e30", "relative error of a flat frame", ROUNDING)
def albedo_above_one(denoiser: stillray.Denoiser) -> float:
    albedo = np.geomspace(1.5, 1e30, HEIGHT * WIDTH * 3).reshape(HEIGHT, WIDTH, 3)
    return apart(run(denoiser, [flat(0.7, albedo=albedo)] * 2), 0.7)


def _denied(denoiser: stillray.Denoiser, count: int = 4) -> float:
    """Samples that a still flat frame's pixels should hold after some frames, and do not."""
    return float(count - remembered(denoiser).mean[..., 3].min())


@case("normals 0 everywhere, 4 still frames", "samples of history lost", 0.1)
def zero_normals(denoiser: stillray.Denoiser) -> float:
    run(denoiser, [flat(0.5, normal=np.zeros((HEIGHT, WIDTH, 3)))] * 4)
    return _denied(denoiser)


@case(
    "normals of length 0.3 to 1000, 4 still frames",
    "samples of history lost",
    0.1,
)
def unnormalised_normals(denoiser: stillray.Denoiser) -> float:
    worst = 0.0
    for length in (0.3, 0.5, 0.9, 1.1, 2, 1000):
        normal = np.broadcast_to(np.float32([0.6, 0, 0.8]) * length, (HEIGHT, WIDTH, 3))
        run(denoiser, [flat(0.5, normal=normal)] * 4)
        worst = max(worst, _denied(denoiser))
    return worst


@case("depth Inf, -Inf, NaN, 0 or negative, 4 still frames", "samples of history lost", 0.1)
def broken_depth(denoiser: stillray.Denoiser) -> float:
    worst = 0.0
    for value in (np.inf, -np.inf, np.nan, 0, -3):
        run(denoiser, [flat(0.5, depth=np.full((HEIGHT, WIDTH), value))] * 4)
        worst = max(worst, _denied(denoiser))
    return worst


@case("all features NaN, Inf, huge or negative at random", "values out of the input's range", 0)
def features_of_anything(denoiser: stillray.Denoiser) -> float:
    rng = np.random.default_rng(1)
    bad = np.array([np.nan, np.inf, -np.inf, -5, 7, 1e30, 0])
    shape = (HEIGHT, WIDTH)
    frames = [
        Frame(
            color=rng.random((*shape, 3)), normal=rng.choice(bad, (*shape, 3)),
            depth=rng.choice(bad, shape), motion=rng.choice(bad, (*shape, 2)),
        )
        for _ in range(4)
    ]  # fmt: skip
    images = np.array(run(denoiser, frames))
    inside = (images >= 0) & (images <= 1 + ROUNDING)  # a NaN is not
    return float((~inside).sum())


def _most_samples(denoiser: stillray.Denoiser, frames: list[Frame]) -> float:
    run(denoiser, frames)
    return float(remembered(denoiser).mean[..., 3].max())


@case("motion NaN, Inf or far out of the frame", "samples held: its own at most", 1)
def motion_from_nowhere(denoiser: stillray.Denoiser) -> float:
    worst = 0.0
    for value in (np.nan, np.inf, -np.inf, 50, -50, 1e6, -1e30):
        first, second = noisy(2)
        lost = changed(second, motion=np.full((HEIGHT, WIDTH, 2), value))
        worst = max(worst, _most_samples(denoiser, [first, lost]))
    return worst


@case("every surface uncovered: depth and normals change at once", "samples held", 1)
def full_disocclusion_holds_nothing(denoiser: stillray.Denoiser) -> float:
    *past, last = noisy(9)
    uncovered = changed(last, depth=last.depth * 3, normal=last.normal[..., ::-1].copy())
    return _most_samples(denoiser, [*past, uncovered])


@case("one pixel of albedo 0.9 on 0.2, 8 still frames", "share of its contrast lost", 0.5)
def single_pixel_of_albedo(denoiser: stillray.Denoiser) -> float:
    albedo = np.full((HEIGHT, WIDTH, 3), 0.2, np.float32)
    albedo[12, 16] = 0.9
    frames = [Frame(color=albedo, albedo=albedo, motion=still())] * 8
    image = run(denoiser, frames)[-1]
    return float(1 - (image[12, 16].mean() - 0.2) / 0.7)


_KEEPS_FEATURES = "what it filters is multiplied by the albedo as it is, noise and all"


@case(
    "two surfaces out of focus over 32 pixels, features of the same 1, 4, 16 and 64 samples",
    "error / that of the noisy frame, one frame, worst of the counts",
    0.25,
    kpyr_5=_KEEPS_FEATURES,
    kpyr_5s=_KEEPS_FEATURES,
    nbg_2x1=_KEEPS_FEATURES,
    nbg_2x3=_KEEPS_FEATURES,
    nbg_7x3=_KEEPS_FEATURES,
    wskp_3=_KEEPS_FEATURES,
    wskp_3s=_KEEPS_FEATURES,
    wskp_6=_KEEPS_FEATURES,
    wskp_mr=_KEEPS_FEATURES,
)
def out_of_focus(denoiser: stillray.Denoiser) -> float:
    return max(_error_out_of_focus(denoiser, samples) for samples in (1, 4, 16, 64))


def _error_out_of_focus(denoiser: stillray.Denoiser, samples: int) -> float:
    height, width = 64, 96
    rng = np.random.default_rng(2)
    albedo = np.float32([(0.8, 0.75, 0.7), (0.08, 0.12, 0.2)])
    normal, depth = np.float32([(0, 0, 1), (0, 1, 0)]), np.float32([2, 6])
    light = np.float32([0.5, 0.8])
    # a sample meets the one or the other, and has all that it has
    share = np.clip((np.arange(width) - width / 2) / 32 + 0.5, 0, 1)
    met = (rng.random((samples, height, width)) < share).astype(int)
    grain = rng.exponential(1, met.shape).astype(np.float32)
    frame = Frame(
        color=(albedo[met] * (light[met] * grain)[..., None]).mean(axis=0),
        albedo=albedo[met].mean(axis=0),
        normal=normal[met].mean(axis=0),
        depth=depth[met[-1]],
        samples=samples,
    )
    near, far = albedo * light[:, None]
    wanted = near + share[:, None] * (far - near)
    (image,) = run(denoiser, [frame])
    errors = [np.sqrt(np.mean((each - wanted)[8:-8, 34:62] ** 2)) for each in (image, frame.color)]
    return float(errors[0] / errors[1])


@case("every odd size from 1x1 to 13x13, and 1x999, 999x1", "relative error of a flat frame", 1e-4)
def odd_sizes(denoiser: stillray.Denoiser) -> float:
    sizes = [(h, w) for h in range(1, 14, 2) for w in range(1, 14, 2)] + [(1, 999), (999, 1)]
    worst = 0.0
    for height, width in sizes:
        color = np.full((height, width, 3), 0.5, np.float32)
        frames = [Frame(color=color, motion=still(height, width))] * 2
        worst = max(worst, apart(run(denoiser, frames), 0.5))
    return worst


@case("odd sizes with noise and all features", "values that are not finite or negative", 0)
def odd_sizes_with_features(denoiser: stillray.Denoiser) -> float:
    wrong = 0
    for size in ((1, 1), (1, 7), (5, 1), (3, 3), (17, 31), (65, 129)):
        for image in run(denoiser, [make_frame(*size, seed, shift=0.7) for seed in range(2)]):
            wrong += image.shape != (*size, 3)
            wrong += int((~(np.isfinite(image) & (image >= 0))).sum())
    return float(wrong)


@case("7680x4320, on demand", "relative error of a flat frame", 1e-4)
def eight_k(denoiser: stillray.Denoiser) -> float:
    assert os.environ.get(ON_DEMAND)
    color = np.full((4320, 7680, 3), 0.5, np.float32)
    frames = [Frame(color=color, motion=still(4320, 7680))] * 2
    return max(apart(image, 0.5) for image in run(denoiser, frames))


def _with_logits(denoiser: stillray.Denoiser, values: np.ndarray) -> float:
    """The network says anything; a flat frame must not care."""
    with stillray.Denoiser(denoiser.model, engine=Anything(denoiser.engine, values)) as other:
        return apart(run(other, [flat(0.5)] * 3), 0.5)


class Anything:
    """An engine whose outputs are drawn at random."""

    def __init__(self, engine: Engine, values: np.ndarray) -> None:
        self._engine, self._values, self._rng = engine, values, np.random.default_rng(2)

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        outputs = self._engine.run(graph, inputs)
        return {name: self._rng.choice(self._values, o.shape) for name, o in outputs.items()}

    def close(self) -> None:
        self._engine.close()


@case("logits of ±1e30, ±Inf, ±88 and 0 at random", "relative error of a flat frame", ROUNDING)
def extreme_logits(denoiser: stillray.Denoiser) -> float:
    values = [1e30, -1e30, np.inf, -np.inf, 88, -88, 0]
    return _with_logits(denoiser, np.array(values, np.float32))


@case("logits NaN among others", "relative error of a flat frame", ROUNDING)
def broken_logits(denoiser: stillray.Denoiser) -> float:
    return _with_logits(denoiser, np.array([np.nan, 1, -5, np.inf], np.float32))


@case("every logit as low as can be", "relative error of a flat frame", ROUNDING)
def lowest_logits(denoiser: stillray.Denoiser) -> float:
    return _with_logits(denoiser, np.array([-np.inf], np.float32))


@case("no noise at all", "relative error of the mean light", 0.02)
def clean_frames_keep_their_light(denoiser: stillray.Denoiser) -> float:
    return abs(float(np.mean(run(denoiser, clean(8))[-1]) / truth().mean()) - 1)


CASES: list[Case] = [value for value in list(globals().values()) if isinstance(value, Case)]
