"""Lamps painted into frames that are learned from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillray import Frame
from stillray_training.small_lamps import draw_lamps, lit_frame, lit_reference

_SHAPE = (97, 113)


def _scene(noise: float = 1.0) -> tuple[np.ndarray, Frame]:
    rng = np.random.default_rng(5)
    reference = rng.uniform(0.2, 0.4, (*_SHAPE, 3)).astype(np.float32)
    noisy = reference * (1 + noise * (rng.exponential(1, reference.shape) - 1))
    normal = np.zeros((*_SHAPE, 3), np.float32)
    normal[..., 2] = 1
    frame = Frame(
        color=noisy.astype(np.float32),
        albedo=np.full((*_SHAPE, 3), 0.5, np.float32),
        normal=normal,
        depth=np.full(_SHAPE, 4, np.float32),
        motion=np.full((*_SHAPE, 2), 3, np.float32),
    )
    return reference, frame


def _drawn(seed: int, spread: float | None = None):
    reference, frame = _scene()
    rng = np.random.default_rng(seed)
    return reference, frame, draw_lamps(reference, frame.depth, spread, rng), rng


def test_frames_with_lamps_are_those_of_the_reference_with_lamps_in_the_mean():
    reference, _ = _scene()
    for seed in range(6):
        _, _, lamps, rng = _drawn(seed)
        clean = _scene(noise=0)[1]
        lit = [lit_frame(clean, lamps, 2, rng).color for _ in range(400)]
        brightest = max(float(lamp.radiance.max()) for lamp in lamps)
        # a pixel's mean of 800 samples, of which any may meet the lamp
        off = np.abs(np.mean(lit, 0) - lit_reference(reference, lamps))
        assert off.max() < 6 * brightest * 0.5 / np.sqrt(800)


def test_a_pixel_that_sees_only_a_lamp_has_no_noise_and_no_broken_samples():
    reference, frame, lamps, rng = _drawn(1)
    frame.color[:] = np.nan
    lit = lit_frame(frame, lamps, 1, rng)
    last = lamps[-1]
    inside = last.coverage == 1
    assert inside.any()
    for given, wanted in (
        (lit.color, last.radiance),
        (lit.albedo, last.albedo),
        (lit.normal, last.normal),
        (lit_reference(reference, lamps), last.radiance),
    ):
        np.testing.assert_allclose(given[inside], np.broadcast_to(wanted, (inside.sum(), 3)))
    assert (lit.depth[inside] < frame.depth[inside]).all()
    assert not lit.motion[inside].any()


def test_elsewhere_nothing_changes():
    reference, frame, lamps, rng = _drawn(2)
    outside = sum(lamp.coverage for lamp in lamps) == 0
    lit = lit_frame(frame, lamps, 16, rng)
    for name in ("color", "albedo", "normal", "depth", "motion"):
        np.testing.assert_array_equal(getattr(lit, name)[outside], getattr(frame, name)[outside])
    np.testing.assert_array_equal(lit_reference(reference, lamps)[outside], reference[outside])


@pytest.mark.parametrize("samples", [1, 4])
def test_samples_meet_a_lamp_or_do_not(samples):
    _, frame, lamps, rng = _drawn(3)
    dark = replace(frame, color=np.zeros_like(frame.color))
    lamp = replace(lamps[0], radiance=np.ones(3, np.float32))
    met = lit_frame(dark, [lamp], samples, rng).color[..., 0]
    np.testing.assert_allclose(met * samples, np.round(met * samples), atol=1e-6)


def test_a_wider_pixel_filter_makes_edges_wider():
    def soft(spread: float | None) -> int:
        lamps = [lamp for seed in range(20) for lamp in _drawn(seed, spread)[2]]
        return sum(int(((one.coverage > 0) & (one.coverage < 1)).sum()) for one in lamps)

    assert soft(0.8) > 1.5 * soft(None)


def test_lamps_where_nothing_was_hit_have_no_distance():
    reference, frame = _scene()
    lamps = draw_lamps(reference, np.zeros(_SHAPE, np.float32), None, np.random.default_rng(0))
    nothing = replace(frame, depth=np.zeros(_SHAPE, np.float32))
    assert not lit_frame(nothing, lamps, 4, np.random.default_rng(0)).depth.any()
