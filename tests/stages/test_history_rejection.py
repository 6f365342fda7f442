"""Light that changes, and noise that only looks like it."""

from __future__ import annotations

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.stages import history_rejection as relight
from tests.conftest import make_frame, remembered

SIZE = (150, 210)  # 9 x 13 blocks, and a rest
STRIPS = Strips(1, pixels=1 << 12)


def scene(rng, *, shift=0):
    """Light of blocks a hundred times as bright as others, moved to the right."""
    cells = 10 ** np.random.default_rng(3).uniform(-1, 1, (12, 40))
    whole = np.kron(cells, np.ones((16, 16)))
    return whole[: SIZE[0], 200 - shift : 200 - shift + SIZE[1]]


def sampled(light, rng, lit=0.4):
    """One sample a pixel: most find no light."""
    return (light * rng.exponential(1 / lit, light.shape) * (rng.random(light.shape) < lit)).astype(
        np.float32
    )


def followed(frames, motion=(0.0, 0.0)):
    """What is kept of the past at each frame but the first."""
    field = np.broadcast_to(np.float32(motion), (*SIZE, 2))
    past, kept = None, []
    for frame in frames:
        now = relight.brightness(frame, 1.0, STRIPS)
        if past is None:
            past = now
            continue
        worth, past = relight.follow(now, past, field, 1.0)
        kept.append(worth)
    return kept


@pytest.mark.parametrize("factor", [0.1, 0.3, 3.0, 10.0])
@pytest.mark.parametrize("frames", [1, 10])
def test_light_that_changes_everywhere_is_let_go_at_once(rng, factor, frames):
    light = scene(rng)
    noisy = [sampled(light, rng) for _ in range(frames)]
    kept = followed([*noisy, *(sampled(light * factor, rng) for _ in range(3))])
    assert all(worth is None for worth in kept[: frames - 1])
    assert kept[frames - 1].shape == SIZE
    assert kept[frames - 1].mean() < 0.1
    # and the new light is what the next frames are compared with
    assert all(worth is None for worth in kept[frames:])


def test_light_that_changes_somewhere_is_let_go_there(rng):
    light = scene(rng)
    changed = light.copy()
    changed[:, :105] *= 0.1
    *_, worth = followed([*(sampled(light, rng) for _ in range(5)), sampled(changed, rng)])
    assert worth[:, :60].mean() < 0.1
    assert worth[:, 150:].min() == 1


@pytest.mark.parametrize("lit", [1.0, 0.3, 0.05, 0.005])
@pytest.mark.parametrize("motion", [0, 7])
def test_noise_is_not_taken_for_a_change(rng, lit, motion):
    frames = [sampled(scene(rng, shift=motion * i), rng, lit) for i in range(20)]
    kept = followed(frames, motion=(-motion, 0))
    lost = [0 if worth is None else 1 - worth.mean() for worth in kept]
    assert np.mean(lost) < 2e-3


def test_fireflies_are_not_taken_for_a_change(rng):
    frames = [sampled(scene(rng), rng) for _ in range(12)]
    for frame in frames:
        frame.reshape(-1)[rng.integers(frame.size, size=20)] = 1e30
    assert all(worth is None for worth in followed(frames))


def test_what_was_outside_of_the_last_frame_has_not_changed(rng):
    dark, bright = np.full(SIZE, 0.1), np.full(SIZE, 10.0)
    (worth,) = followed([sampled(dark, rng), sampled(bright, rng)], motion=(0, 1e6))
    assert worth is None


def test_small_frames_do_not_tell(rng):
    assert relight.brightness(np.ones((19, 400), np.float32), 1.0, STRIPS) is None
    assert relight.brightness(np.ones((20, 21), np.float32), 1.0, STRIPS) is not None


def test_threads_do_not_change_what_is_seen(rng):
    light = sampled(scene(rng), rng)
    one, three = (relight.brightness(light, 2.0, Strips(threads)) for threads in (1, 3))
    np.testing.assert_array_equal(one.mean, three.mean)
    np.testing.assert_array_equal(one.sure, three.sure)
    bounded = np.minimum(light, 128)  # 256 of what is exposed
    blocks = bounded[:144, :208].reshape(9, 16, 13, 16).mean((1, 3), dtype=np.float64)
    np.testing.assert_allclose(one.mean, blocks, rtol=1e-5)


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
