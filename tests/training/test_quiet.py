"""Quiet frames: little noise, a few fireflies."""

from __future__ import annotations

import numpy as np

from stillray import Frame
from stillray_training.quiet import quiet_frame


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
