"""Quiet frames: little noise, a few fireflies."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stillray import Frame
from stillray_training.quiet import fireflies, quiet_frame, uneven_frame


def _frames(count: int):
    rng = np.random.default_rng(3)
    reference = rng.uniform(0.2, 0.4, (97, 113, 3)).astype(np.float32)
    noisy = (reference * rng.exponential(1, reference.shape)).astype(np.float32)
    frame = Frame(color=noisy, motion=np.zeros((97, 113, 2), np.float32))
    return reference, frame, [
        quiet_frame(frame, reference, np.random.default_rng(seed)) for seed in range(count)
    ]  # fmt: skip


def test_a_quiet_frame_is_nearer_to_the_reference_but_for_its_fireflies():
    reference, frame, quiet = _frames(20)
    noise = np.abs(frame.color - reference).mean()
    counts = []
    for one in quiet:
        fireflies = one.color.max(axis=-1) > 9 * np.median(reference)
        assert fireflies.mean() < 5e-2
        assert np.abs(one.color - reference)[~fireflies].mean() <= 0.51 * noise
        assert one.color.min() >= 0
        assert one.motion is None  # the frames before it are not quiet
        counts.append(np.count_nonzero(fireflies))
    assert min(counts) < 20
    assert max(counts) > 100


def test_a_quiet_frame_ignores_broken_samples():
    reference, frame, _ = _frames(0)
    frame.color[3, 4] = np.nan
    quiet = quiet_frame(frame, reference, np.random.default_rng(1))
    assert np.isfinite(quiet.color).all()


def test_an_uneven_frame_keeps_its_noise_in_a_part_of_the_picture():
    reference, frame, _ = _frames(0)
    frame.color[3, 4] = np.nan
    ys, xs = np.mgrid[:97, :113]
    slopes = np.stack([xs - 56, ys - 48, np.full(xs.shape, 60)], -1).astype(np.float32)
    normal = slopes / np.linalg.norm(slopes, axis=-1, keepdims=True)
    given = np.abs(np.nan_to_num(frame.color) - reference)
    for seed in range(10):
        with_normals = replace(frame, normal=normal if seed % 2 else None)
        one = uneven_frame(with_normals, reference, reference, np.random.default_rng(seed))
        share = np.abs(one.color - reference).sum(-1) / given.sum(-1)
        noisy = share > 0.99
        assert 0.05 < noisy.mean() < 0.75
        # elsewhere one share, a third at most
        assert share[~noisy].max() < 1 / 3 + 1e-3
        assert np.ptp(share[~noisy]) < 1e-3
        assert one.color.min() >= 0


def test_textures_of_an_uneven_frame_are_as_noisy_as_its_albedo():
    rng = np.random.default_rng(5)
    albedo = rng.uniform(0.2, 0.8, (97, 113, 3)).astype(np.float32)
    noisy = albedo * rng.uniform(0.5, 1.5, albedo.shape).astype(np.float32)
    frame = Frame(color=noisy * 3, albedo=noisy)  # light of 3 without any noise
    one = uneven_frame(frame, albedo * 3, albedo, rng)
    np.testing.assert_allclose(one.color, noisy * 3, rtol=1e-5)


def test_fireflies_are_few_bright_and_of_one_colour_each():
    reference = np.full((96, 128, 3), 0.5, np.float32)
    found = [fireflies(reference, np.random.default_rng(seed)) for seed in range(12)]
    for light in found:
        lit = light.max(-1) > 0
        assert lit.mean() < 0.06
        assert not lit.any() or light[lit].max() > 10 * 0.5
    assert max(np.count_nonzero(light) for light in found) > 100
