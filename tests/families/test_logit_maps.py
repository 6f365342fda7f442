"""Logits that come as integers weigh as the numbers that they stand for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families import kernel_pyramid as pyramid
from stillray.families.logit_maps import LogitMaps
from stillray.models.steps import InSteps, Steps, in_numbers
from stillray.stages.state import Filterable
from tests import oracles
from tests.families.test_depth_to_space import by_blocks
from tests.families.test_kernel_pyramid import OPTIONS, draw

STEPS = Steps(0.13, 120)  # up to 17.6 and -15.6: beyond the bound of 12


def integers_of(level, steps=STEPS):
    whole = np.rint(level / steps.scale) + steps.zero
    return InSteps(np.clip(whole, 0, 255).astype(np.uint8), steps)


@pytest.mark.parametrize("blocks", [False, True])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (9, 14), (41, 18)])
def test_a_picture_of_integers_is_that_of_their_numbers(height, width, blocks):
    options = dataclasses.replace(
        OPTIONS, finest_neighbours=(2,), finest_filters=(2, 1), filter_features=3, logit_bound=12.0
    )
    mean, sample, albedo, previous, logits = draw(height, width, spread=6.0, options=options)
    levels = [integers_of(level, Steps(0.13 + 0.02 * i, 120)) for i, level in enumerate(logits)]
    expected = oracles.kernel_pyramid(
        mean, sample, albedo, previous, in_numbers(levels), options, 0.05
    )
    if blocks:
        levels[0] = InSteps(by_blocks(levels[0].integers), levels[0].steps)
    light = Filterable(
        mean=mean, sample=sample, remodulation_albedo=albedo, previous=previous, exposure=0.05
    )
    for strips in (Strips(1), Strips(3), Strips(1, pixels=2 * width)):
        got = pyramid.filter_pyramid(light, levels, options, strips)
        # features that all lie at the bound: squares of hundreds cancel
        np.testing.assert_allclose(got, expected, rtol=5e-5)


def test_weights_are_bounded_exponentials(rng):
    integers = rng.integers(0, 256, (5, 7, 9), np.uint8)
    numbers = np.clip((integers.astype(np.float64) - 120) * np.float32(0.13), -12, 12)
    for maps in (
        LogitMaps(InSteps(integers, STEPS), 12.0, Strips(1)),
        LogitMaps(((integers - 120.0) * 0.13).astype(np.float32), 12.0, Strips(1)),
    ):
        assert maps.shape == (5, 7, 9)
        found = maps.weights(slice(1, 4), slice(2, 6), np.empty((3, 4, 8), np.float32))
        np.testing.assert_allclose(found, np.exp(numbers[1:4, 2:6, :8]), rtol=3e-6)
        one = maps.weight(4, slice(0, 7), np.empty((7, 9), np.float32))
        np.testing.assert_allclose(one, np.exp(numbers[4]), rtol=3e-6)
        bounded = maps.numbers(slice(0, 2), slice(0, 7), np.empty((2, 7, 9), np.float32))
        np.testing.assert_allclose(bounded, numbers[:2], rtol=3e-6, atol=1e-6)
