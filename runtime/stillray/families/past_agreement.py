"""Where light has changed though surfaces stay, the past of a picture is let go.

For models whose past lies at the pixels of the picture, of which a frame may have fewer: its
samples are compared with what was accumulated where they lie, see
`stillray.stages.history_rejection`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import Strips, pixels_of, planes_of
from stillray.families.feature_reconstruction import Past
from stillray.families.outlines import outlines
from stillray.families.target_grid import Grid
from stillray.stages.features import luminance
from stillray.stages.history_rejection import PLANES, Noise, compare, confidence

# Networks that weigh the past themselves hold on to it longer than means of samples do, so a change
# must be noticed sooner; what is lost by mistake takes no light from a picture that they make.
_THRESHOLDS = (6.0, 5.5, 3.4, 3.1, 3.5, 3.5)

#: The picture and the albedos have no samples of their own that could be worth less: below this
#: share nothing is left of them either, and the pixel begins anew.
LEAST_SHARE = np.float32(0.5)


@dataclass(frozen=True, eq=False)
class Shown:
    """What a frame shows.

    Attributes
    ----------
    color : (h, w, 3) float32
        Radiance as it is accumulated: what stands far above its surroundings is bounded.
    broken : (h, w) bool or None
        Pixels that were filled in, and say nothing.
    exposure
        1 / radiance.
    features
        Depth, normal and albedo, each or None, see `stillray.families.outlines`.
    jitter
        Where all samples lie in their pixels, x and y, pixels from the centre; 0 where they lie
        anywhere. Where there is one, all samples along an outline see more of one side and differ
        from the past as if its light had changed: outlines say nothing either.
    """

    color: np.ndarray
    broken: np.ndarray | None
    exposure: float
    features: tuple[np.ndarray | None, np.ndarray | None, np.ndarray | None] = (None, None, None)
    jitter: tuple[float, float] = (0.0, 0.0)


def reject_history(
    past: Past, shown: Shown, grid: Grid, motion: np.ndarray, noise: Noise | None, strips: Strips
) -> Noise:
    """Take samples from a past that disagrees with a frame, and all of it where most would go.

    Parameters
    ----------
    past
        At the pixels of the picture; written to.
    shown
        The frame.
    grid
        Of the picture.
    motion : (h, w, 2) float32
        Pixels of the frame, finite.
    noise
        What the last frame's call gave, or None.
    strips
        Where the work runs.

    Returns
    -------
    noise
        For the next frame.
    """
    held, noise = agreement(past.accumulated.light, shown, grid.scale, motion, noise, strips)
    if held is None:
        return noise
    kept = past.accumulated
    images = (kept.light, kept.albedo, kept.specular, past.output)

    def work(rows: slice) -> None:
        share = grid.take(held, rows)
        kept.light[rows, :, 3] *= share
        lost = np.flatnonzero(share < LEAST_SHARE)
        for image in images:
            pixels_of(image[rows])[lost] = 0

    strips.run(work, *grid.full)
    return noise


def agreement(
    light: np.ndarray,
    shown: Shown,
    scale: int,
    motion: np.ndarray,
    noise: Noise | None,
    strips: Strips,
) -> tuple[np.ndarray | None, Noise]:
    """How far a frame's samples agree with the light of a past.

    Parameters
    ----------
    light : (H, W, 4) float32
        Radiance and the samples that it is worth, at the pixels of the picture, or of one that goes
        on to the right and below.
    shown
        The frame.
    scale
        Pixels of the picture for one of the frame, along each axis.
    motion, noise, strips
        As for `reject_history`.

    Returns
    -------
    share : (h, w) float32 or None
        Of the samples of a pixel of the frame, what holds; None where all does.
    noise
        For the next frame.
    """
    blocks = _compared(light, shown, scale, strips)
    return confidence(blocks, noise, motion, shown.exposure, strips, _THRESHOLDS)


def _compared(light: np.ndarray, shown: Shown, scale: int, strips: Strips) -> np.ndarray:
    """What `compare` gives for a whole frame."""
    height, width = shown.color.shape[:2]
    blocks = np.empty((PLANES, -(-height // 2), -(-width // 2)), np.float32)
    lines = outlines(*shown.features, strips) if any(shown.jitter) else None

    def work(rows: slice) -> None:
        if scale > 1:
            right, down = (scale * (0.5 + off) - 0.5 for off in shown.jitter)
            place = np.array([[scale, 0, right], [0, scale, down + scale * rows.start]])
            how, size = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, (width, rows.stop - rows.start)
            whole = light[: scale * height, : scale * width]
            before = cv2.warpAffine(whole, place, size, None, how, cv2.BORDER_REPLICATE)
        else:
            before = light[rows, :width]
        planes = strips.workspace.array("past of a strip", (4, *before.shape[:2]))
        weight = np.ones(before.shape[:2], np.float32)
        if lines is not None:
            weight[lines[rows]] = 0
        if shown.broken is not None:
            weight[shown.broken[rows]] = 0
        compare(
            luminance(shown.color[rows]),
            weight,
            planes_of(before, out=planes),
            shown.exposure,
            blocks[:, rows.start // 2 : -(-rows.stop // 2)],
            strips.workspace,
        )

    strips.run_even(work, height, width)
    return blocks
