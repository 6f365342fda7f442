"""Frames and pixels count by their samples, and as ever where nobody says how many they have."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.frame import Frame
from stillray.model_spec.stages import ToldSamples
from stillray.models.registry import find_model
from stillray.stages.accumulate import FILLED_WEIGHT, accumulate
from stillray.stages.prepare import prepare
from stillray.stages.sample_counts import LEAST_SHARE, SampleCounts
from tests.conftest import make_frame

HEIGHT, WIDTH = 21, 34


def by_loop(frames, weights, counts, most):
    """Means and samples held, counted in samples all along, pixel by pixel in float64."""
    mean, held = np.zeros(frames.shape[1:]), np.zeros(frames.shape[1:3])
    for frame, weight, count in zip(frames, weights, counts, strict=True):
        usual = count[count > 0].mean()
        for at in np.ndindex(held.shape):
            own = count[at] if count[at] > 0 else usual
            # a past is worth so many frames like this one at most
            past = min(held[at], most * own)
            new = weight[at] * own if count[at] > 0 else FILLED_WEIGHT * own
            mean[at] = (past * mean[at] + new * frame[at]) / (past + new)
            held[at] = past + new
    return mean, held


def test_pixels_count_by_their_samples_as_a_loop_has_it(spec, rng):
    options = dataclasses.replace(spec.temporal, max_samples=3.0)
    frames = rng.random((6, 5, 7, 3)).astype(np.float32)
    weights = rng.uniform(0.1, 1, (6, 5, 7)).astype(np.float32)
    usual = np.float32([4, 4, 64, 1, 16, 16])[:, None, None]
    counts = usual * rng.uniform(0.1, 3, (6, 5, 7)).astype(np.float32)
    counts[rng.random(counts.shape) < 0.15] = 0
    planes, before, rows = np.zeros((4, 5, 7), np.float32), None, slice(0, 5)
    for frame, weight, count in zip(frames, weights, counts, strict=True):
        now = SampleCounts.of(count, before)
        now.held_by_pixel(planes[3], rows)
        own = np.where(count > 0, weight, np.float32(FILLED_WEIGHT))
        accumulate(np.ascontiguousarray(frame.transpose(2, 0, 1)), own, planes, options)
        now.by_frame(planes[3], rows)
        before = now.mean
    mean, held = by_loop(frames, weights, counts, options.max_samples)
    np.testing.assert_allclose(planes[:3].transpose(1, 2, 0), mean, rtol=1e-5)
    np.testing.assert_allclose(planes[3] * before, held, rtol=1e-5)


def histories(frames, spec):
    """What is remembered after each frame of a still scene."""
    found, past = [], None
    for frame in frames:
        past = prepare(frame, spec, past, Strips(1)).history
        found.append(past)
    return found


def noisy(samples, count=4):
    for seed, each in zip(range(count), samples, strict=True):
        yield dataclasses.replace(make_frame(HEIGHT, WIDTH, seed), samples=each)


def flat(value, samples):
    color = np.full((HEIGHT, WIDTH, 3), value, np.float32)
    return Frame(color=color, motion=np.zeros((HEIGHT, WIDTH, 2)), samples=samples)


@pytest.mark.parametrize("samples", [1, 16, 0.25, np.full((HEIGHT, WIDTH), 7.0)])
def test_the_same_samples_in_every_frame_change_nothing_that_is_accumulated(samples, spec):
    unknown = histories(noisy([None] * 4), spec)
    known = histories(noisy([samples] * 4), spec)
    for one, other in zip(unknown, known, strict=True):
        np.testing.assert_array_equal(one.mean, other.mean)


@pytest.mark.parametrize("scale", [1e-2, 3.0, 1e6])
def test_only_the_ratio_of_samples_counts(scale, spec, rng):
    maps = rng.integers(0, 9, (4, HEIGHT, WIDTH)).astype(np.float32)
    plain = histories(noisy(maps), spec)
    scaled = histories(noisy(maps * np.float32(scale)), spec)
    np.testing.assert_allclose(scaled[-1].mean, plain[-1].mean, rtol=1e-5)


def grainy(samples, seed):
    """A flat frame with noise: without any, another light would be a change, and no noise."""
    noise = np.random.default_rng(seed).uniform(0.5, 1.5, (HEIGHT, WIDTH, 1))
    return dataclasses.replace(flat(1.0, samples), color=np.repeat(noise, 3, -1))


def test_a_frame_of_many_samples_outweighs_a_past_of_few(spec):
    few, many = grainy(4, 0), grainy(64, 1)
    *_, last = histories([few, few, many], spec)
    # ordinary samples weigh up to 2 % less than 1
    wanted = (8 * few.color + 64 * many.color)[..., 0] / 72
    np.testing.assert_allclose(last.mean[..., 0], wanted, rtol=1e-2)
    np.testing.assert_allclose(last.mean[..., 3] * last.frame_samples, 72, rtol=3e-2)


def test_pixels_of_a_frame_count_by_their_own_samples(spec, rng):
    counts = rng.integers(3, 9, (3, HEIGHT, WIDTH)) * np.array([1, 4, 2])[:, None, None]
    frames = [grainy(count, seed) for seed, count in enumerate(counts)]
    *_, last = histories(frames, spec)
    light = sum(frame.color[..., 0] * count for frame, count in zip(frames, counts, strict=True))
    np.testing.assert_allclose(last.mean[..., 0], light / counts.sum(0), rtol=2e-2)
    np.testing.assert_allclose(last.mean[..., 3] * last.frame_samples, counts.sum(0), rtol=3e-2)


def test_noise_of_the_past_is_taken_as_that_of_frames_like_this_one(spec):
    quiet = grainy(64, 2)
    quiet = dataclasses.replace(quiet, color=1 + (quiet.color - 1) / 8)
    *_, last = histories([grainy(1, 0), grainy(1, 1), quiet], spec)
    variance = last.noise.variance.mean() / last.exposure**2
    assert variance < 2 * quiet.color.var()


def test_a_past_of_many_samples_is_worth_the_most_frames_of_few_but_no_more(spec):
    many, few = grainy(64, 0), grainy(1, 1)
    *_, last = histories([many, many, few], spec)
    most = spec.temporal.max_samples
    wanted = (most * many.color + few.color)[..., 0] / (most + 1)
    np.testing.assert_allclose(last.mean[..., 0], wanted, rtol=1e-2)


@pytest.mark.parametrize("samples", [(4, None, 4), (None, 4, 4), (4, 4, None)])
def test_a_frame_that_does_not_say_has_as_many_as_its_neighbours(samples, spec):
    told = histories(noisy(samples, 3), spec)[-1]
    unknown = histories(noisy([None] * 3, 3), spec)[-1]
    np.testing.assert_array_equal(told.mean, unknown.mean)
    assert told.frame_samples == 4
    assert unknown.frame_samples is None


def test_pixels_without_samples_keep_the_past_and_are_filled_without_one(spec):
    samples = np.full((HEIGHT, WIDTH), 8.0, np.float32)
    samples[3:6, 4:9] = 0
    broken = np.full((HEIGHT, WIDTH, 3), 1.2, np.float32)
    broken[3:6, 4:9] = 50  # whatever stands there
    hole = dataclasses.replace(flat(1.2, samples), color=broken)
    (alone,) = histories([hole], spec)
    np.testing.assert_allclose(alone.mean[..., 0], 1.2, rtol=1e-5)
    assert alone.mean[3:6, 4:9, 3].max() < 1e-5
    past, now = grainy(8, 0), grainy(samples, 1)
    *_, after = histories([past, now], spec)
    np.testing.assert_allclose(after.mean[3:6, 4:9, 0], past.color[3:6, 4:9, 0], rtol=1e-5)
    both = (past.color + now.color)[..., 0] / 2
    np.testing.assert_allclose(after.mean[8:, 0:3, 0], both[8:, 0:3], rtol=1e-2)


def test_a_frame_without_any_samples_is_as_one_without_a_finite_value(spec):
    empty = np.zeros((HEIGHT, WIDTH))
    _, nothing = histories([flat(1.0, 8), flat(3.0, empty)], spec)
    _, broken = histories([flat(1.0, 8), flat(np.nan, None)], spec)
    np.testing.assert_array_equal(nothing.mean, broken.mean)
    assert nothing.frame_samples == 8


def test_nan_counts_as_the_mean_of_the_others():
    samples = np.float32([[2, np.nan, 6, 0]])
    counts = SampleCounts.of(samples, None)
    assert counts.mean == 4
    np.testing.assert_allclose(counts.share, [[0.5, 1, 1.5, 1]])


def test_a_pixel_of_hardly_any_samples_still_has_a_weight_that_float32_holds():
    counts = SampleCounts.of(np.float32([[1e-30, 1e9]]), None)
    assert counts.share.min() == np.float32(LEAST_SHARE)


@pytest.mark.parametrize(
    ("samples", "told"), [(None, 1), (0.3, 0.3), (1, 1), (3, 1), (4, 1), (6, 1.5), (64, 16)]
)
def test_a_share_of_many_samples_is_told_and_no_fewer_than_one(samples, told):
    assert SampleCounts.of(samples, None).told(0.25) == pytest.approx(told)
    assert SampleCounts.of(samples, None).told() == (1 if samples is None else samples)


class Listening:
    """An engine that keeps what the network was last given."""

    def __init__(self, engine):
        self._engine = engine

    def run(self, graph, inputs):
        self.features = np.array(inputs["features"])
        return self._engine.run(graph, inputs)

    def close(self):
        self._engine.close()


@pytest.mark.parametrize("model", ["kpyr-5", "kpyr-5s"])
@pytest.mark.parametrize(
    ("samples", "told"), [((None, None), 1), ((16, 16), 16), ((4, 16), 16), ((16, None), 16)]
)
@pytest.mark.parametrize("share", [1.0, 0.25])
def test_the_network_is_told_the_samples_that_a_pixel_holds(model, samples, told, share):
    """Or a share of them, and one where nobody said."""
    info = find_model(model)
    learned = dataclasses.replace(info.spec.training, still_share=0.4)
    info = dataclasses.replace(
        info,
        spec=dataclasses.replace(
            info.spec, training=learned, told_samples=ToldSamples(share=share)
        ),
    )
    told = max(share * told, 1)
    with stillray.Denoiser(info) as denoiser:
        denoiser.engine = Listening(denoiser.engine)
        for seed, each in enumerate(samples):
            denoiser.denoise(dataclasses.replace(make_frame(64, 96, seed), samples=each))
        spec = denoiser.model.spec
        features = denoiser.engine.features
        held = denoiser.state.temporal.mean[..., 3].astype(np.float64) * told
    plane = features[0, spec.network.features.index("samples"), :64, :96]
    expected = np.sqrt(held / (held + spec.temporal.max_samples / 4))
    np.testing.assert_allclose(plane, expected, rtol=1e-5)


@pytest.mark.parametrize("model", ["wskp-3s", "nbg-7x3"])
def test_a_network_that_has_not_learned_with_samples_is_not_told(model):
    frame = make_frame(64, 96)
    assert not find_model(model).spec.knows_samples
    with stillray.Denoiser(model, temporal=False) as denoiser:
        unknown = denoiser.denoise(frame)
        np.testing.assert_array_equal(
            denoiser.denoise(dataclasses.replace(frame, samples=64)), unknown
        )


def test_a_map_of_equal_samples_is_a_number(rng):
    with stillray.Denoiser("kpyr-5s") as first, stillray.Denoiser("kpyr-5s") as second:
        for seed, samples in enumerate((4, 32, 8)):
            frame = make_frame(HEIGHT, WIDTH, seed)
            one = first.denoise(dataclasses.replace(frame, samples=samples))
            two = second.denoise(
                dataclasses.replace(frame, samples=np.full((HEIGHT, WIDTH, 1), samples))
            )
            np.testing.assert_array_equal(one, two)
