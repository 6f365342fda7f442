"""Glints painted into frames that are learned from."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.glints import Glint, draw_glints, glinting_frame, glinting_reference

SHAPE = (40, 56)


def _scene():
    rng = np.random.default_rng(5)
    reference = rng.uniform(0.2, 0.4, (*SHAPE, 3)).astype(np.float32)
    albedo = rng.uniform(0.2, 0.8, (*SHAPE, 3)).astype(np.float32)
    return reference, Frame(color=reference, albedo=albedo, depth=np.ones(SHAPE))


@pytest.mark.parametrize("seed", range(6))
def test_many_samples_become_the_reference(seed):
    reference, frame = _scene()
    rng = np.random.default_rng(seed)
    glints = draw_glints(reference, 0.42, rng)
    lit = glinting_frame(frame, glints, 1 << 22, rng)
    brightest = max(float(glint.radiance.max()) for glint in glints)
    off = np.abs(lit.color - glinting_reference(reference, glints))
    assert off.max() < 6 * brightest * 0.5 / np.sqrt(1 << 22)
    np.testing.assert_array_equal(lit.depth, frame.depth)


def test_few_samples_are_speckled_and_elsewhere_nothing_changes():
    _, frame = _scene()
    chance = np.zeros(SHAPE, np.float32)
    chance[10:30, 10:40] = 0.25
    light = np.full(3, 50, np.float32)
    glint = Glint(chance=chance, radiance=light, albedo=np.ones(3, np.float32))
    for samples in (1, 4, 16):
        lit = glinting_frame(frame, [glint], samples, np.random.default_rng(1))
        met = (lit.color - frame.color)[10:30, 10:40].mean(-1) > 0.1
        assert met.mean() == pytest.approx(1 - 0.75**samples, abs=0.06)
        # albedo and light tell of the same samples
        changed = np.abs(lit.albedo - frame.albedo).max(-1)[10:30, 10:40] > 1e-6
        np.testing.assert_array_equal(changed, met)
        lit.color[10:30, 10:40] = frame.color[10:30, 10:40]
        np.testing.assert_array_equal(lit.color, frame.color)


def test_glints_outshine_the_picture():
    reference, _ = _scene()
    usual = np.median(reference.mean(-1))
    for seed in range(20):
        glints = draw_glints(reference, None, np.random.default_rng(seed))
        assert 1 <= len(glints) <= 6
        assert min(float(glint.radiance.mean()) for glint in glints) > 4 * usual
        assert max(float(glint.chance.max()) for glint in glints) <= 0.7
