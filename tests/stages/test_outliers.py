"""Outliers are replaced, and nothing else."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.model_spec import load
from stillray.model_spec.loader import from_json
from stillray.model_spec.rules import SpecError
from stillray.stages.decide import Wants, decide
from stillray.stages.outliers import remove_outliers
from stillray.stages.prepare import prepare

REC709 = np.array([0.2126, 0.7152, 0.0722])


def slow(color, deviations):
    """Pixel by pixel in float64, the last pixels repeated beyond the edge."""
    height, width = color.shape[:2]
    result = color.astype(np.float64)
    for y, x in np.ndindex(height, width):
        window = np.array(
            [
                color[min(max(y + i, 0), height - 1), min(max(x + j, 0), width - 1)]
                for i in (-1, 0, 1)
                for j in (-1, 0, 1)
            ],
            np.float64,
        )
        light = window @ REC709
        if light[4] > light.mean() * (1 + 1e-6) + deviations * light.std():
            result[y, x] = np.median(window, axis=0)
    return result


@pytest.mark.parametrize("deviations", [0.5, 1.5, 2.0])
@pytest.mark.parametrize("size", [(1, 1), (2, 3), (13, 9)])
def test_it_equals_the_loop_oracle(rng, size, deviations):
    color = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    got = remove_outliers(color, deviations, Strips(1))
    np.testing.assert_allclose(got, slow(color, deviations), rtol=1e-6)


def test_a_firefly_goes_and_its_neighbours_stay(rng):
    color = rng.uniform(0.9, 1.1, (150, 40, 3)).astype(np.float32)
    given = color.copy()
    given[75, 20] = 1e30
    got = remove_outliers(given, 2.0, Strips(2))
    assert got[75, 20].max() < 1.1
    beside = np.abs(np.indices((150, 40)) - np.array([75, 20])[:, None, None]).max(0) == 1
    # beside a firefly nothing else stands out
    np.testing.assert_array_equal(got[beside], given[beside])
    # and none of nine pixels can stand out by more than the root of 8 deviations
    np.testing.assert_array_equal(remove_outliers(given, 2.83, Strips(1)), given)


def test_a_flat_picture_stays_as_it_is():
    color = np.full((20, 30, 3), np.float32(0.1))
    np.testing.assert_array_equal(remove_outliers(color, 0.01, Strips(1)), color)


def test_a_model_that_asks_for_it_gets_it_and_others_do_not(rng):
    spec = load("nbg-7x3")
    asks = dataclasses.replace(
        spec, temporal=dataclasses.replace(spec.temporal, outlier_deviations=2.0)
    )
    color = rng.uniform(0.9, 1.1, (20, 30, 3)).astype(np.float32)
    color[7, 8] = 1e4
    frame = Frame(color=color)
    names = [
        [stage.name for stage in decide(frame, one, None, Strips(1), {}, Wants()).stages]
        for one in (spec, asks)
    ]
    assert "remove_outliers" not in names[0]
    assert names[1] == [*names[0][:2], "remove_outliers", *names[0][2:]]
    kept, removed = (prepare(frame, one, None, Strips(1)).history.mean for one in (spec, asks))
    assert kept[7, 8, :3].max() > 10
    expected = remove_outliers(color, 2.0, Strips(1))
    np.testing.assert_allclose(removed[..., :3], expected, rtol=1e-6)
    assert frame.color[7, 8, 0] == 1e4  # the caller's stays


def test_the_option_is_read_and_its_rule_is_told():
    spec = load("nbg-7x3")
    temporal = dataclasses.replace(spec.temporal, outlier_deviations=2.0)
    asks = dataclasses.replace(spec, temporal=temporal)
    assert from_json(asks.to_json()) == asks
    with pytest.raises(SpecError, match=r"temporal.outlier_deviations must be in \[0, 100\]"):
        dataclasses.replace(
            spec, temporal=dataclasses.replace(spec.temporal, outlier_deviations=-1.0)
        )
    assert issubclass(SpecError, InputError)
