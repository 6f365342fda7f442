"""Bright windows behind bars, painted into frames that are learned from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from stillray import Frame
from stillray_training.bright_windows import (
    Window,
    draw_window,
    frame_through,
    reference_through,
)

_SHAPE = (97, 113)
_SEEDS = range(12)


def _scene() -> tuple[np.ndarray, Frame]:
    reference = np.random.default_rng(5).uniform(0.2, 0.4, (*_SHAPE, 3)).astype(np.float32)
    normal = np.zeros((*_SHAPE, 3), np.float32)
    normal[..., 2] = 1
    frame = Frame(
        color=reference.copy(),
        albedo=np.full((*_SHAPE, 3), 0.5, np.float32),
        normal=normal,
        depth=np.full(_SHAPE, 4, np.float32),
        motion=np.full((*_SHAPE, 2), 3, np.float32),
    )
    return reference, frame


def _drawn(seed: int, spread: float | None = None) -> Window:
    reference, frame = _scene()
    return draw_window(reference, frame.depth, spread, np.random.default_rng(seed))


def test_frames_with_a_window_are_the_reference_with_it_in_the_mean():
    reference, frame = _scene()
    for seed in _SEEDS:
        window, rng = _drawn(seed), np.random.default_rng(seed)
        seen = [frame_through(frame, window, 2, rng).color for _ in range(300)]
        # a pixel's mean of 600 samples, each of which passes the bars or not
        off = np.abs(np.mean(seen, 0) - reference_through(reference, window))
        assert off.max() < 6 * window.lamp.radiance.max() * 0.5 / np.sqrt(600)


def test_windows_shine_between_bars_five_to_five_hundred_times_as_bright():
    usual = np.median(_scene()[0])
    for seed in _SEEDS:
        window = _drawn(seed)
        assert 5 <= window.lamp.radiance.mean() / usual * 1.01 <= 510
        coverage = window.lamp.coverage
        assert coverage.max() > 0.3
        assert coverage.min() == 0
        # not a plain patch: open places have barred ones in their row or column
        barred = (coverage < 0.9 * coverage.max()) & (coverage > 0)
        assert barred.sum() > 0.02 * (coverage > 0).sum()


def test_bars_are_what_the_frame_shows_with_as_much_light_or_less():
    reference, frame = _scene()
    darker = 0
    for seed in _SEEDS:
        window = _drawn(seed)
        shut = window.lamp.coverage == 0
        seen = frame_through(frame, window, 4, np.random.default_rng(0))
        assert (seen.color[shut] <= frame.color[shut] * 1.0001).all()
        for name in ("albedo", "normal", "depth", "motion"):
            np.testing.assert_array_equal(getattr(seen, name)[shut], getattr(frame, name)[shut])
        assert window.light.min() >= 0.0099
        darker += bool(window.light.min() < 0.99)
        np.testing.assert_allclose(
            reference_through(reference, window)[shut], (reference * window.light[..., None])[shut]
        )
    assert 0 < darker < len(_SEEDS)


def test_where_all_samples_pass_the_window_alone_is_seen():
    _, frame = _scene()
    depths = set()
    for seed in _SEEDS:
        window = _drawn(seed)
        through = window.lamp.coverage == 1
        if not through.any():
            continue
        seen = frame_through(frame, window, 8, np.random.default_rng(0))
        np.testing.assert_allclose(
            seen.color[through], window.lamp.radiance[None].repeat(through.sum(), 0)
        )
        assert seen.depth is not None
        depths |= set(np.sign(seen.depth[through] - frame.depth[through]))
    # as sky, which has none, and as what stands behind the bars
    assert depths == {-1, 1}


@pytest.mark.parametrize("samples", [1, 4])
def test_samples_pass_the_bars_or_do_not(samples):
    _, frame = _scene()
    dark = replace(frame, color=np.zeros_like(frame.color))
    window = _drawn(3)
    white = replace(window, lamp=replace(window.lamp, radiance=np.ones(3, np.float32)))
    met = frame_through(dark, white, samples, np.random.default_rng(1)).color[..., 0]
    np.testing.assert_allclose(met * samples, np.round(met * samples), atol=1e-6)
    assert met.any()


def test_the_same_draws_give_the_same_window():
    one, other = _drawn(4), _drawn(4)
    np.testing.assert_array_equal(one.lamp.coverage, other.lamp.coverage)
    assert not np.array_equal(one.lamp.coverage, _drawn(5).lamp.coverage)
