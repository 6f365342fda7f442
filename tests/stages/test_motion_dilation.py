from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.workspace import Workspace
from stillray.stages.motion_dilation import dilate_motion
from stillray.stages.reproject import positions_of


def followed(motion, depth, strip):
    """What each pixel's position is beyond its place, found by strips of so many rows."""
    height, width = depth.shape
    parts = []
    for top in range(0, height, strip):
        rows = slice(top, min(top + strip, height))
        positions = positions_of(motion[rows], rows)
        dilate_motion(positions, motion, depth, rows, Workspace())
        parts.append(positions)
    return np.concatenate(parts) - np.dstack(np.meshgrid(np.arange(width), np.arange(height)))


@pytest.mark.parametrize("strip", [70, 32, 1])
def test_silhouettes_move_with_the_nearer_surface(rng, strip):
    height, width = 70, 37
    depth = rng.choice(
        np.array([0, 1, 1.01, 5], np.float32), (height, width), p=[0.2, 0.1, 0.1, 0.6]
    )
    depth[:, 20:] *= np.float32(1.01) ** np.arange(17)  # a slope: nobody's silhouette
    # in steps that positions hold exactly
    motion = (rng.integers(-512, 512, (height, width, 2)) / 64).astype(np.float32)
    found = followed(motion, depth, strip)
    far = np.where(depth > 0, depth, np.inf)
    changed = 0
    for y, x in np.ndindex(height, width):
        around = [
            (a, b)
            for a in range(max(y - 1, 0), min(y + 2, height))
            for b in range(max(x - 1, 0), min(x + 2, width))
        ]
        nearest = min(far[p] for p in around)
        if nearest < 0.98 * far[y, x]:
            candidates = [motion[p] for p in around if far[p] == nearest]
            changed += 1
        else:
            candidates = [motion[y, x]]
        assert any((found[y, x] == candidate).all() for candidate in candidates)
    assert 0.2 < changed / depth.size < 0.9


def test_one_surface_moves_as_it_says(rng):
    motion = (rng.integers(-512, 512, (9, 14, 2)) / 64).astype(np.float32)
    for depth in (np.zeros((9, 14), np.float32), np.full((9, 14), 3, np.float32)):
        np.testing.assert_array_equal(followed(motion, depth, 4), motion)
