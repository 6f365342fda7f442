"""A level of a kernel pyramid: what it is pooled into, and what it is blended of."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.resample import halve
from stillray.arrays.strips import Strips, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.box_filter import box_means
from stillray.families.logit_maps import LogitMaps
from stillray.families.pyramid_logits import NEIGHBOURS, LevelLayout
from stillray.families.pyramid_upsample import Doubled
from stillray.model_spec.decoders import PyramidKernels


@dataclass(frozen=True, eq=False)
class Level:
    """A level and what it is blended of.

    Attributes
    ----------
    planes : (4, h, w) float32
        Light and samples of the whole level.
    coarser
        The whole coarser level; None at the coarsest.
    logits
        Of the level.
    layout, options
        Of the logits.
    """

    planes: np.ndarray
    coarser: Doubled | None
    logits: LogitMaps
    layout: LevelLayout
    options: PyramidKernels

    def blended(self, strips: Strips, result: np.ndarray) -> None:
        """The whole level with its border repeated, into ``(3, h + 2, w + 2)``."""
        height, width = self.planes.shape[1:]
        inner = result[:, 1:-1, 1:-1]
        strips.run(lambda rows: self.blend(rows, inner[:, rows], strips.workspace), height, width)
        repeat_border(result, top=True, bottom=True)

    def blend(self, rows: slice, out: np.ndarray, workspace: Workspace) -> None:
        """Rows of the level, ``(3, rows, w)``: itself, its kernels and the coarser level."""
        height, width = self.planes.shape[1:]
        shape = (rows.stop - rows.start, width)
        at = self.layout.blend
        shares = workspace.array("shares", (at.stop - at.start, *shape))
        self.logits.weights(at, rows, shares)
        others = list(shares)
        if self.coarser is None:  # itself at logit 0, then the kernels
            light = workspace.array("light", (3, *shape))
            np.copyto(light, self.planes[:3, rows])
        else:  # the coarser level at logit 0, then itself, then the kernels
            light = self.coarser.rows(rows, workspace)
            own = others.pop(0)
            # a sample that weighs less than one counts as little for its own pixel, see
            # docs/decisions.md: else a lone firefly of a first frame would lift it
            own *= at_most(self.planes[3, rows], 1, out=workspace.array("sample_weight", shape))
            for plane, sums in zip(self.planes, light, strict=False):
                cv2.accumulateProduct(plane[rows], own, sums)
        normal = workspace.array("normal", shape)
        np.add(shares[0], 1, out=normal)
        for share in shares[1:]:
            normal += share
        # none where the finest level has no kernels
        for index, (size, share) in enumerate(zip(self.options.kernel_sizes, others, strict=False)):
            near, inner = with_halo(rows, size // 2, height)
            strip = (near.stop - near.start, width)
            weight, product, box = (
                workspace.array(name, strip) for name in ("weight", "product", "box")
            )
            self.logits.weight(self.layout.importance.start + index, near, weight)
            weight *= self.planes[3, near]
            share /= box_means(weight, size, box)[inner]
            for plane, sums in zip(self.planes, light, strict=False):
                np.multiply(weight, plane[near], out=product)
                cv2.accumulateProduct(box_means(product, size, box)[inner], share, sums)
        if self.layout.distances:
            self._add_around(rows, light, normal, workspace)
        np.multiply(light, np.reciprocal(normal, out=normal), out=out)

    def _add_around(
        self, rows: slice, light: np.ndarray, normal: np.ndarray, workspace: Workspace
    ) -> None:
        """Add neighbours, each by a weight of its own, and the weights."""
        distances = self.layout.distances
        at = self.layout.around
        weights = workspace.array("weights", (at.stop - at.start, *normal.shape))
        for weight in self.logits.weights(at, rows, weights):
            normal += weight
        margin, count = max(distances), len(NEIGHBOURS)
        padded = with_margin(self.planes[:3], rows, margin, workspace)
        for index, distance in enumerate(distances):
            crop = slice(margin - distance, distance - margin or None)
            near = padded[:, crop, crop]
            add_neighbours(near, weights[count * index :][:count], light, distance)


def pooled(
    fine: np.ndarray,
    logits: LogitMaps,
    pool: slice,
    strips: Strips,
    coarse: np.ndarray,
) -> None:
    """The next coarser level of ``(4, h, w)`` light and samples: weighted means of 2x2 blocks."""
    height, width = coarse.shape[1:]

    def work(rows: slice) -> None:
        workspace = strips.workspace
        source = slice(2 * rows.start, 2 * rows.stop)
        shape = (source.stop - source.start, 2 * width)
        weight, product = workspace.array("weight", shape), workspace.array("product", shape)
        logits.weight(pool.start, source, weight)
        total = halve(weight)
        weight *= fine[3, source]
        held = halve(weight)
        np.divide(held, total, out=coarse[3, rows])
        np.reciprocal(held, out=held)
        for channel in range(3):
            np.multiply(weight, fine[channel, source], out=product)
            np.multiply(halve(product), held, out=coarse[channel, rows])

    strips.run(work, height, width)


def add_neighbours(
    padded: np.ndarray, weights: np.ndarray, sums: np.ndarray, distance: int = 1
) -> None:
    """Add the eight neighbours, each by its weight, to ``(3, h, w)``.

    Parameters
    ----------
    padded : (3, h + 2 distance, w + 2 distance) float32
        With that many pixels more on each side.
    weights : (8, h, w) float32
        In the order of `NEIGHBOURS`.
    sums : (3, h, w) float32
        Added to.
    distance
        Of the neighbours, pixels.
    """
    height, width = weights.shape[1:]
    for plane, total in zip(padded, sums, strict=True):
        for weight, (down, right) in zip(weights, NEIGHBOURS, strict=True):
            moved = plane[distance * (1 + down) :, distance * (1 + right) :][:height, :width]
            cv2.accumulateProduct(moved, weight, total)


def repeat_border(padded: np.ndarray, *, top: bool, bottom: bool) -> None:
    """Fill the outermost pixels of ``(..., h + 2, w + 2)``: left, right, and where asked for."""
    padded[..., 0], padded[..., -1] = padded[..., 1], padded[..., -2]
    if top:
        padded[..., 0, :] = padded[..., 1, :]
    if bottom:
        padded[..., -1, :] = padded[..., -2, :]


def with_margin(planes: np.ndarray, rows: slice, margin: int, workspace: Workspace) -> np.ndarray:
    """Rows of ``(3, h, w)`` with a margin of pixels on each side, repeated at the border."""
    height, width = planes.shape[1:]
    near, inner = with_halo(rows, margin, height)
    count = rows.stop - rows.start
    padded = workspace.array("neighbours", (3, count + 2 * margin, width + 2 * margin))
    top = margin - inner.start
    bottom = top + near.stop - near.start
    padded[:, top:bottom, margin:-margin] = planes[:, near]
    padded[..., :margin] = padded[..., margin : margin + 1]
    padded[..., -margin:] = padded[..., -margin - 1 : -margin]
    padded[:, :top] = padded[:, top : top + 1]
    padded[:, bottom:] = padded[:, bottom - 1 : bottom]
    return padded
