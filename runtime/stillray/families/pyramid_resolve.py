"""The picture of a kernel pyramid: its finest level remodulated, and resolved with its neighbours.

Edges become as smooth as supersampling would make them, and the previous output holds the picture
still.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.strips import Strips, interleave, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.pyramid_level import Level, add_neighbours, repeat_border
from stillray.families.pyramid_logits import NEIGHBOURS
from stillray.model_spec.decoders import PyramidKernels
from stillray.stages.features import luminance_of_planes
from stillray.stages.state import Filterable


def tone(light: Filterable, options: PyramidKernels) -> float:
    """What luminance is multiplied by before neighbours are compared; 0: they are not."""
    return options.resolve_tone * light.exposure * light.filter_sharpness


@dataclass(frozen=True, eq=False)
class Finest:
    """The finest level, from which the picture is resolved.

    Attributes
    ----------
    level
        What it is blended of.
    filtered : (3, h, w) float32 or None
        The level as its last filters left it, which is then not blended again.
    shares : (h, w) float32 or None
        What its pixels weighed in those filters.
    albedo : (3, h, w) float32 or None
        That it is multiplied by in place of the frame's, see `stillray.families.albedo_average`.
    """

    level: Level
    filtered: np.ndarray | None = None
    shares: np.ndarray | None = None
    albedo: np.ndarray | None = None

    def resolve(
        self,
        rows: slice,
        light: Filterable,
        toned: np.ndarray | None,
        out: np.ndarray,
        workspace: Workspace,
    ) -> None:
        """Rows of the picture, ``(rows, w, 3)``: blended, remodulated and resolved."""
        padded = self.unresolved(rows, light, workspace)
        around: np.ndarray | None = None
        if toned is not None:
            around = toned[rows.start : rows.stop + 2].copy()
        elif tone(light, self.level.options):
            around = self.toned(padded, light, workspace)
        past = None if light.previous is None else light.previous[rows]
        at = self.level.layout.resolve
        weights = workspace.array("weights", (at.stop - at.start, *out.shape[:2]))
        self.level.logits.weights(at, rows, weights)
        if around is not None:
            _weigh_brighter_less(around, weights[: len(NEIGHBOURS)], workspace)
        if past is not None and light.recalled is not None:
            weights[-1] *= light.recalled[rows]
        _resolve(padded, weights, past, out, workspace)

    def all_toned(self, light: Filterable, strips: Strips) -> np.ndarray | None:
        """What tells brighter neighbours of the whole frame, ``(h + 2, w + 2)``, see `resolve`."""
        if not tone(light, self.level.options):
            return None
        height, width = light.mean.shape[:2]
        toned = np.empty((height + 2, width + 2), np.float32)

        def work(rows: slice) -> None:
            unresolved = self.unresolved(rows, light, strips.workspace)
            inside = self.toned(unresolved, light, strips.workspace)[1:-1]
            toned[rows.start + 1 : rows.stop + 1] = inside

        strips.run(work, height, width)
        repeat_border(toned, top=True, bottom=True)
        return toned

    def toned(self, padded: np.ndarray, light: Filterable, workspace: Workspace) -> np.ndarray:
        """What tells a picture's brighter pixels, ``(3, h, w)`` to ``(h, w)``: 1 + tone L."""
        toned = luminance_of_planes(padded, workspace.array("toned", padded.shape[1:]))
        toned *= tone(light, self.level.options)
        toned += 1
        return toned

    def unresolved(self, rows: slice, light: Filterable, workspace: Workspace) -> np.ndarray:
        """Rows blended and remodulated, ``(3, rows + 2, w + 2)``: a pixel more on each side."""
        height, width = light.mean.shape[:2]
        # the resolve looks one pixel around; at the border of the frame that is repeated
        around, inner = with_halo(rows, 1, height)
        shape = (3, rows.stop - rows.start + 2, self.level.planes.shape[2] + 2)
        padded = workspace.array("padded", shape)
        top = 1 - inner.start
        filled = slice(top, top + around.stop - around.start)
        if self.filtered is None:
            self.level.blend(around, padded[:, filled, 1:-1], workspace)
        else:
            padded[:, filled, 1:-1] = self.filtered[:, around]
        if self.albedo is not None:
            padded[:, filled, 1 : 1 + width] *= self.albedo[:, around]
        elif light.remodulation_albedo is not None:
            by = workspace.array("by", (3, around.stop - around.start, width))
            padded[:, filled, 1 : 1 + width] *= planes_of(light.remodulation_albedo[around], out=by)
        padded = padded[:, :, : width + 2]
        repeat_border(padded, top=rows.start == 0, bottom=rows.stop == height)
        return padded


def _resolve(
    padded: np.ndarray,
    weights: np.ndarray,
    previous: np.ndarray | None,
    out: np.ndarray,
    workspace: Workspace,
) -> None:
    """Average pixels with their neighbours and the previous output.

    Parameters
    ----------
    padded : (3, h + 2, w + 2) float32
        Radiance, with one pixel more on each side.
    weights : (9, h, w) float32
        Of the neighbours and the previous output; changed.
    previous : (h, w, 4) float32 or None
        The previous output, and how much of it is valid.
    out : (h, w, 3) float32
        Written.
    """
    height, width = out.shape[:2]
    normal = workspace.array("normal", (height, width))
    np.add(weights[0], weights[1], out=normal)
    for weight in weights[2:-1]:
        normal += weight
    normal += 1
    past: np.ndarray | None = None
    if previous is not None:
        past = planes_of(previous, out=workspace.array("past", (4, height, width)))
        weights[-1] *= past[3]
        normal += weights[-1]
    np.reciprocal(normal, out=normal)
    resolved = workspace.array("resolved", (3, height, width))
    np.copyto(resolved, padded[:, 1:-1, 1:-1])
    add_neighbours(padded, weights[: len(NEIGHBOURS)], resolved)
    if past is not None:
        for plane, total in zip(past, resolved, strict=False):
            cv2.accumulateProduct(plane, weights[-1], total)
    resolved *= normal
    interleave(resolved, out=out)


def _weigh_brighter_less(toned: np.ndarray, weights: np.ndarray, workspace: Workspace) -> None:
    """Multiply the weights of brighter neighbours by how much brighter they are, as displayed.

    A window sixty times as bright as the bar before it would show through a hundredth of a weight.

    Parameters
    ----------
    toned : (h + 2, w + 2) float32
        1 + tone L, see `_Level.toned`; made into its reciprocals.
    weights : (8, h, w) float32
        Of the neighbours; changed.
    """
    height, width = shape = weights.shape[1:]
    own, less = workspace.array("own tone", shape), workspace.array("less", shape)
    np.copyto(own, toned[1:-1, 1:-1])
    np.reciprocal(toned, out=toned)
    for weight, (down, right) in zip(weights, NEIGHBOURS, strict=True):
        cv2.multiply(own, toned[1 + down :, 1 + right :][:height, :width], dst=less)
        cv2.multiply(weight, at_most(less, 1, out=less), dst=weight)
