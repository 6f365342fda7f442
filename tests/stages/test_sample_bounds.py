"""What a filter makes of a mean stays within what the samples of that mean allow."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.stages.sample_bounds import bound_by_samples


def errors(count):
    """Standard errors: 1 of one sample, 2 of 4 and more."""
    return min(max(np.sqrt(count), 1.0), 2.0)


def oracle(filtered, given, samples):
    """Wilson 1927, pixel by pixel, in float64."""
    height, width = given.shape[:2]
    found = np.zeros(given.shape)
    for row, column, channel in np.ndindex(given.shape):
        rows = slice(max(row - 3, 0), min(row + 4, height))
        columns = slice(max(column - 3, 0), min(column + 4, width))
        near = given[rows, columns, channel].astype(float)
        least, span = near.min(), np.ptp(near)
        count = float(np.broadcast_to(samples, (height, width))[row, column])
        count = 1.0 if np.isnan(count) else max(count, 1.0)
        share = (given[row, column, channel] - least) / span if span else 0.0
        z = errors(count)
        middle = (share + z**2 / (2 * count)) / (1 + z**2 / count)
        off = z / (1 + z**2 / count) * np.sqrt(share * (1 - share) / count + z**2 / (4 * count**2))
        lowest, highest = least + span * (middle - off), least + span * (middle + off)
        found[row, column, channel] = np.clip(filtered[row, column, channel], lowest, highest)
    return found


@pytest.fixture
def strips():
    made = Strips(2)
    yield made
    made.close()


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (7, 3), (23, 31)])
@pytest.mark.parametrize("samples", [1.0, 4, 64, "map"])
def test_the_loop_oracle(rng, size, samples, strips):
    given = rng.random((*size, 3)).astype(np.float32)
    filtered = rng.random((*size, 3)).astype(np.float32)
    if samples == "map":
        samples = rng.integers(0, 40, size).astype(np.float32)
        samples[0, 0] = np.nan
    expected = oracle(filtered, given, samples)
    bound_by_samples(filtered, given, samples, strips)
    np.testing.assert_allclose(filtered, expected, atol=2e-5)


def test_many_samples_keep_a_joint_of_tiles_and_few_let_it_go(strips):
    given = np.full((24, 24, 3), 0.7, np.float32)
    given[::6] = 0.2
    moved = []
    for samples in (1, 4, 20, 64, 1024):
        filtered = np.full_like(given, 0.6)
        bound_by_samples(filtered, given, samples, strips)
        moved.append(np.abs(filtered - given)[::6].mean())
    assert moved[0] > 0.2
    assert moved == sorted(moved, reverse=True)
    assert moved[-1] < 0.002


@pytest.mark.parametrize("samples", [1, 4])
def test_true_means_of_few_samples_are_within_bounds(rng, samples, strips):
    """Samples of either of two values, half of each."""
    given = rng.binomial(samples, 0.5, (80, 80, 3)).astype(np.float32) / samples
    mean = np.full_like(given, 0.5)
    bound_by_samples(mean, given, samples, strips)
    assert np.mean(np.abs(mean - 0.5) < 1e-5) > 0.8


@pytest.mark.parametrize("samples", [4, 16])
def test_of_several_samples_more_than_half_of_the_noise_goes(rng, samples, strips):
    """As of glass and out of focus, of which a bound of one standard error leaves two thirds."""
    given = rng.binomial(samples, 0.5, (80, 80, 3)).astype(np.float32) / samples
    mean = np.full_like(given, 0.5)
    bound_by_samples(mean, given, samples, strips)
    assert mean.std() < 0.45 * given.std()


def test_what_is_no_number_bounds_nothing(rng, strips):
    given = rng.random((9, 9, 3)).astype(np.float32)
    given[4, 4] = np.nan
    filtered = np.full_like(given, 0.5)
    bound_by_samples(filtered, given, 256, strips)
    assert np.isfinite(filtered).all()
    assert (filtered[4, 4] == 0.5).all()
