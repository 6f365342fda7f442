from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips, planes_of
from stillray.families import kernel_pyramid as pyramid
from stillray.families.pyramid_logits import level_layout, level_logits
from stillray.model_spec import load
from stillray.stages.state import Filterable
from tests import oracles
from tests.families.test_depth_to_space import by_blocks

OPTIONS = load("kpyr-5").decoder


def filtered(mean, sample, albedo, previous, logits, options, strips, exposure=1.0, recalled=None):
    light = Filterable(
        mean=mean,
        sample=sample,
        remodulation_albedo=albedo,
        previous=previous,
        exposure=exposure,
        recalled=recalled,
    )
    image = pyramid.filter_pyramid(light, logits, options, strips)
    few_rows = Strips(1, pixels=2 * mean.shape[1])
    np.testing.assert_array_equal(pyramid.filter_pyramid(light, logits, options, few_rows), image)
    return image


SAMPLE_BLEND = level_layout(0, 3, OPTIONS).sample_blend
LEVELS = 3  # what is tested holds for any number; three keep the oracle quick


def draw(height, width, seed=0, spread=2.0, options=OPTIONS):
    """Random decoder input: mean, sample, albedo, previous output, logits of the padded size."""
    rng = np.random.default_rng(seed)
    step = 1 << (LEVELS - 1)
    padded = [-(-size // step) * step for size in (height, width)]
    mean = np.dstack(
        [rng.lognormal(0, 2, (height, width, 3)), rng.uniform(1e-3, 16, (height, width))]
    )
    sample = np.concatenate(
        [rng.lognormal(0, 3, (3, height, width)), rng.uniform(1e-6, 1, (1, height, width))]
    )
    albedo = rng.uniform(0.1, 1, (height, width, 3))
    previous = np.dstack(
        [rng.lognormal(0, 2, (height, width, 3)), rng.uniform(0, 1, (height, width))]
    )
    logits = [
        rng.normal(
            size=(
                level_logits(level, LEVELS, options),
                *(s >> level for s in padded),
            )
        )
        * spread
        for level in range(LEVELS)
    ]
    single = [array.astype(np.float32) for array in (mean, sample, albedo, previous)]
    return (*single, [level.astype(np.float32) for level in logits])


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (9, 14), (16, 8)])
@pytest.mark.parametrize("spread", [2.0, 1e4])
def test_pyramid_equals_the_loop_oracle(height, width, spread):
    mean, sample, albedo, previous, logits = draw(height, width, spread=spread)
    exposure = 0.05
    got = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(1), exposure)
    expected = oracles.kernel_pyramid(mean, sample, albedo, previous, logits, OPTIONS, exposure)
    # float32 sums of at most 25 products at each of three levels; of features that all lie at the
    # bound squares of hundreds cancel
    np.testing.assert_allclose(got, expected, rtol=5e-6 if spread < 10 else 5e-5)


def test_one_kernel_a_level_equals_the_loop_oracle():
    options = dataclasses.replace(OPTIONS, kernel_sizes=(5,))
    inputs = draw(9, 14, options=options)
    got = filtered(*inputs, options, Strips(1))
    np.testing.assert_allclose(got, oracles.kernel_pyramid(*inputs, options), rtol=5e-6)


def test_a_finest_level_without_kernels_equals_the_loop_oracle():
    options = dataclasses.replace(OPTIONS, finest_kernels=False)
    inputs = draw(9, 14, options=options)
    got = filtered(*inputs, options, Strips(1))
    np.testing.assert_allclose(got, oracles.kernel_pyramid(*inputs, options), rtol=5e-6)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (3, 5), (9, 14), (70, 18)])
def test_predicted_weights_of_neighbours_equal_the_loop_oracle(height, width):
    options = dataclasses.replace(OPTIONS, kernel_sizes=(5,), finest_kernels=False, predicted=True)
    inputs = draw(height, width, options=options)
    expected = oracles.kernel_pyramid(*inputs, options)
    for threads in (1, 3):
        got = filtered(*inputs, options, Strips(threads))
        np.testing.assert_allclose(got, expected, rtol=5e-6)


@pytest.mark.parametrize("distances", [(1,), (1, 2), (3,)])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 1), (9, 14), (41, 18)])
def test_weights_of_the_finest_levels_neighbours_equal_the_loop_oracle(height, width, distances):
    options = dataclasses.replace(OPTIONS, finest_neighbours=distances, logit_bound=12.0)
    inputs = draw(height, width, options=options)
    expected = oracles.kernel_pyramid(*inputs, options)
    for threads in (1, 3):
        got = filtered(*inputs, options, Strips(threads))
        np.testing.assert_allclose(got, expected, rtol=5e-6)


@pytest.mark.parametrize("tone", [0.0, 0.2, 3.0])
@pytest.mark.parametrize("distances", [(1,), (2, 1), (40,), (4, 2, 1)])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 1), (9, 14), (41, 18)])
def test_filters_of_the_finest_level_equal_the_loop_oracle(height, width, distances, tone):
    options = dataclasses.replace(
        OPTIONS, finest_neighbours=(2,), finest_filters=distances, filter_features=3,
        filter_tone=tone,
    )  # fmt: skip
    inputs = draw(height, width, options=options)
    exposure = 0.4
    expected = oracles.kernel_pyramid(*inputs, options, exposure)
    for strips in (Strips(1), Strips(3), Strips(1, pixels=64)):
        got = filtered(*inputs, options, strips, exposure)
        np.testing.assert_allclose(got, expected, rtol=5e-6)


@pytest.mark.parametrize("distances", [(1,), (4, 2), (30, 3, 1)])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (2, 1), (9, 14), (41, 18)])
def test_an_averaged_albedo_equals_the_loop_oracle(height, width, distances):
    options = dataclasses.replace(OPTIONS, albedo_filters=distances)
    inputs = draw(height, width, options=options)
    expected = oracles.kernel_pyramid(*inputs, options)
    for strips in (Strips(1), Strips(3), Strips(1, pixels=64)):
        got = filtered(*inputs, options, strips)
        np.testing.assert_allclose(got, expected, rtol=5e-6)


def test_a_last_output_weighs_what_the_frame_recalls_of_it(rng):
    height, width = 9, 14
    mean, sample, albedo, previous, logits = draw(height, width)
    recalled = rng.random((height, width), np.float32)
    got = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(2), recalled=recalled)
    weighed = previous.astype(np.float64)
    weighed[..., 3] *= recalled
    expected = oracles.kernel_pyramid(mean, sample, albedo, weighed, logits, OPTIONS)
    np.testing.assert_allclose(got, expected, rtol=5e-6)
    whole = np.ones((height, width), np.float32)
    plain = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(2))
    got = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(2), recalled=whole)
    np.testing.assert_array_equal(got, plain)


def filters_alone(height, width, options):
    """Logits of two levels by which the finest is its own light, filtered; and their layout."""
    layout = level_layout(0, 2, options)
    logits = [
        np.zeros((layout.filters.stop, height, width), np.float32),
        np.zeros((level_layout(1, 2, options).double.stop, height // 2, width // 2), np.float32),
    ]
    logits[0][layout.blend][0] = 12  # of the blend itself alone
    logits[0][layout.resolve] = logits[0][layout.sample_blend] = -1e9
    return layout, logits


def test_filters_follow_what_looks_alike_and_stop_at_the_rest():
    options = dataclasses.replace(
        OPTIONS, kernel_sizes=(1,), finest_kernels=False, predicted=False, finest_neighbours=(),
        finest_filters=(4, 2, 1), filter_features=1, filter_tone=0.0, logit_bound=12.0,
    )  # fmt: skip
    height, width = 24, 32
    layout, logits = filters_alone(height, width, options)
    rim = (slice(None), slice(10, 12))  # two columns, of a light of their own
    logits[0][layout.features][0][rim] = 8
    light = np.ones((height, width, 3), np.float32)
    light[rim] = 50 * np.random.default_rng(1).uniform(0.5, 1.5, (height, 2, 1))
    mean = np.dstack([light, np.ones((height, width), np.float32)])
    got = filtered(mean, None, None, None, logits, options, Strips(1))
    beside = np.delete(got, np.r_[10:12], axis=1)
    np.testing.assert_allclose(beside, 1, rtol=1e-3)  # e^-24 of the blend is the coarser level's
    assert got[rim].std() < 0.35 * light[rim].std()
    np.testing.assert_allclose(got[rim].mean(), light[rim].mean(), rtol=0.03)


def test_light_of_a_window_does_not_reach_a_dark_bar_by_the_last_filters():
    options = dataclasses.replace(
        OPTIONS, kernel_sizes=(1,), finest_kernels=False, predicted=False, finest_neighbours=(),
        finest_filters=(2, 1), filter_features=1, resolve_tone=0.0,
    )  # fmt: skip
    height, width = 24, 32
    layout, logits = filters_alone(height, width, options)
    bar = np.s_[:, 10:12]
    logits[0][layout.features][0][bar] = 1.5  # e^-2.25: somewhat unlike the window around it
    mean = np.full((height, width, 4), 50, np.float32)
    mean[bar][..., :3] = 0.5
    mean[..., 3] = 1

    def at(exposure, tone):
        toned = dataclasses.replace(options, filter_tone=tone)
        got = filtered(mean, None, None, None, logits, toned, Strips(1), exposure)
        return got[bar].mean(), got[:, :4].mean()

    (leaks, window), (kept, same) = at(1.0, 0.0), at(1.0, 0.3)
    assert leaks > 5
    assert kept < 1.5
    np.testing.assert_allclose(same, window, rtol=1e-3)
    # of a scene shown so dark that its window is no brighter than white nothing changes
    np.testing.assert_allclose(at(1 / 51, 0.3), at(1 / 51, 0.0), rtol=1e-6)


@pytest.mark.parametrize(("height", "width"), [(1, 1), (9, 14), (150, 70)])
def test_logits_that_come_by_blocks_are_those_of_the_pixels(height, width):
    *buffers, logits = draw(height, width)
    blocks = by_blocks(logits[0])
    expected = filtered(*buffers, logits, OPTIONS, Strips(1))
    for threads in (1, 3):
        got = filtered(*buffers, [blocks, *logits[1:]], OPTIONS, Strips(threads))
        np.testing.assert_array_equal(got, expected)


def coarser_alone(light, beside, above):
    """A finest level that takes nothing but the coarser one, of this light and these logits."""
    options = dataclasses.replace(
        OPTIONS, kernel_sizes=(1,), finest_kernels=False, predicted=False, finest_neighbours=(),
        finest_filters=(), filter_features=0,
    )  # fmt: skip
    height, width = light.shape[:2]
    fine = np.repeat(np.repeat(light, 2, 0), 2, 1)
    layouts = [level_layout(level, 2, options) for level in range(2)]
    logits = [
        np.zeros((layout.double.stop, height * scale, width * scale), np.float32)
        for layout, scale in zip(layouts, (2, 1), strict=True)
    ]
    for part in (layouts[0].blend, layouts[0].resolve, layouts[0].sample_blend):
        logits[0][part] = -1e9
    logits[1][layouts[1].double] = np.concatenate([beside, above])
    mean = np.dstack([fine, np.ones(fine.shape[:2])]).astype(np.float32)
    options = dataclasses.replace(options, logit_bound=20.0)
    return filtered(mean, None, None, None, logits, options, Strips(1))


def test_doubling_continues_a_slope():
    y, x = np.mgrid[:9, :13]
    light = np.stack([5 + x + 2 * y, 40 - 3 * x + y, np.full(x.shape, 2)], -1)
    even = np.zeros((4, 9, 13), np.float32)
    got = coarser_alone(light, even, even)
    y, x = (np.mgrid[:18, :26] - 0.5) / 2
    wanted = np.stack([5 + x + 2 * y, 40 - 3 * x + y, np.full(x.shape, 2)], -1)
    np.testing.assert_allclose(got[1:-1, 1:-1], wanted[1:-1, 1:-1], rtol=1e-6)


def test_doubling_takes_nothing_from_beyond_an_edge_that_the_network_found():
    light = np.ones((6, 8, 3))
    light[:, 4:] = 100  # an edge between columns
    light[3:, :] *= 7  # and one between rows
    beside, above = (np.zeros((4, 6, 8), np.float32) for _ in range(2))
    beside[[1, 3], :, 3] = beside[[0, 2], :, 4] = -1e9
    above[[2, 3], 2] = above[[0, 1], 3] = -1e9
    got = coarser_alone(light, beside, above)
    # e^-20 of light that is seven hundred times as bright
    np.testing.assert_allclose(got, np.repeat(np.repeat(light, 2, 0), 2, 1), rtol=1e-5)
    even = np.zeros_like(beside)
    assert np.abs(coarser_alone(light, even, even) - got).max() > 10


def test_threads_and_strips_do_not_change_the_picture():
    mean, sample, albedo, previous, logits = draw(150, 70)
    one = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(1))
    three = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(3))
    np.testing.assert_array_equal(one, three)


def test_constant_light_stays_constant_whatever_the_logits():
    mean, sample, _, previous, logits = draw(33, 18, spread=50)
    mean[..., :3] = sample[:3] = previous[..., :3] = 3.7
    got = filtered(mean, sample, None, previous, logits, OPTIONS, Strips(1))
    np.testing.assert_allclose(got, 3.7, rtol=1e-5)


@pytest.mark.parametrize("seed", range(5))
def test_no_light_is_invented(seed):
    mean, sample, _, previous, logits = draw(33, 18, seed, spread=20)
    mean[5, 5, :3] = 1e30
    got = filtered(mean, sample, None, previous, logits, OPTIONS, Strips(1))
    given = (mean, np.moveaxis(sample, 0, -1), previous)
    both = np.concatenate([part[..., :3].reshape(-1, 3) for part in given])
    assert np.isfinite(got).all()
    assert (got >= both.min(0) * (1 - 1e-5)).all()
    assert (got <= both.max(0) * (1 + 1e-5)).all()


def test_a_logit_that_is_not_a_number_says_nothing():
    mean, sample, albedo, previous, logits = draw(9, 14)
    logits[1][2, 1, 1] = np.nan
    zero = [level.copy() for level in logits]
    zero[1][2, 1, 1] = 0
    got, expected = (
        filtered(mean, sample, albedo, previous, maps, OPTIONS, Strips(1))
        for maps in (logits, zero)
    )
    np.testing.assert_array_equal(got, expected)


def test_invalid_previous_output_is_not_used():
    mean, sample, albedo, previous, logits = draw(9, 14)
    previous[..., 3] = 0
    got = filtered(mean, sample, albedo, previous, logits, OPTIONS, Strips(1))
    without = filtered(mean, sample, albedo, None, logits, OPTIONS, Strips(1))
    np.testing.assert_array_equal(got, without)


def test_one_frame_alone_needs_no_sample_beside_itself():
    mean, _, albedo, previous, logits = draw(9, 14)
    alone = filtered(mean, None, albedo, previous, logits, OPTIONS, Strips(1))
    logits[0][SAMPLE_BLEND] = -100  # nothing is renewed: the accumulated light is left as it is
    same = planes_of(mean)
    got = filtered(mean, same, albedo, previous, logits, OPTIONS, Strips(1))
    # the bound of the logits leaves a share of exp(-8), which changes the samples held
    np.testing.assert_allclose(got, alone, rtol=1e-2)


def test_a_past_that_does_not_hold_can_be_let_go():
    mean, sample, _, _, logits = draw(9, 14)
    mean[..., :3], sample[:3] = 5.0, 1.0
    mean[..., 3], sample[3] = 17.0, 1.0
    logits[0][SAMPLE_BLEND] = 100
    got = filtered(mean, sample, None, None, logits, OPTIONS, Strips(1))
    assert got.max() < 1.03  # exp(8) to 17


@pytest.mark.parametrize("model", ["kpyr-5", "kpyr-5s"])
def test_the_last_rows_of_a_frame_that_is_no_whole_blocks_are_as_clean_as_the_first(model):
    """They are carried on to whole blocks, the first are not; at any border less is around."""
    height, width = 104, 64  # 6.5 of the largest blocks
    normal = np.broadcast_to(np.float32([0, 1, 0]), (height, width, 3))
    depth = np.repeat(5 + 0.02 * np.arange(height, 0, -1, dtype=np.float32)[:, None], width, 1)
    last, first = 0.0, 0.0
    with stillray.Denoiser(model, temporal=False) as denoiser:
        for seed in range(48):  # of eight the draws alone decide
            rng = np.random.default_rng(seed)
            lit = rng.random((height, width, 1)) < 0.3
            light = rng.exponential(1 / 0.3, (height, width, 1)) * lit  # 1 in the mean
            color = np.repeat(0.5 * light, 3, axis=2).astype(np.float32)
            frame = stillray.Frame(
                color=color, albedo=np.full_like(color, 0.5), normal=normal, depth=depth
            )
            error = np.abs(denoiser.denoise(frame) - 0.5)
            last += error[-4:].mean()
            first += error[:4].mean()
    assert last < 1.2 * first
