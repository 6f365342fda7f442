from __future__ import annotations

import numpy as np
import pytest

from stillray.silhouettes import motion_of_edges
from stillray.strips import Strips


@pytest.mark.parametrize("threads", [1, 3])
def test_silhouettes_move_with_the_nearer_surface(rng, threads):
    height, width = 70, 37
    depth = rng.choice(
        np.array([0, 1, 1.01, 5], np.float32), (height, width), p=[0.2, 0.1, 0.1, 0.6]
    )
    depth[:, 20:] *= np.float32(1.01) ** np.arange(17)  # a slope: nobody's silhouette
    motion = rng.random((height, width, 2)).astype(np.float32)
    followed = motion_of_edges(motion, depth, Strips(threads))
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
        assert any((followed[y, x] == candidate).all() for candidate in candidates)
    assert 0.2 < changed / depth.size < 0.9


def test_one_surface_moves_as_it_says(rng):
    motion = rng.random((9, 14, 2)).astype(np.float32)
    for depth in (None, np.zeros((9, 14), np.float32), np.full((9, 14), 3, np.float32)):
        assert motion_of_edges(motion, depth, Strips(1)) is motion
