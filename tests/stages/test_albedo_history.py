from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.frame import Frame
from stillray.model_spec import load
from stillray.stages import albedo_history, demodulate
from stillray.stages.reproject import positions_of
from tests import oracles
from tests.conftest import remembered

SPEC = load("wskp-3s")
OPTIONS = SPEC.temporal


def accumulate(albedo, past, positions=None, threads=1, samples=OPTIONS.albedo_samples):
    next_albedo, remodulation_albedo = np.empty_like(past), np.empty_like(albedo)
    out = (next_albedo, remodulation_albedo)
    albedo_history.accumulate(albedo, past, samples, positions, out, Strips(threads, pixels=60))
    return next_albedo, remodulation_albedo


def draw(rng, height, width):
    albedo = rng.uniform(0.1, 1, (height, width, 3)).astype(np.float32)
    albedo[rng.random((height, width)) < 0.03] = 1  # what has no albedo
    past = rng.uniform(0.1, 1, (height, width, 4)).astype(np.float32)
    past[..., 3] = 1
    return albedo, past


def moved(rng, height, width, far):
    """Where each pixel was, up to so many pixels off, in steps that float32 holds exactly."""
    steps = rng.integers(-256 * far, 256 * far, (height, width, 2), endpoint=True)
    motion = (steps / 256).astype(np.float32)
    return positions_of(motion, slice(0, height))


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (23, 18)])
@pytest.mark.parametrize("moves", [True, False])
@pytest.mark.parametrize("threads", [1, 3])
def test_the_mean_equals_the_loop_oracle(rng, height, width, moves, threads):
    albedo, past = draw(rng, height, width)
    positions = moved(rng, height, width, far=5 if moves else 0)
    found = accumulate(albedo, past, positions if moves else None, threads, samples=2.5)
    expected = oracles.accumulated_albedo(albedo, past, 2.5, positions)
    for got, wanted in zip(found, expected, strict=True):
        np.testing.assert_allclose(got, wanted, rtol=2e-6, atol=2e-6)


def test_the_mean_stays_in_the_range_of_the_pixels_around(rng):
    albedo, past = draw(rng, 40, 33)
    past[..., :3] *= 100
    got, _ = accumulate(albedo, past, moved(rng, 40, 33, far=5))
    padded = np.pad(albedo, ((1, 1), (1, 1), (0, 0)), mode="edge")
    around = [padded[a : a + 40, b : b + 33] for a in range(3) for b in range(3)]
    assert (got[..., :3] >= np.min(around, 0) - 1e-6).all()
    assert (got[..., :3] <= np.max(around, 0) + 1e-6).all()


def test_what_a_red_thing_has_uncovered_is_as_grey_as_it_is():
    """Tiles and dark grout, each pixel within the range of both: by channels alone grout is red."""
    tiles = np.where(np.arange(24) % 3, 0.6, 0.2)[None, :, None]
    albedo = np.ascontiguousarray(np.broadcast_to(tiles, (16, 24, 3)), np.float32)
    past = np.ones((16, 24, 4), np.float32)
    past[..., :3] = 0.9, 0.3, 0.3
    got, _ = accumulate(albedo, past)
    assert np.ptp(got[..., :3], axis=2).max() < 1e-6
    # and a past of the same tint is kept
    past[..., :3] = 0.5
    got, _ = accumulate(albedo, past, samples=1)
    inner = np.s_[:, 1:-1, :3]
    np.testing.assert_allclose(got[inner], (albedo[inner] + 0.5) / 2, rtol=1e-6)


def test_what_comes_from_outside_is_this_frame_s_alone(rng):
    albedo, past = draw(rng, 9, 14)
    got, remodulation_albedo = accumulate(albedo, past, np.full((9, 14, 2), 1e6, np.float32))
    np.testing.assert_allclose(remodulation_albedo, albedo, rtol=2e-7)
    np.testing.assert_allclose(got[..., :3], albedo, rtol=2e-7)


def test_beside_what_has_no_albedo_nothing_gets_brighter():
    # dark leaves before a sky, whose edge a jittered camera samples on either side
    past = np.empty((33, 46, 4), np.float32)
    changed = 0
    for index, shift in enumerate(np.random.default_rng(0).random((6, 2))):
        albedo = np.where(covered(0.4, shift) > 0.5, 0.1, 1.0)[..., None]
        albedo = np.repeat(albedo, 3, 2).astype(np.float32)
        if index == 0:
            albedo_history.begin(albedo, past)
            continue
        past, remodulation_albedo = accumulate(albedo, past)
        assert (remodulation_albedo <= albedo).all()
        changed += int((remodulation_albedo < albedo).sum())
    assert changed


def test_an_albedo_that_stays_is_what_it_was(rng):
    albedo, _ = draw(rng, 9, 14)
    next_albedo = np.empty((9, 14, 4), np.float32)
    albedo_history.begin(albedo, next_albedo)
    for _ in range(1000):
        next_albedo, remodulation_albedo = accumulate(albedo, next_albedo)
    np.testing.assert_allclose(remodulation_albedo, albedo, rtol=2e-7)


def test_each_of_the_first_frames_counts_alike():
    # an albedo that is 0.2 in the first frame and 0.8 in all others, in reach of one another
    spec = load("wskp-3s")
    motion = np.zeros((9, 14, 2), np.float32)
    stripes = np.where(np.arange(14) % 2, 0.2, 0.8)[None, :, None]
    frames = [np.broadcast_to(one, (9, 14, 3)) for one in (stripes, stripes[:, ::-1])]
    held = []
    with stillray.Denoiser(spec.name) as denoiser:
        for index in range(6):
            albedo = frames[min(index, 1)].astype(np.float32)
            denoiser.denoise(Frame(color=albedo, albedo=albedo, motion=motion))
            mean = remembered(denoiser).mean_albedo[4, 6, 0]
            held.append((mean - albedo[4, 6, 0]) / (frames[0][4, 6, 0] - albedo[4, 6, 0] + 1e-9))
    # what is left of the first: 1/2, 1/3, ..., until the past is worth no more
    np.testing.assert_allclose(held[1:5], [1 / 2, 1 / 3, 1 / 4, 1 / 5], rtol=1e-4)
    np.testing.assert_allclose(held[5], 4 / 25, rtol=1e-4)


def covered(slope, shift):
    """An edge that leans, sampled at one point of each pixel: albedo 0.9 beyond it, else 0.2."""
    row, column = np.mgrid[0:33, 0:46]
    beyond = column + shift[0] > 20 + slope * (row + shift[1])
    return np.where(beyond, 0.9, 0.2)


def test_stairs_of_an_edge_are_smoothed_by_jittered_frames():
    # the light is the same everywhere: all that a picture shows is the albedo
    spec = load("wskp-3s")
    assert spec.temporal.albedo_samples > 0
    shifts = [((i * 0.618 + 0.3) % 1, (i * 0.414 + 0.7) % 1) for i in range(9)]
    fine = [(a / 16, b / 16) for a in range(16) for b in range(16)]
    wanted = np.mean([covered(0.4, shift) for shift in fine], axis=0)
    alone = covered(0.4, shifts[-1])
    depth = np.full(wanted.shape, 2, np.float32)
    with stillray.Denoiser("wskp-3s") as denoiser:
        for shift in shifts:
            albedo = np.repeat(covered(0.4, shift)[..., None], 3, 2).astype(np.float32)
            motion = np.zeros((*wanted.shape, 2), np.float32)
            frame = Frame(color=albedo * 0.5, albedo=albedo, depth=depth, motion=motion)
            image = denoiser.denoise(frame)
    error = np.abs(image[..., 0] / 0.5 - wanted).mean()
    assert error < 0.4 * np.abs(alone - wanted).mean()


@pytest.mark.parametrize(("samples", "frames"), [(None, 4), (1, 4), (2, 4), (16, 0.5), (64, 0.125)])
def test_frames_of_many_samples_need_less_of_an_albedos_past(samples, frames):
    """What a thing has uncovered is soon itself: a past that counts as 4 frames of few samples."""
    still, shape = np.zeros((12, 16, 2), np.float32), (12, 16, 3)
    color = np.full(shape, 0.3, np.float32)
    before, after = (np.full(shape, albedo, np.float32) for albedo in (0.2, 0.4))
    after[::2] = 0.2  # so that the past is within the range of the pixels around
    with stillray.Denoiser("wskp-3s") as denoiser:
        for albedo in [before] * 6 + [after]:
            frame = Frame(color=color, albedo=albedo, motion=still, samples=samples)
            denoiser.denoise(frame)
        mean = denoiser.state.temporal.mean_albedo[1, 8, 0]
    divisors = demodulate.demodulation_albedo(after, SPEC.demodulate)[:2, 8, 0]
    old, new = map(float, divisors)
    np.testing.assert_allclose(mean, (frames * old + new) / (frames + 1), rtol=1e-4)


def test_without_motion_or_albedo_or_a_past_it_is_not_run(rng):
    albedo = rng.random((9, 14, 3)).astype(np.float32)
    motion = np.zeros((9, 14, 2), np.float32)
    whole = Frame(color=albedo, albedo=albedo, motion=motion)
    for temporal, frame, runs in (
        (True, whole, True),
        (False, whole, False),
        (True, dataclasses.replace(whole, motion=None), False),
        (True, dataclasses.replace(whole, albedo=None), False),
    ):
        with stillray.Denoiser("wskp-3s", temporal=temporal) as denoiser:
            denoiser.denoise(frame)
            assert "accumulate_albedo" not in denoiser.last_timings
            planned = {stage.name: stage.runs for stage in denoiser.stages(frame)}
            denoiser.denoise(frame)
            assert (
                ("accumulate_albedo" in denoiser.last_timings)
                == planned["accumulate_albedo"]
                == runs
            )


def test_after_a_frame_without_albedo_it_begins_anew(rng):
    albedo = rng.random((9, 14, 3)).astype(np.float32)
    frame = Frame(color=albedo, albedo=albedo, motion=np.zeros((9, 14, 2), np.float32))
    with stillray.Denoiser("wskp-3s") as denoiser:
        denoiser.denoise(dataclasses.replace(frame, albedo=None))
        for runs in (False, True):
            planned = {stage.name: stage.runs for stage in denoiser.stages(frame)}
            denoiser.denoise(frame)
            assert (
                ("accumulate_albedo" in denoiser.last_timings)
                == planned["accumulate_albedo"]
                == runs
            )
