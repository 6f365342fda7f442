"""History rejection: light that changes, and noise that only looks like it."""

from __future__ import annotations

import math

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.model_spec import load
from stillray.stages import accumulate as acc
from stillray.stages import history_rejection
from stillray.stages.prepare import prepare
from tests.conftest import make_frame, remembered

SIZE = (150, 210)
SPEC = load("wskp-3s")


def scene(rng):
    """Light of blocks a hundred times as bright as others."""
    cells = 10 ** np.random.default_rng(3).uniform(-1, 1, (12, 20))
    return np.kron(cells, np.ones((16, 16)))[: SIZE[0], : SIZE[1]]


def sampled(light, rng, lit=0.4):
    """One sample a pixel: most find no light."""
    return light * rng.exponential(1 / lit, light.shape) * (rng.random(light.shape) < lit)


def frames_of(light, rng, samples):
    """One frame of several samples a pixel."""
    return light * rng.gamma(samples, 1 / samples, light.shape)


def grey(light, **buffers):
    """A frame under a still camera."""
    color = np.repeat(light[..., None].astype(np.float32), 3, axis=-1)
    return stillray.Frame(color=color, motion=np.zeros((*light.shape, 2), np.float32), **buffers)


def followed(lights, threads=1):
    """The confidence in the past at each frame but the first, and the light held last."""
    strips, history, kept = Strips(threads), None, []
    for light in lights:
        prepared = prepare(grey(light), SPEC, history, strips)
        if history is not None:
            confidence = prepared.history_confidence
            kept.append(np.ones(SIZE, np.float32) if confidence is None else confidence)
        history = prepared.history
    return kept, history.mean


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
@pytest.mark.parametrize("frames", [1, 10])
def test_light_that_changes_everywhere_is_let_go_at_once(rng, factor, frames):
    light = np.full(SIZE, 3.0)
    noisy = [sampled(light, rng) for _ in range(frames)]
    kept, mean = followed([*noisy, *(sampled(light * factor, rng) for _ in range(3))])
    assert all(confidence.min() == 1 for confidence in kept[: frames - 1])
    assert kept[frames - 1].mean() < (0.1 if factor in (0.1, 10.0) else 0.35)
    assert mean[..., 0].mean() == pytest.approx(3 * factor, rel=0.1)
    # and the new light is what the next frames are compared with
    assert kept[-1].mean() > 0.9


def test_light_that_changes_somewhere_is_let_go_there(rng):
    light = scene(rng)
    changed = light.copy()
    changed[:, :105] *= 0.1
    kept, _ = followed([*(sampled(light, rng) for _ in range(5)), sampled(changed, rng)])
    assert kept[-1][:, :60].mean() < 0.25
    assert kept[-1][:, 150:].mean() > 0.99


@pytest.mark.parametrize(("samples", "least"), [(64, 0.05), (16, 0.1), (4, 0.25), (1, 0.6)])
def test_quiet_frames_notice_small_changes(rng, samples, least):
    light = scene(rng)
    changed = light.copy()
    changed[40:104, 40:104] *= 1 - least
    kept, _ = followed(
        [
            *(frames_of(light, rng, samples) for _ in range(6)),
            frames_of(changed, rng, samples),
        ]
    )
    assert kept[-1][56:88, 56:88].mean() < 0.5
    assert kept[-1][:, 168:].mean() > 0.99


@pytest.mark.parametrize("lit", [1.0, 0.3, 0.05, 0.005])
def test_noise_is_not_taken_for_a_change(rng, lit):
    kept, _ = followed([sampled(scene(rng), rng, lit) for _ in range(20)])
    assert np.mean([1 - confidence.mean() for confidence in kept]) < 2e-3


@pytest.mark.parametrize("samples", [4, 64])
def test_quiet_noise_is_not_taken_for_a_change(rng, samples):
    kept, _ = followed([frames_of(scene(rng), rng, samples) for _ in range(12)])
    assert np.mean([1 - confidence.mean() for confidence in kept]) < 1e-4


def test_fireflies_are_not_taken_for_a_change(rng):
    frames = [sampled(scene(rng), rng) for _ in range(12)]
    for frame in frames:
        frame.reshape(-1)[rng.integers(frame.size, size=20)] = 1e30
    kept, _ = followed(frames)
    assert np.mean([1 - confidence.mean() for confidence in kept]) < 2e-3


def test_a_moving_shadow_leaves_no_more_error_than_a_frame_alone(rng):
    column, errors, alone = np.arange(SIZE[1]), [], []
    history, strips = None, Strips(1)
    for index in range(16):
        left = 8 * index
        shadow = np.where((column >= left) & (column < left + 40), 0.3, 1.0)
        light = np.ones(SIZE) * shadow
        frame = frames_of(light, rng, 8).astype(np.float32)
        prepared = prepare(grey(frame), SPEC, history, strips)
        history = prepared.history
        if index >= 4:
            trail = (column >= left - 32) & (column < left)
            # as a filter over 10x10 pixels, which noise does not outlast, shows it
            blocks = [
                picture[:, trail].reshape(15, 10, -1).mean((1, 2))
                for picture in (history.mean[..., 0], frame)
            ]
            errors.append(np.mean((blocks[0] - 1) ** 2))
            alone.append(np.mean((blocks[1] - 1) ** 2))
    # the past may cost what it is allowed to hide: half of one frame's standard error
    assert np.sqrt(np.mean(errors)) < 1.5 * np.sqrt(np.mean(alone))


def test_scale_of_light_does_not_change_decisions(rng):
    light = scene(rng)
    frames = [sampled(light, rng) for _ in range(5)] + [sampled(light * 0.3, rng)]
    plain, _ = followed(frames)
    for scale in (1e-6, 1e6):
        scaled, _ = followed([frame * scale for frame in frames])
        for one, other in zip(plain, scaled, strict=True):
            np.testing.assert_allclose(one, other, atol=2e-3)


def test_what_was_outside_of_the_last_frame_has_not_changed(rng):
    dark, bright = (np.full((*SIZE, 3), value, np.float32) for value in (0.1, 10.0))
    motion = np.full((*SIZE, 2), 1e6, np.float32)
    strips = Strips(1)
    first = prepare(stillray.Frame(color=dark, motion=motion), SPEC, None, strips)
    second = prepare(stillray.Frame(color=bright, motion=motion), SPEC, first.history, strips)
    assert second.history_confidence is None


def test_threads_do_not_change_what_is_seen(rng):
    light = scene(rng)
    frames = [sampled(light, rng) for _ in range(3)] + [sampled(light * 0.2, rng)]
    (*_, one), mean = followed(frames, threads=1)
    (*_, three), other = followed(frames, threads=3)
    np.testing.assert_array_equal(one, three)
    np.testing.assert_array_equal(mean, other)


@pytest.mark.parametrize("shape", [(16, 24), (17, 33), (1, 1), (1, 9)])
def test_compare_agrees_with_loops(rng, shape):
    light = rng.exponential(1, shape).astype(np.float32)
    past = np.concatenate([rng.random((3, *shape)), 16 * rng.random((1, *shape))])
    past = past.astype(np.float32)
    past[3][rng.random(shape) < 0.2] = 0
    weight = (rng.random(shape) * rng.integers(0, 2, shape) + 0.02).astype(np.float32)
    weight[rng.random(shape) < 0.1] = 0
    rows, columns = (-(-size // 2) for size in shape)
    out = np.empty((history_rejection.PLANES, rows, columns), np.float32)
    history_rejection.compare(light, weight, past, 0.5, out, Workspace())
    np.testing.assert_allclose(
        out, compared_by_loops(light, weight, past, 0.5), rtol=2e-5, atol=2e-6
    )


def compared_by_loops(light, weight, past, exposure):
    height, width = light.shape
    out = np.zeros((4, -(-height // 2), -(-width // 2)))
    red, green, blue = 0.2126, 0.7152, 0.0722
    for row in range(out.shape[1]):
        for column in range(out.shape[2]):
            held = apart = lit = product = 0.0
            for y in range(2 * row, min(2 * row + 2, height)):
                for x in range(2 * column, min(2 * column + 2, width)):
                    w, n = float(weight[y, x]), float(past[3, y, x])
                    a = max(w, acc.MIN_WEIGHT) * n / (n + 1) if w > 0 else 0.0
                    r, g, b = (float(value) for value in past[:3, y, x])
                    sample = exposure * float(light[y, x]) * min(1, w / acc.MIN_WEIGHT)
                    d = sample - exposure * (red * r + green * g + blue * b)
                    held, apart, lit = held + a, apart + a * d, lit + a * sample
                    product += a * d * sample
            variance = product / 4 - (apart / 4) * (lit / 4) / max(held / 4, 1e-3)
            out[:, row, column] = held / 4, apart / 4, lit / 4, variance * 4 / 3
    return out


@pytest.mark.parametrize("shape", [(20, 28), (13, 19)])
def test_confidence_agrees_with_loops(rng, shape):
    rows, columns = (-(-size // 2) for size in shape)
    blocks = np.empty((4, rows, columns), np.float32)
    blocks[0] = rng.uniform(0.3, 0.94, (rows, columns))
    difference = rng.normal(0, 0.05, (rows, columns))
    difference[:, -columns // 3 :] += 1.5
    blocks[1] = blocks[0] * difference
    blocks[2] = blocks[0] * rng.uniform(0.5, 2, (rows, columns))
    blocks[3] = blocks[0] * rng.exponential(0.04, (rows, columns))
    motion = np.zeros((*shape, 2), np.float32)
    found, _ = history_rejection.confidence(blocks, None, motion, 1.0, Strips(1))
    wanted = confidence_by_loops(blocks.astype(np.float64), shape)
    assert (wanted < 0.5).mean() > 0.1
    np.testing.assert_allclose(found, wanted, rtol=2e-3, atol=2e-4)


def confidence_by_loops(blocks, shape):
    """The definition in float64, for frames whose blocks of 16 pixels are fewer than five."""
    pyramid = [blocks]
    while len(pyramid) < 5 and min(pyramid[-1].shape[1:]) > 1:
        pyramid.append(halved_by_loops(pyramid[-1]))
    lowest = min(3, len(pyramid) - 1)
    usual = windows_by_loops(pyramid[lowest])[3]
    bias = np.zeros(pyramid[-1].shape[1:])
    thresholds = (6.0, 5.5, 4.1, 4.8, 4.4, 4.0)
    for level in reversed(range(len(pyramid))):
        held, difference, light, variance = windows_by_loops(pyramid[level])
        size = variance.shape
        if bias.shape != size:
            bias = doubled_by_loops(bias)[: size[0], : size[1]]
        noise = usual
        if level < lowest:
            noise = linear_by_loops(usual, 2 ** (lowest - level))
        noise = np.maximum(noise[: size[0], : size[1]], variance)
        samples = held * 9 * 4 ** (level + 1)
        bias = corrected(bias, difference, light, noise, samples, thresholds[level + 1])
    single = blocks[1] / np.maximum(blocks[0], 1e-3)
    bias = corrected(bias, single, light, noise, 4 * blocks[0], thresholds[0])
    samples = blocks[0] / np.maximum(1 - blocks[0], 1e-3)
    noise = variance + (0.01 * (np.abs(single) / 2 + light + acc.DARK)) ** 2
    kept = 1 / (1 + 100 * samples * bias**2 / noise)
    return doubled_by_loops(kept)[: shape[0], : shape[1]]


def corrected(bias, difference, light, noise, samples, threshold):
    systematic = 0.01 * (np.abs(difference) / 2 + light + acc.DARK)
    error = threshold**2 * noise * (1 / np.maximum(samples, 1e-3) + 1 / 1500) + systematic**2
    rest = difference - bias
    return bias + rest * np.maximum(0, 1 - error / np.maximum(rest**2, 1e-30))


def halved_by_loops(planes):
    count, height, width = planes.shape
    out = np.zeros((count, -(-height // 2), -(-width // 2)))
    for plane in range(count):
        for row in range(height):
            for column in range(width):
                out[plane, row // 2, column // 2] += planes[plane, row, column] / 4
    return out


def windows_by_loops(planes):
    count, height, width = planes.shape
    out = np.zeros((count, height, width))
    for row in range(height):
        for column in range(width):
            near = planes[:, max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
            out[:, row, column] = near.sum((1, 2)) / 9
    out[1:] /= np.maximum(out[0], 1e-3)
    out[3] = np.maximum(out[3], 0)
    return out


def linear_by_loops(plane, factor):
    height, width = plane.shape
    out = np.empty((factor * height, factor * width))
    for row in range(out.shape[0]):
        for column in range(out.shape[1]):
            y = min(max((row + 0.5) / factor - 0.5, 0), height - 1)
            x = min(max((column + 0.5) / factor - 0.5, 0), width - 1)
            top, left = math.floor(y), math.floor(x)
            below, right = min(top + 1, height - 1), min(left + 1, width - 1)
            down, across = y - top, x - left
            out[row, column] = (1 - down) * (
                (1 - across) * plane[top, left] + across * plane[top, right]
            ) + down * ((1 - across) * plane[below, left] + across * plane[below, right])
    return out


def doubled_by_loops(plane):
    return linear_by_loops(plane, 2)


def test_layers_still_add_up_where_light_changed(rng):
    with stillray.Denoiser("kpyr-5s", threads=1) as denoiser:
        for index in range(4):
            frame = make_frame(64, 80, index)
            color = frame.color * np.float32(0.05 if index == 3 else 1)
            share = rng.random(color.shape).astype(np.float32)
            frame = stillray.Frame(
                color=color, albedo=frame.albedo, normal=frame.normal, depth=frame.depth,
                motion=frame.motion,
            )  # fmt: skip
            layers = {"one": color * share, "other": color * (1 - share)}
            image, parts = denoiser.denoise_layers(frame, layers)
        assert remembered(denoiser).mean[..., 3].mean() < 1.5
    np.testing.assert_allclose(sum(parts.values()), image, rtol=1e-4, atol=1e-6)
