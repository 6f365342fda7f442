"""Hard cases of time: still cameras, cuts, lights and shadows that change."""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

import stillray
from stillray.frame import Frame
from tests.conftest import clean_color, make_frame
from tests.hard_cases.case import (
    HEIGHT,
    WIDTH,
    Case,
    accumulated,
    case,
    changed,
    clean,
    noisy,
    run,
    truth,
)

ROUND = 100  # frames of a still camera, of noise of their own; then the same noise comes again
_SETTLED = 20  # frames, after which a pixel holds all samples that it may


@lru_cache(maxsize=4)
def _still_camera(denoiser: stillray.Denoiser) -> dict[str, np.ndarray]:
    """Two rounds: mean light of each picture, of what was accumulated, and the error.

    With the same noise in both, what differs is what the first has left, and not chance.
    """
    spec = denoiser.model.spec
    plain, held = np.zeros((HEIGHT, WIDTH, 3)), 0.0
    found: dict[str, list[float]] = {"picture": [], "accumulated": [], "squared": []}
    denoiser.reset()
    for seed in (*range(ROUND), *range(ROUND)):
        frame = make_frame(HEIGHT, WIDTH, seed)
        image = denoiser.denoise(frame)
        held = min(held, spec.temporal.max_samples) + 1
        plain += (frame.color - plain) / held  # the same window of time
        found["picture"].append(image.mean() / plain.mean())
        found["accumulated"].append(accumulated(denoiser, frame).mean() / plain.mean())
        found["squared"].append(float(np.mean((image - truth()) ** 2)))
    return {name: np.array(values) for name, values in found.items()}


@case("a still camera for 200 frames: what is accumulated", "relative error of its light", 1e-3)
def still_camera_keeps_what_it_accumulates(denoiser: stillray.Denoiser) -> float:
    return abs(float(_still_camera(denoiser)["accumulated"][_SETTLED:].mean()) - 1)


_HIDDEN_BY_NOISE = (
    "in frames this small a change this weak is within the noise of too few samples to be sure of"
)
_KERNELS_MOVE_LIGHT = (
    "a network's kernels take a little more from bright pixels or from dark ones; what they are "
    "given keeps its light"
)


@case(
    "the same: the picture",
    "relative error of its light",
    5e-4,
    kpyr_5=_KERNELS_MOVE_LIGHT,
    kpyr_5s=_KERNELS_MOVE_LIGHT,
    nbg_7x3=_KERNELS_MOVE_LIGHT,
    wskp_3=_KERNELS_MOVE_LIGHT,
    wskp_3s=_KERNELS_MOVE_LIGHT,
    wskp_6=_KERNELS_MOVE_LIGHT,
    wskp_mr=_KERNELS_MOVE_LIGHT,
)
def still_camera_keeps_its_light(denoiser: stillray.Denoiser) -> float:
    return abs(float(_still_camera(denoiser)["picture"][_SETTLED:].mean()) - 1)


@case("the same: the second half, of the same noise", "relative change of its light", 2e-3)
def still_camera_does_not_drift(denoiser: stillray.Denoiser) -> float:
    first, second = np.split(_still_camera(denoiser)["picture"], 2)
    return abs(float(second[_SETTLED:].mean() / first[_SETTLED:].mean()) - 1)


@case("the same: the second half, of the same noise", "dB of PSNR lost", 0.5)
def still_camera_leaves_no_ghost(denoiser: stillray.Denoiser) -> float:
    first, second = np.split(_still_camera(denoiser)["squared"], 2)
    return float(10 * np.log10(second[_SETTLED:].mean() / first[_SETTLED:].mean()))


def _unlike_fresh(denoiser: stillray.Denoiser, past: list, after: list) -> float:
    """How far the last picture is from the same without the past, relative to its mean."""
    fresh = run(denoiser, after)[-1]
    image = run(denoiser, past + after)[-1]
    return float(np.abs(image - fresh).mean() / fresh.mean())


@case(
    "every surface uncovered, light 20 times lower: the second frame",
    "mean difference from no past / mean",
    0.1,
)
def full_disocclusion_leaves_no_ghost(denoiser: stillray.Denoiser) -> float:
    after = [
        changed(frame, depth=frame.depth * 3, normal=frame.normal[..., ::-1].copy())
        for frame in noisy(2, first=50, light=0.05)
    ]
    return _unlike_fresh(denoiser, noisy(12), after)


@case(
    "a cut that nobody told, to the mirrored scene with zero motion: the 4th frame",
    "mean difference from no past / mean",
    0.05,
)
def cut_without_reset(denoiser: stillray.Denoiser) -> float:
    after = [
        changed(
            frame, color=frame.color[::-1], normal=np.roll(frame.normal, 1, axis=-1),
            depth=frame.depth * 1.7,
        )
        for frame in noisy(4, first=50)
    ]  # fmt: skip
    return _unlike_fresh(denoiser, noisy(12), after)


@case(
    "a checked texture whose squares change places, no noise",
    "frames until the picture is within 10 % of one that never saw the other texture",
    12,
)
def texture_that_changes(denoiser: stillray.Denoiser) -> float:
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH]
    odd = ((row // 6 + column // 6) % 2 == 1)[..., None]
    light = truth() / make_frame(HEIGHT, WIDTH).albedo

    def painted(one: float, other: float, count: int) -> list[Frame]:
        albedo = np.where(odd, one, other) * np.ones(3)
        return [changed(frame, color=light * albedo, albedo=albedo) for frame in clean(count)]

    # frame by frame: a model that doubles finds more detail with every frame
    wanted = run(denoiser, painted(0.8, 0.2, 24))
    run(denoiser, painted(0.2, 0.8, 12))
    last = 0
    for index, (frame, fresh) in enumerate(zip(painted(0.8, 0.2, 24), wanted, strict=True), 1):
        if np.abs(denoiser.denoise(frame) - fresh).mean() > 0.1 * fresh.mean():
            last = index
    return float(last + 1)


def _frames_to_follow(
    denoiser: stillray.Denoiser, before: float, after: float, count: int = 24
) -> float:
    """Frames, of ``count``, until the picture's mean is within 10 % of the new light, and stays."""
    run(denoiser, noisy(20, light=before))
    wanted, last = truth().mean() * after, 0
    for index in range(1, count + 1):
        (frame,) = noisy(1, first=100 + index, light=after)
        if abs(denoiser.denoise(frame).mean() / wanted - 1) > 0.1:
            last = index
    return float(last + 1)


@case("a light switched on, 10 times brighter", "frames until the picture is within 10 %", 4)
def light_switched_on(denoiser: stillray.Denoiser) -> float:
    return _frames_to_follow(denoiser, 0.1, 1.0)


@case("a light switched off, 10 times darker", "frames until the picture is within 10 %", 4)
def light_switched_off(denoiser: stillray.Denoiser) -> float:
    return _frames_to_follow(denoiser, 1.0, 0.1)


@case("a light dimmed to half", "frames until the picture is within 10 %", 35)
def light_dimmed(denoiser: stillray.Denoiser) -> float:
    return _frames_to_follow(denoiser, 1.0, 0.5, 60)


@case(
    "a shadow of a fifth of the light crosses a still picture, 1 pixel a frame",
    "error of the mean light in the 4 pixels that it has just left",
    0.35,
)
def moving_shadow(denoiser: stillray.Denoiser) -> float:
    column, errors = np.arange(WIDTH), []
    denoiser.reset()
    for index in range(48):
        left = index - 20
        shadow = np.where((column >= left) & (column < left + 8), 0.2, 1.0)[None, :, None]
        (frame,) = noisy(1, first=index)
        image = denoiser.denoise(changed(frame, color=frame.color * shadow))
        trail = (column >= left - 4) & (column < left)
        if index >= 28 and trail.any():
            wanted = (clean_color(HEIGHT, WIDTH) * shadow)[:, trail]
            errors.append(abs(image[:, trail].mean() / wanted.mean() - 1))
    return float(np.mean(errors))


_TALL, _WIDE = 48, 96  # pixels: a shadow of 24 and what it has left
_SPEEDS = (2, 4, 8, 16)  # pixels a frame


def _past_beside_none(denoiser: stillray.Denoiser, samples: int, inside: float) -> Iterator[float]:
    """Error with the past over that of each frame alone, speed by speed.

    Light of ``inside`` times what is around, with an edge of 4 pixels, passes over a wall that
    stays; frames have the noise of ``samples`` samples a pixel.
    """
    column = np.arange(_WIDE)
    normal = np.broadcast_to(np.float32([0, 0, 1]), (_TALL, _WIDE, 3))
    for speed in _SPEEDS:
        rng, frames, wanted = np.random.default_rng(speed), [], []
        for index in range(12):
            centre = 20 + speed * max(index - 4, 0)
            share = np.clip((14 - np.abs((column - centre + 14) % _WIDE - 14)) / 4, 0, 1)
            light = np.broadcast_to((1 + (inside - 1) * share)[None, :, None], (_TALL, _WIDE, 3))
            noise = rng.gamma(samples, 1 / samples, (_TALL, _WIDE, 1))
            frames.append(
                Frame(
                    color=0.5 * light * noise,
                    albedo=np.full((_TALL, _WIDE, 3), 0.5),
                    normal=normal,
                    depth=np.full((_TALL, _WIDE), 4.0),
                    motion=np.zeros((_TALL, _WIDE, 2)),
                )
            )
            wanted.append(0.5 * light)
        held = run(denoiser, frames)
        alone = [run(denoiser, [frame])[0] for frame in frames[4:]]
        errors = [
            np.sqrt(np.mean((np.array(images) - np.array(wanted[4:])) ** 2))
            for images in (held[4:], alone)
        ]
        yield float(errors[0] / errors[1])


_WITH_AND_WITHOUT = "error with the past / of each frame alone, 8 frames, worst of the speeds"


@case(
    "a shadow of 0.3 moves 2 to 16 pixels a frame, 2 samples",
    _WITH_AND_WITHOUT,
    1.1,
    kpyr_5s=_HIDDEN_BY_NOISE,
    wskp_3=_HIDDEN_BY_NOISE,
    wskp_3s=_HIDDEN_BY_NOISE,
    wskp_6=_HIDDEN_BY_NOISE,
    wskp_mr=_HIDDEN_BY_NOISE,
)
def shadow_moves_in_noise(denoiser: stillray.Denoiser) -> Iterator[float]:
    return _past_beside_none(denoiser, 2, 0.3)


@case(
    "the same, 16 samples",
    _WITH_AND_WITHOUT,
    1.1,
    nbg_7x3=_HIDDEN_BY_NOISE,
)
def shadow_moves_in_little_noise(denoiser: stillray.Denoiser) -> Iterator[float]:
    return _past_beside_none(denoiser, 16, 0.3)


@case("the same, 256 samples", _WITH_AND_WITHOUT, 1.1)
def shadow_moves_in_quiet_frames(denoiser: stillray.Denoiser) -> Iterator[float]:
    return _past_beside_none(denoiser, 256, 0.3)


@case(
    "half a shadow, of 0.75, 16 samples",
    _WITH_AND_WITHOUT,
    1.1,
    kpyr_5=_HIDDEN_BY_NOISE,
    nbg_7x3=_HIDDEN_BY_NOISE,
    wskp_3=_HIDDEN_BY_NOISE,
    wskp_3s=_HIDDEN_BY_NOISE,
    wskp_6=_HIDDEN_BY_NOISE,
    wskp_mr=_HIDDEN_BY_NOISE,
)
def half_shadow_moves(denoiser: stillray.Denoiser) -> Iterator[float]:
    return _past_beside_none(denoiser, 16, 0.75)


@case(
    "a reflection of 4 times the light, 16 samples",
    _WITH_AND_WITHOUT,
    1.1,
    kpyr_5s=_HIDDEN_BY_NOISE,
    nbg_7x3=_HIDDEN_BY_NOISE,
    wskp_6=_HIDDEN_BY_NOISE,
)
def reflection_moves(denoiser: stillray.Denoiser) -> Iterator[float]:
    return _past_beside_none(denoiser, 16, 4.0)


_LIGHT_SPREADS = (
    "a look between pixels spreads light, and a window's is more than a bar of two pixels can "
    "hide; the pyramids bound how much of such a past they hold"
)


@case(
    "bars 2 pixels wide before a window of 60 times their light, moving 0.4 pixels a frame",
    "light of the bars, 16 frames from the 24th on / of each frame alone",
    2.0,
    nbg_7x3=_LIGHT_SPREADS,
    wskp_6=_LIGHT_SPREADS,
    wskp_mr=_LIGHT_SPREADS,
)
def bars_before_a_window(denoiser: stillray.Denoiser) -> float:
    rng, step, wide = np.random.default_rng(7), 0.4, 48
    shape = (HEIGHT, wide)
    motion = np.zeros((*shape, 2), np.float32)
    motion[..., 0] = step
    frames, within = [], []
    for index in range(40):
        across = np.arange(wide) + step * index
        # samples lie anywhere in their pixel; one look is at a bar or past it
        at = across + rng.random(shape) - 0.5
        light = np.where(at % 12 < 2, 0.1 * rng.gamma(2, 0.5, shape), 6.0)
        frames.append(
            Frame(
                color=np.repeat(light[..., None], 3, 2).astype(np.float32),
                albedo=np.full((*shape, 3), 0.5),
                normal=np.broadcast_to(np.float32([0, 0, 1]), (*shape, 3)),
                depth=np.full(shape, 4.0),
                motion=motion,
            )
        )
        within.append((across % 12 >= 0.5) & (across % 12 <= 1.5))
    held = run(denoiser, frames)
    alone = [run(denoiser, [frame])[0] for frame in frames[24:]]
    lit = [
        float(
            np.mean([image[:, bar].mean() for image, bar in zip(images, within[24:], strict=True)])
        )
        for images in (held[24:], alone)
    ]
    return lit[0] / lit[1]


CASES: list[Case] = [value for value in list(globals().values()) if isinstance(value, Case)]
