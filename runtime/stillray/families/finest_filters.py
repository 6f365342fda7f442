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
from stillray.families.gaussian import Weights, framed, gaussian, measured
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
    margin = max(layout.filter_distances)
    inside = slice(margin, margin + height)
    count = layout.features.stop - layout.features.start
    # with zeros around: a pass looks beyond the border, where nothing weighs anything
    source, other, features, norms = images = [
        strips.workspace.array(name, (planes, height + 2 * margin, width + 2 * margin))
        for name, planes in (
            ("finest 0", 3),
            ("finest 1", 3),
            ("finest features", count),
            ("finest norms", 1),
        )
    ]
    within = slice(margin, margin + width)

    def fill(rows: slice) -> None:
        at = slice(margin + rows.start, margin + rows.stop)
        for image in images:
            _frame(image, at, margin)
        blend(rows, source[:, at, within])
        given = logits[layout.features, rows]
        np.clip(given, -np.float32(bound), np.float32(bound), out=features[:, at, within])
        measured(features[:, at, within], norms[0, at, within])

    strips.run(fill, height, width)
    for index in range(len(layout.filter_distances)):
        step = _Filter(source, (features, norms[0]), logits, layout, index, bound)
        strips.run(partial(step.run, other, strips), height, width)
        source, other = other, source
    return source[:, inside, within]


def _frame(image: np.ndarray, at: slice, margin: int) -> None:
    """`framed` of some rows of an image, the first and the last with the margin beyond them.

    At once it would touch every row: all of the memory of a first frame, uncut.
    """
    top = at.start if at.start > margin else 0
    bottom = at.stop if at.stop + margin < image.shape[1] else image.shape[1]
    framed(image[:, top:bottom], slice(at.start - top, at.stop - top), margin)


class _Filter:
    """One pass over a level, whose light and features have a margin of zeros."""

    def __init__(
        self,
        source: np.ndarray,
        features: tuple[np.ndarray, np.ndarray],
        logits: np.ndarray | DepthToSpace,
        layout: LevelLayout,
        index: int,
        bound: float,
    ) -> None:
        self._source, self._features, self._logits = source, features, logits
        self._margin, self._bound = max(layout.filter_distances), bound
        self._distance = layout.filter_distances[index]
        weight = layout.filters.start + 2 * index
        self._weight, self._own = slice(weight, weight + 1), slice(weight + 1, weight + 2)

    def run(self, target: np.ndarray, strips: Strips, rows: slice) -> None:
        """Filter rows into those of ``target``, which has a margin, too."""
        workspace, distance, margin = strips.workspace, self._distance, self._margin
        height, width = (size - 2 * margin for size in target.shape[1:])
        near, inner = with_halo(rows, distance, height)
        top = distance - inner.start
        shape = (rows.stop - rows.start + 2 * distance, width + 2 * distance)
        (other,) = framed(
            workspace.array("weight", (1, *shape)),
            slice(top, top + near.stop - near.start),
            distance,
        )
        own = workspace.array("own", (near.stop - near.start, width))
        bounded_exp(self._logits[self._weight, near][0], self._bound, own)
        other[top : top + len(own), distance:-distance] = own
        own = own[: rows.stop - rows.start]
        bounded_exp(self._logits[self._own, rows][0], self._bound, own)
        window = (
            slice(margin + rows.start - distance, margin + rows.stop + distance),
            slice(margin - distance, margin + width + distance),
        )
        features, norms = self._features
        weights = Weights(features[:, *window], norms[window], other, own)
        out = target[:, margin + rows.start : margin + rows.stop, margin : margin + width]
        gaussian(self._source[:, *window], weights, out, workspace, distance)
