"""The past of a model that learns while it denoises, brought to a frame's pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.arrays.strips import STRIP_PIXELS, Strips, interleave, planes_of
from stillray.families.contract import Context
from stillray.model_spec.loader import Temporal
from stillray.stages import reproject as rep
from stillray.stages.prepare import discontinuities
from stillray.stages.repair import MAX_RADIANCE, Buffers

_MOST_LOG = np.float32(60)  # of exposed radiance: exp of it is a float32
#: Of the four taps around a place, the share that must show the same surface for it to be known.
_LEAST_SHARE = 0.1


@dataclass(frozen=True, kw_only=True, eq=False)
class Past:
    """What holds until the next cut.

    Attributes
    ----------
    output : (h, w, 4) float32
        The last picture, radiance, and 1.
    pilot_a, pilot_b : (h, w, 4) float32
        The last pilots, radiance, and 1.
    guides : (h, w, 4) float32 or None
        Geometry of the last frame, see `stillray.stages.reproject.pack`.
    exposure
        1 / radiance, steadied over the sequence.
    """

    output: np.ndarray
    pilot_a: np.ndarray
    pilot_b: np.ndarray
    guides: np.ndarray | None
    exposure: float


@dataclass(frozen=True, kw_only=True, eq=False)
class Warped:
    """What was known of a frame's pixels, as logarithms of exposed radiance.

    Attributes
    ----------
    output : (3, h, w) float32
        The last picture; 0 where there is none.
    pilots : (7, h, w) float32
        The last pilots, and last 1 where these pixels' surface was seen, or 0.
    """

    output: np.ndarray
    pilots: np.ndarray


def nothing(shape: tuple[int, int]) -> Warped:
    """Where there is no past."""
    return Warped(output=np.zeros((3, *shape), "f4"), pilots=np.zeros((7, *shape), "f4"))


def guides_of(buffers: Buffers, strips: Strips) -> np.ndarray | None:
    """Geometry to remember; None where neither normals nor depth are given."""
    normal, depth = buffers.normal, buffers.depth
    if normal is None and depth is None:
        return None
    guides = np.empty((*buffers.color.shape[:2], 4), np.float32)

    def work(rows: slice) -> None:
        planes = rep.surface_guide_planes(
            None if normal is None else normal[rows],
            None if depth is None else depth[rows],
            strips.workspace,
        )
        interleave(planes, out=guides[rows])

    strips.run(work, *guides.shape[:2])
    return guides


def warp(
    past: Past, buffers: Buffers, exposure: float, options: Temporal, context: Context
) -> Warped:
    """Look back along motion; a surface that disagrees by normal or depth was not seen.

    Parameters
    ----------
    past
        Of the last frame, of this frame's size.
    buffers
        Of this frame, with motion.
    exposure
        Of this frame.
    options
        When geometry disagrees.
    context
        Where the work runs.
    """
    motion, strips = buffers.motion, context.strips
    assert motion is not None
    shape = motion.shape[:2]
    compares = past.guides is not None and (buffers.normal is not None or buffers.depth is not None)
    rough: np.ndarray | None = None
    if past.guides is not None and compares and motion.any():
        rough = discontinuities(past.guides, strips, context.workspace)
    output = context.workspace.array("warped output", (3, *shape))
    pilots = context.workspace.array("warped pilots", (7, *shape))
    known = pilots[-1]
    sources = ((past.output, output), (past.pilot_a, pilots[:3]), (past.pilot_b, pilots[3:6]))

    def work(rows: slice) -> None:
        now: np.ndarray | None = None
        if compares:
            now = rep.surface_guide_planes(
                None if buffers.normal is None else buffers.normal[rows],
                None if buffers.depth is None else buffers.depth[rows],
                strips.workspace,
            )
        at = rep.positions_of(motion[rows], rows) if motion[rows].any() else None
        before = past.guides if compares else None
        for source, target in sources:
            previous = rep.PreviousFrame(source, before, rough)
            taken = planes_of(
                rep.reproject(previous, now, at, rows, options, strips.workspace),
                out=strips.workspace.array("found", (4, *known[rows].shape)),
            )
            if target is output:
                known[rows] = taken[3] > _LEAST_SHARE
            np.multiply(logarithm(taken[:3], exposure), known[rows], out=target[:, rows])

    strips.run(work, *shape, pixels=STRIP_PIXELS // 2)
    return Warped(output=output, pilots=pilots)


def logarithm(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Log of one and the exposed radiance (Choi et al. 2024, section 4.4), float32."""
    with np.errstate(over="ignore"):
        exposed = radiance * np.float32(exposure)
    return np.minimum(np.log1p(exposed, out=exposed), _MOST_LOG, out=exposed)


def radiance_of(log: np.ndarray, exposure: float, strips: Strips) -> np.ndarray:
    """`logarithm` undone: ``(3, h, w)`` to ``(h, w, 4)``, finite, 0 or more, and 1 last."""
    radiance = np.empty((*log.shape[1:], 4), np.float32)

    def work(rows: slice) -> None:
        planes = np.ones((4, *log[0, rows].shape), np.float32)
        exposed = np.expm1(np.clip(log[:, rows], 0, _MOST_LOG)).astype(np.float64) / exposure
        np.minimum(exposed, MAX_RADIANCE, out=planes[:3], casting="unsafe")
        interleave(planes, out=radiance[rows])

    strips.run(work, *log.shape[1:])
    return radiance
