from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families import bilateral_grid as grid
from stillray.model_spec import SpecError, load
from tests import oracles

ONE, THREE = load("nbg-2x1"), load("nbg-2x3")
SIZES = [(1, 1), (3, 5), (16, 17), (33, 18)]  # most are smaller than the cells of 16 pixels
# A place is rounded to 4e-6 of a cell: that share of the brightest neighbour may come over.
ROUNDING = 1e-5


def draw(height, width, options, seed=0):
    """Random decoder input: mean and maps."""
    rng = np.random.default_rng(seed)
    light, samples = rng.lognormal(0, 1, (height, width, 3)), rng.uniform(0.01, 16, (height, width))
    maps = rng.uniform(0, 1, (2 * options.grids - 1, height, width))
    return np.dstack([light, samples]).astype(np.float32), maps.astype(np.float32)


def run(mean, maps, options, threads=1):
    image = grid.filter_grids(mean, maps, options, Strips(threads))
    few_rows = grid.filter_grids(mean, maps, options, Strips(1, pixels=1))
    np.testing.assert_allclose(few_rows, image, rtol=1e-5, atol=1e-30)
    return image


def check(mean, maps, options):
    got, expected = run(mean, maps, options), oracles.bilateral_grids(mean, maps, options)
    np.testing.assert_allclose(got, expected, atol=ROUNDING * mean[..., :3].max())


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("spec", [ONE, THREE], ids=["one", "three"])
def test_grids_equal_the_loop_oracle(size, spec):
    check(*draw(*size, spec.decoder), spec.decoder)


def test_other_rates_and_plain_weights_equal_the_loop_oracle():
    options = dataclasses.replace(
        THREE.decoder, grids=2, spacing=3, depth_spacing=5.0, weigh_samples=False
    )
    check(*draw(10, 11, options), options)


@pytest.mark.parametrize("value", [0.0, 1.0, 128 / 255, -3.0, 1e30, np.inf])
def test_constant_guides_equal_the_loop_oracle(value):
    mean, maps = draw(9, 14, THREE.decoder)
    maps[:3] = value
    check(mean, maps, THREE.decoder)


def test_a_guide_that_is_not_a_number_is_the_middle_and_its_neighbours_do_not_notice():
    mean, maps = draw(9, 14, THREE.decoder)
    maps[0, 4, 5] = maps[3, 2, 2] = np.nan
    middle = np.nan_to_num(maps, nan=0.5)
    np.testing.assert_array_equal(run(mean, maps, THREE.decoder), run(mean, middle, THREE.decoder))


def test_cells_that_hold_nothing_are_left_out():
    mean, maps = draw(17, 12, THREE.decoder)
    mean[np.random.default_rng(1).random((17, 12)) < 0.7, 3] = 0
    mean[..., :3] += 1
    with np.errstate(all="raise"):
        check(mean, maps, THREE.decoder)
    assert (run(mean, maps, ONE.decoder).max(-1) == 0).any()  # a pixel with nothing at all
    mean[..., 3] = 0
    assert (run(mean, maps, THREE.decoder) == 0).all()


def test_a_black_cell_is_not_an_empty_one():
    mean, maps = draw(4, 4, ONE.decoder)
    mean[..., :3], mean[0, 0, :3] = 0, 8
    maps[:] = 0
    maps[:, 0, 0] = 2 / 255  # half in the black cells
    got = run(mean, maps, ONE.decoder)[0, 0, 0]
    assert 0 < got < 8


@pytest.mark.parametrize("seed", range(3))
def test_no_light_is_invented(seed):
    mean, maps = draw(33, 18, THREE.decoder, seed)
    mean[5, 5, :3] = 1e30
    got = run(mean, maps, THREE.decoder)
    assert np.isfinite(got).all()
    light = mean[..., :3].reshape(-1, 3)
    assert (got >= light.min(0) * (1 - ROUNDING)).all()
    assert (got <= light.max(0) * (1 + ROUNDING)).all()


def test_constant_light_stays_constant_whatever_the_guides():
    mean, maps = draw(33, 18, THREE.decoder)
    mean[..., :3] = 3.7
    np.testing.assert_allclose(run(mean, maps, THREE.decoder), 3.7, rtol=1e-5)


def test_an_edge_of_the_guide_is_not_crossed():
    mean, maps = draw(20, 31, THREE.decoder)
    mean[..., :3] = 1
    mean[:, 13:, :3] = 5e6
    maps[:3] = 0.2
    maps[:3, :, 13:] = 0.8
    got = run(mean, maps, THREE.decoder)
    np.testing.assert_allclose(got[:, :13], 1, rtol=1e-5)
    np.testing.assert_allclose(got[:, 13:], 5e6, rtol=1e-5)


@pytest.mark.parametrize("spec", [ONE, THREE], ids=["one", "three"])
def test_light_goes_as_far_as_the_reach_and_no_further(spec):
    farthest = 0
    for column in range(16, 32):
        mean, maps = draw(1, 80, spec.decoder)
        mean[..., :3], mean[0, column, :3] = 0, 1
        maps[:] = 0.5
        lit = np.flatnonzero(run(mean, maps, spec.decoder)[0, :, 0])
        farthest = max(farthest, int(abs(lit - column).max()))
    assert farthest == grid.BilateralGridModel(spec).looks.reach


def test_threads_do_not_change_the_picture_nor_do_the_borders_of_strips():
    mean, maps = draw(100, 900, THREE.decoder)  # four strips
    one, three = (run(mean, maps, THREE.decoder, threads) for threads in (1, 3))
    np.testing.assert_array_equal(one, three)
    # what is farther than the reach is not seen: a part alone, one strip, gives the same
    reach = grid.BilateralGridModel(THREE).looks.reach
    left = 16 * (-(-reach // 16))
    part = run(mean[:, : 96 + reach], maps[..., : 96 + reach], THREE.decoder)
    np.testing.assert_allclose(part[:, : 96 - left], one[:, : 96 - left], rtol=1e-4)


def test_filter_is_linear_in_colour():
    mean, maps = draw(15, 15, THREE.decoder)
    plain = run(mean, maps, THREE.decoder)
    parts = [mean.copy(), mean.copy()]
    parts[0][..., :3] *= 0.25
    parts[1][..., :3] *= 0.75
    together = sum(run(part, maps, THREE.decoder) for part in parts)
    np.testing.assert_allclose(together, plain, rtol=1e-5)


@pytest.mark.parametrize(
    ("key", "value", "rule"),
    [
        ("grids", 0, "decoder.grids must be in"),
        ("spacing", 0, "decoder.spacing must be in"),
        ("depth_spacing", 0.5, "decoder.depth_spacing must be in"),
    ],
)
def test_a_value_beyond_its_rule_is_named(key, value, rule):
    with pytest.raises(SpecError, match=rule):
        dataclasses.replace(THREE.decoder, **{key: value})
