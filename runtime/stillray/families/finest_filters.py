"""The last filters of a kernel pyramid: Gaussians of feature distances, further apart first.

Shares of neighbours, box windows and doubled levels all reach a few pixels or none alike; light on
a rim of two pixels is to be found along it. Each pass looks at eight pixels at a distance and takes
those that look alike, so that a few passes follow an edge.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.families.box_filter import bounded_exp
from stillray.families.depth_to_space import DepthToSpace
from stillray.families.gaussian import Weights, framed, gaussian
from stillray.families.pyramid_logits import LevelLayout


def filter_finest(
    blend: Callable[[slice, np.ndarray], None],
    size: tuple[int, int],
    logits: np.ndarray | DepthToSpace,
    layout: LevelLayout,
    bound: float,
    strips: Strips,
) -> np.ndarray:
    """The finest level, blended and filtered.

    Parameters
    ----------
    blend
        Writes rows of what is filtered, ``(3, rows, w)``.
    size
        Height and width.
    logits : (planes, h, w) float32
        Of the finest level.
    layout
        Of the logits, with one filter or more.
    bound
        That logits, and features, are clipped to.
    strips
        Where the work runs.

    Returns
    -------
    (3, h, w) float32
        In the workspace of this thread: convex combinations of what was blended.
    """
    height, width = size
    source, other = (strips.workspace.array(f"finest {index}", (3, *size)) for index in (0, 1))
    strips.run(lambda rows: blend(rows, source[:, rows]), height, width)
    for index in range(len(layout.filter_distances)):
        step = _Filter(source, logits, layout, index, bound)
        strips.run(partial(step.run, other, strips), height, width)
        source, other = other, source
    return source


class _Filter:
    """One pass over a level."""

    def __init__(
        self,
        source: np.ndarray,
        logits: np.ndarray | DepthToSpace,
        layout: LevelLayout,
        index: int,
        bound: float,
    ) -> None:
        self._source, self._logits, self._bound = source, logits, bound
        self._features, self._distance = layout.features, layout.filter_distances[index]
        weight = layout.filters.start + 2 * index
        self._weight, self._own = slice(weight, weight + 1), slice(weight + 1, weight + 2)

    def run(self, target: np.ndarray, strips: Strips, rows: slice) -> None:
        """Filter rows into those of ``target``, ``(3, h, w)``."""
        workspace, margin = strips.workspace, self._distance
        height, width = self._source.shape[1:]
        near, inner = with_halo(rows, margin, height)
        top = margin - inner.start
        filled = slice(top, top + near.stop - near.start)
        features = self._logits[self._features, near]
        shape = (rows.stop - rows.start + 2 * margin, width + 2 * margin)
        values, guides, other = (
            framed(workspace.array(name, (count, *shape)), filled, margin)
            for name, count in (("values", 3), ("features", len(features)), ("weight", 1))
        )
        values[:, filled, margin:-margin] = self._source[:, near]
        bound = np.float32(self._bound)
        np.clip(features, -bound, bound, out=guides[:, filled, margin:-margin])
        own = workspace.array("own", (near.stop - near.start, width))
        bounded_exp(self._logits[self._weight, near][0], self._bound, own)
        other[0, filled, margin:-margin] = own
        own = own[: rows.stop - rows.start]
        bounded_exp(self._logits[self._own, rows][0], self._bound, own)
        gaussian(values, Weights(guides, other[0], own), target[:, rows], workspace, margin)
