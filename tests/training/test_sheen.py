"""Sheen painted into frames that are learned from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.sheen import draw_sheen, shining_frame, shining_reference

SHAPE = (48, 64)


def _scene():
    """A floor in the lower half, a wall above it, and sky on the left."""
    rng = np.random.default_rng(5)
    reference = rng.uniform(0.2, 0.4, (*SHAPE, 3)).astype(np.float32)
    normal = np.zeros((*SHAPE, 3), np.float32)
    normal[:24, :, 2] = 1
    normal[24:, :, 1] = 1
    depth = np.ones(SHAPE, np.float32)
    depth[:, :8] = 0
    return reference, Frame(color=reference, albedo=reference, normal=normal, depth=depth)


def _drawn(on_floor):
    reference, frame = _scene()
    for seed in range(100):
        sheen = draw_sheen(reference, frame, np.random.default_rng(seed))
        if sheen.light.max() > 0.05 and bool(sheen.facing[1]) == on_floor:
            return reference, frame, sheen
    raise AssertionError("no seed has sheen there")


@pytest.mark.parametrize("on_floor", [True, False])
def test_one_surface_shines_and_what_is_next_to_it_does_not(on_floor):
    reference, frame, sheen = _drawn(on_floor)
    lit = sheen.light.max(-1) > 0
    other, own = (slice(0, 24), slice(24, 48)) if on_floor else (slice(24, 48), slice(0, 24))
    assert lit[own].mean() > 0.1
    assert not lit[other].any()
    assert not lit[:, :8].any()
    seen = shining_frame(frame, sheen, 1, np.random.default_rng(1)).color
    np.testing.assert_array_equal(seen[~lit], frame.color[~lit])
    np.testing.assert_array_equal(shining_reference(reference, sheen)[~lit], reference[~lit])


def test_few_samples_carry_all_of_it_and_many_become_the_reference():
    reference, frame, sheen = _drawn(on_floor=True)
    rng = np.random.default_rng(2)
    many = shining_frame(frame, sheen, 1 << 22, rng).color
    np.testing.assert_allclose(many, shining_reference(reference, sheen), rtol=0.02)
    lit = sheen.light.max(-1) > 0
    for samples in (1, 4):
        few = shining_frame(frame, sheen, samples, rng).color
        carried = (few - frame.color)[lit].max(-1) > 0
        assert carried.mean() == pytest.approx(1 - (1 - sheen.chance) ** samples, abs=0.06)
    # what a sample carries is the same whatever the texture beneath is
    dark = replace(frame, color=0.1 * frame.color)
    one, other = (
        shining_frame(each, sheen, 4, np.random.default_rng(3)).color - each.color
        for each in (frame, dark)
    )
    np.testing.assert_allclose(one, other, atol=1e-6)


def test_where_the_surface_is_no_longer_nothing_shines():
    _, frame, sheen = _drawn(on_floor=True)
    turned = replace(frame, normal=np.roll(frame.normal, 1, -1))
    seen = shining_frame(turned, sheen, 1, np.random.default_rng(1))
    np.testing.assert_array_equal(seen.color, frame.color)


def test_where_nothing_was_hit_nothing_shines():
    reference, frame = _scene()
    sky = replace(frame, depth=np.zeros(SHAPE, np.float32), normal=np.zeros((*SHAPE, 3)))
    sheen = draw_sheen(reference, sky, np.random.default_rng(0))
    assert not sheen.light.any()
    np.testing.assert_array_equal(
        shining_frame(sky, sheen, 1, np.random.default_rng(0)).color, sky.color
    )
