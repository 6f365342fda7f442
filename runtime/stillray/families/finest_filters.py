"""The last filters of a kernel pyramid: Gaussians of feature distances, further apart first.

Shares of neighbours, box windows and doubled levels all reach a few pixels or none alike; light on
a rim of two pixels is to be found along it. Each pass looks at eight pixels at a distance and takes
those that look alike, so that a few passes follow an edge.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np

from stillray.arrays.strips import Strips, with_halo
from stillray.families.gaussian import Weights, framed, gaussian, measured
from stillray.families.logit_maps import LogitMaps
from stillray.families.pyramid_logits import LevelLayout


def filter_finest(
    blend: Callable[[slice, np.ndarray], None],
    size: tuple[int, int],
    logits: LogitMaps,
    layout: LevelLayout,
    strips: Strips,
    share: Callable[[slice, np.ndarray, np.ndarray], None] | None = None,
) -> tuple[np.ndarray, np.ndarray | None]:
    """The finest level, blended and filtered.

    Parameters
    ----------
    blend
        Writes rows of what is filtered, ``(3, rows, w)``.
    size
        Height and width.
    logits
        Of the finest level.
    layout
        Of the logits, with one filter or more.
    strips
        Where the work runs.
    share
        Writes what rows weigh of what the logits say, ``(rows, w)``, told what was blended there,
        ``(3, rows, w)``; None where they weigh all of it.

    Returns
    -------
    filtered : (3, h, w) float32
        In the workspace of this thread: convex combinations of what was blended.
    shares : (h, w) float32 or None
        In the workspace, too: what ``share`` has written.
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
    shares: np.ndarray | None = None
    if share is not None:
        shares = strips.workspace.array("finest shares", source.shape[1:])
        images.append(shares[None])
    within = slice(margin, margin + width)

    def fill(rows: slice) -> None:
        at = slice(margin + rows.start, margin + rows.stop)
        for image in images:
            _frame(image, at, margin)
        blend(rows, source[:, at, within])
        logits.numbers(layout.features, rows, features[:, at, within])
        measured(features[:, at, within], norms[0, at, within])
        if share is not None and shares is not None:
            share(rows, source[:, at, within], shares[at, within])

    strips.run(fill, height, width)
    for index in range(len(layout.filter_distances)):
        step = _Filter(source, (features, norms[0]), shares, (logits, layout, index))
        strips.run(partial(step.run, other, strips), height, width)
        source, other = other, source
    return source[:, inside, within], None if shares is None else shares[inside, within]


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
        shares: np.ndarray | None,
        of_pass: tuple[LogitMaps, LevelLayout, int],
    ) -> None:
        self._source, self._features, self._shares = source, features, shares
        self._logits, layout, index = of_pass
        self._margin = max(layout.filter_distances)
        self._distance = layout.filter_distances[index]
        self._weight = layout.filters.start + 2 * index

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
        self._weigh(self._weight, near, own)
        other[top : top + len(own), distance:-distance] = own
        own = own[: rows.stop - rows.start]
        self._weigh(self._weight + 1, rows, own)
        window = (
            slice(margin + rows.start - distance, margin + rows.stop + distance),
            slice(margin - distance, margin + width + distance),
        )
        features, norms = self._features
        weights = Weights(features[:, *window], norms[window], other, own)
        out = target[:, margin + rows.start : margin + rows.stop, margin : margin + width]
        gaussian(self._source[:, *window], weights, out, workspace, distance)

    def _weigh(self, plane: int, rows: slice, out: np.ndarray) -> None:
        """What rows weigh by one of the logits' planes, ``(rows, w)``."""
        self._logits.weight(plane, rows, out)
        if self._shares is not None:
            margin = self._margin
            at = slice(margin + rows.start, margin + rows.stop)
            cv2.multiply(out, self._shares[at, margin : margin + out.shape[1]], dst=out)
