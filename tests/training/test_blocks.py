"""Frames of a still camera out of blocks of samples."""

import numpy as np
import pytest

from stillray.frame import Frame
from stillray_training.blocks import alike_frames

SHAPE = (24, 32)


def block(rng, count, value):
    """A block whose color is 2 with noise of its count, and whose albedo tells which it is."""
    noise = rng.normal(0, 0.5 / np.sqrt(count), (*SHAPE, 3)).astype(np.float32)
    same = np.full((*SHAPE, 3), value, np.float32)
    depth = np.ones(SHAPE, np.float32)
    motion = np.full((*SHAPE, 2), 3, np.float32)
    return Frame(color=2 + noise, albedo=same, normal=same, depth=depth, motion=motion), count


@pytest.mark.parametrize("samples", [2.0, 5.0, 40.0])
def test_frames_have_the_noise_of_so_many_samples_each_its_own_and_nothing_moves(rng, samples):
    blocks = [block(rng, count, index / 8) for index, count in enumerate([1, 1, 2, 4, 8, 16])]
    reference = np.full((*SHAPE, 3), 2, np.float32)
    frames = alike_frames(blocks, reference, samples, 3, rng)
    assert len(frames) == 3
    noises = np.array([(frame.color - reference).ravel() for frame in frames])
    np.testing.assert_allclose(noises.std(axis=1), 0.5 / np.sqrt(samples), rtol=0.06)
    alike = np.corrcoef(noises)[np.triu_indices(3, 1)]
    assert (np.abs(alike) < 0.1).all()
    for frame in frames:
        assert frame.samples == samples
        assert not frame.motion.any()
        # few samples: features as noisy as a block's; many: those of all samples
        of_one = np.isclose(frame.albedo[0, 0, 0] * 8, np.arange(6), atol=1e-5).any()
        assert of_one == (samples < 8)


def test_there_are_no_more_frames_than_blocks_with_no_more_samples(rng):
    blocks = [block(rng, count, 0.5) for count in (1, 1, 4, 16)]
    frames = alike_frames(blocks, np.full((*SHAPE, 3), 2, np.float32), 3.0, 5, rng)
    assert len(frames) == 2
