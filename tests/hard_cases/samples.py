"""Hard cases of radiance: fireflies, broken values, ranges."""

from __future__ import annotations

import numpy as np

import stillray
from stillray.frame import Frame
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
)

_TRUSTS_SAMPLES = "the network takes too much of a lone bright sample where nothing else is noisy"
_TRAINED_ON_CLEAN = (
    "trained on 64 samples a pixel alone, it has seen few fireflies and no bright one"
)
FIREFLIES = (1e3, 1e4, 1e6, 1e12, 1e30, 3e38)  # times the surroundings, which are below 1


def _with_firefly(frame: Frame, brightness: float) -> Frame:
    color = frame.color.copy()
    color[10, 12] = brightness
    return changed(frame, color=color)


def _peak(denoiser: stillray.Denoiser, before: int, after: int) -> float:
    """How far one firefly lifts any pixel, as a multiple of it, some frames later; the worst."""
    (frame,) = clean(1)
    run(denoiser, [frame] * before)
    past = denoiser.state
    base = [denoiser.denoise(frame) for _ in range(1 + after)][-1]
    worst = 0.0
    for brightness in FIREFLIES:
        denoiser.state = past
        images = [denoiser.denoise(_with_firefly(frame, brightness))]
        images += [denoiser.denoise(frame) for _ in range(after)]
        if not np.isfinite(images).all():
            return float("inf")
        worst = max(worst, float((images[-1] / base).max()))
    return worst


@case(
    "a firefly of 1e3 to 3e38 in the first frame",
    "largest pixel / the same without it",
    6,
    nbg_2x1="one grid spreads a firefly over 6 pixels to each side, too few to bring it down",
    wskp_3=_TRUSTS_SAMPLES,
)
def firefly_in_the_first_frame(denoiser: stillray.Denoiser) -> float:
    return _peak(denoiser, 0, 0)


@case(
    "the same, four frames later",
    "largest pixel / the same without it",
    2.5,
)
def firefly_four_frames_later(denoiser: stillray.Denoiser) -> float:
    return _peak(denoiser, 0, 4)


@case(
    "a firefly of 1e3 to 3e38 after 20 frames",
    "largest pixel / the same without it",
    4,
    nbg_7x3=_TRAINED_ON_CLEAN,
    wskp_3s="a third above the limit since it reads eight features; why was not found",
)
def firefly_in_an_old_history(denoiser: stillray.Denoiser) -> float:
    return _peak(denoiser, 20, 0)


@case(
    "the same, eight frames later",
    "largest pixel / the same without it",
    4.5,
)
def firefly_in_an_old_history_later(denoiser: stillray.Denoiser) -> float:
    return _peak(denoiser, 20, 8)


def _clusters(denoiser: stillray.Denoiser, brightness: float, after: int) -> float:
    """3x3 pixels share one sample, which moves a pixel a frame for eight frames."""
    frames = clean(8 + after)
    base = run(denoiser, frames)
    for index in range(8):
        color = frames[index].color.copy()
        block = slice(8, 11), slice(6 + index, 9 + index)
        color[block] *= brightness / color[block].max()
        frames[index] = changed(frames[index], color=color)
    images = run(denoiser, frames)
    first = 0 if after == 0 else -1
    return float((np.array(images[first:]) / np.array(base[first:])).max())


@case(
    "3x3 pixels share a sample of 1e3, moving 1 pixel a frame, 8 frames",
    "largest pixel / the same without it",
    100,
    nbg_7x3=_TRAINED_ON_CLEAN,
    wskp_mr=_TRUSTS_SAMPLES,
)
def cluster_of_fireflies(denoiser: stillray.Denoiser) -> float:
    return _clusters(denoiser, 1e3, 0)


@case(
    "the same with 1e8",
    "largest pixel / the same without it",
    100,
    nbg_7x3=_TRAINED_ON_CLEAN,
    wskp_mr=_TRUSTS_SAMPLES,
)
def cluster_of_huge_fireflies(denoiser: stillray.Denoiser) -> float:
    return _clusters(denoiser, 1e8, 0)


@case("the cluster of 1e8, 16 frames after it has gone", "largest pixel / the same without it", 20)
def cluster_of_huge_fireflies_later(denoiser: stillray.Denoiser) -> float:
    return _clusters(denoiser, 1e8, 16)


def _broken(denoiser: stillray.Denoiser, share: float, kind: type = np.float32) -> float:
    rng = np.random.default_rng(0)
    color = np.full((HEIGHT, WIDTH, 3), 0.5, kind)
    at = rng.random((HEIGHT, WIDTH)) < share
    color[at] = rng.choice(np.array([np.nan, np.inf, -np.inf], kind), (at.sum(), 3))
    return apart(run(denoiser, [Frame(color=color, motion=still())] * 3), 0.5)


@case("1 % of a flat frame's pixels NaN, Inf or -Inf", "relative error", ROUNDING)
def few_broken_pixels(denoiser: stillray.Denoiser) -> float:
    return _broken(denoiser, 0.01)


@case("half of a flat frame's pixels NaN, Inf or -Inf", "relative error", ROUNDING)
def many_broken_pixels(denoiser: stillray.Denoiser) -> float:
    return _broken(denoiser, 0.5)


@case("all pixels NaN, Inf or -Inf", "largest value", 0)
def nothing_but_broken_pixels(denoiser: stillray.Denoiser) -> float:
    color = np.full((HEIGHT, WIDTH, 3), np.nan, np.float32)
    color[::2] = np.inf
    color[1::3] = -np.inf
    return float(np.max(np.abs(run(denoiser, [Frame(color=color, motion=still())] * 3))))


@case(
    "a NaN beside a firefly of 3e38",
    "largest pixel / the surroundings",
    3,
    nbg_7x3=_TRAINED_ON_CLEAN,
)
def broken_pixel_beside_a_firefly(denoiser: stillray.Denoiser) -> float:
    frame = _with_firefly(flat(0.5), 3e38)
    frame.color[10, 13] = np.nan
    image = run(denoiser, [frame])[-1]
    return float(np.max(image)) / 0.5 if np.isfinite(image).all() else float("inf")


@case("a tenth of the pixels negative", "difference from the same with zeros there", 0)
def negative_radiance(denoiser: stillray.Denoiser) -> float:
    below, zero = [], []
    for index, frame in enumerate(noisy(3)):
        at = np.random.default_rng(index).random((HEIGHT, WIDTH)) < 0.1
        below.append(changed(frame, color=np.where(at[..., None], -3, frame.color)))
        zero.append(changed(frame, color=np.where(at[..., None], 0, frame.color)))
    return float(np.max(np.abs(np.subtract(run(denoiser, below), run(denoiser, zero)))))


# the smallest float32 is 1e-45: 1e-40 has five digits
@case("a flat frame of denormals, 1e-40", "relative error", 1e-3)
def denormals(denoiser: stillray.Denoiser) -> float:
    return apart(run(denoiser, [flat(1e-40)] * 3), np.float32(1e-40))


@case("denormals in every second pixel", "relative error of a 2x2 mean, least and most", 0)
def denormals_among_others(denoiser: stillray.Denoiser) -> float:
    color = np.full((HEIGHT, WIDTH, 3), 1.0, np.float32)
    color[::2] = 1e-42
    images = np.array(run(denoiser, [Frame(color=color, motion=still())] * 3))
    if not np.isfinite(images).all():
        return float("inf")
    return float(max(images.max() - 1 - ROUNDING, -images.min(), 0))


@case("float16 buffers, 5 % of the color overflown to Inf", "relative error", ROUNDING)
def half_precision_overflow(denoiser: stillray.Denoiser) -> float:
    return _broken(denoiser, 0.05, np.float16)


@case("float16 color of 65504, the largest", "relative error", ROUNDING)
def half_precision_maximum(denoiser: stillray.Denoiser) -> float:
    color = np.full((HEIGHT, WIDTH, 3), 65504, np.float16)
    return apart(run(denoiser, [Frame(color=color, motion=still())] * 2), 65504)


@case("flat frames of 0, 1e-6, 0.3, 6e4, 1e6, 1e20", "relative error", ROUNDING)
def constant_frames(denoiser: stillray.Denoiser) -> float:
    values = (0.0, 1e-6, 0.3, 6e4, 1e6, 1e20)
    return max(apart(run(denoiser, [flat(value)] * 3), np.float32(value)) for value in values)


@case("exposure scaled by 1e-6 to 1e6", "relative difference of the scaled result", 1e-4)
def exposure_scaled(denoiser: stillray.Denoiser) -> float:
    base, worst = run(denoiser, noisy(3)), 0.0
    for scale in (1e-6, 1e-3, 1e3, 1e6):
        images = run(denoiser, noisy(3, light=scale))
        worst = max(worst, apart(np.array(images) / scale, base))
    return worst


_TAKEN_FOR_A_FIREFLY = "the network spreads little of one bright pixel, however long it stays"


@case(
    "one pixel of 100 times its surroundings, for 32 still frames",
    "share of its light lost",
    0.25,
    kpyr_5=_TAKEN_FOR_A_FIREFLY,
    kpyr_5s=_TAKEN_FOR_A_FIREFLY,
    wskp_mr=_TAKEN_FOR_A_FIREFLY,
    wskp_6=_TAKEN_FOR_A_FIREFLY,
)
def single_bright_pixel(denoiser: stillray.Denoiser) -> float:
    frames = [flat(0.1) for _ in range(32)]
    for frame in frames:
        frame.color[12, 16] = 10
    image = run(denoiser, frames)[-1]
    return float(1 - (image.sum() - 0.1 * image.size) / (3 * 9.9))


_FEW_LAMPS = "few small lamps are in view of what it learned from: what is far brighter is noise"


@case(
    "a lamp of 4x3 pixels on a wall of 4 samples, one frame",
    "share of its light lost",
    0.25,
    nbg_2x1=_FEW_LAMPS,
    nbg_2x3=_FEW_LAMPS,
    nbg_7x3=_FEW_LAMPS,
    wskp_3=_FEW_LAMPS,
    wskp_3s=_FEW_LAMPS,
    wskp_6=_FEW_LAMPS,
    wskp_mr=_FEW_LAMPS,
)
def lamp(denoiser: stillray.Denoiser) -> float:
    frames = noisy(4)
    frame = changed(frames[0], color=np.mean([each.color for each in frames], axis=0))
    albedo = frame.albedo
    assert albedo is not None
    frame.color[1:4, 14:18], albedo[1:4, 14:18] = 10, 0.9  # no samples' noise: it is seen itself
    (image,) = run(denoiser, [changed(frame, samples=4)])
    return float(1 - image[1:4, 14:18].mean() / 10)


_MIXES = "a pixel is a mean of what is around: of the sky, a hundredth outshines a slat"


@case(
    "slats of 2.6 pixels before a sky of 300 times their light, 4 samples, one frame",
    "light of pixels that only slats cover / theirs",
    3,
    nbg_2x1=_MIXES,
    nbg_2x3=_MIXES,
    nbg_7x3=_MIXES,
    wskp_3=_MIXES,
    wskp_3s=_MIXES,
    wskp_6=_MIXES,
    wskp_mr=_MIXES,
)
def slats_before_a_sky(denoiser: stillray.Denoiser) -> float:
    rng, (height, width, samples) = np.random.default_rng(3), (48, 66, 4)
    rows, step, thick = np.arange(height)[:, None, None], 5.3, 2.6
    slat = (rows + rng.random((height, width, samples))) % step < thick
    light = 0.1 * np.where(slat, rng.exponential(1, slat.shape), 300).mean(axis=-1)
    share = slat.mean(axis=-1)
    frame = Frame(
        color=np.repeat(light[..., None], 3, 2).astype(np.float32),
        albedo=np.repeat(0.6 * share[..., None], 3, 2).astype(np.float32),
        normal=share[..., None] * np.float32([0, 0, 1]),
        depth=np.where(share > 0, np.float32(4), np.float32(0)),
        samples=samples,
    )
    (image,) = run(denoiser, [frame])
    return float(image[np.arange(height) % step <= thick - 1].mean() / 0.1)


_CLAMPS = "what is far above all around is taken away, and of such light that is a tenth and more"


@case(
    "samples of a heavy tail: one in 30 is 3 to 10,000 times as bright, 16 a pixel, four frames",
    "share of pixels whose light is off by more than a quarter",
    0.1,
    nbg_2x1=_CLAMPS,
    nbg_7x3=_CLAMPS,
    wskp_3=_CLAMPS,
    wskp_3s=_CLAMPS,
    wskp_6=_CLAMPS,
)
def heavy_tail(denoiser: stillray.Denoiser) -> float:
    shape, often, most = (48, 66, 16), 0.1, 1e4
    albedo = np.full((*shape[:2], 3), (0.7, 0.6, 0.5), np.float32)
    albedo[:, 22:44] = (0.2, 0.25, 0.3)
    normal = np.zeros((*shape[:2], 3), np.float32)
    normal[:24, :, 2] = normal[24:, :, 1] = 1
    wanted = 0.2 * (1 + often * np.log(most / 3)) * albedo
    off = []
    for seed in range(4):
        rng, share = np.random.default_rng(seed), 1 / 3 - 1 / most
        usual = rng.exponential(1, shape)
        # a sample is v times as bright or more as often as `often / v`
        rare = (rng.random(shape) < often * share) / (rng.random(shape) * share + 1 / most)
        light = 0.2 * (usual + rare).mean(axis=-1)
        frame = Frame(
            color=(light[..., None] * albedo).astype(np.float32),
            albedo=albedo,
            normal=normal,
            depth=np.full(shape[:2], 4, np.float32),
            samples=shape[2],
        )
        (image,) = run(denoiser, [frame])
        off.append(np.abs(image / wanted - 1).max(axis=-1) > 0.25)
    return float(np.mean(off))


CASES: list[Case] = [value for value in list(globals().values()) if isinstance(value, Case)]
