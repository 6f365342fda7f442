"""Cuts: frames whose motion points into a picture that shows something else."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.stages import Temporal
from stillray.stages import features as encode
from stillray.stages.repair import MAX_MOTION
from stillray.stages.reproject import pack

# Chosen by measurement. Consecutive frames of four 1-spp sequences: same surface 0.93 or more,
# alike 0.96 or more, apart 0.021 or less; and so where five frames' motion is followed at once, as
# in a pan five times as fast. Cuts between them, and to a mirrored view of the same room: same
# surface 0.47 or less, alike 0.69 or less, apart 0.085 or more.
LEAST_SAME_SURFACE = 0.6
LEAST_ALIKE = 0.85
MOST_APART = 0.04  # of a tone-mapped luminance in [0, 1]
#: Fewer samples or blocks than this tell nothing: then there is no cut.
LEAST_SAMPLES = 32
_STEP = 4  # pixels: one in so many rows and columns is looked at
_BLOCK = 4  # steps: blocks whose mean luminance is compared, wide enough to outweigh the noise


@dataclass(frozen=True, kw_only=True)
class Agreement:
    """How far a frame agrees with the one before it, at the places that its motion names.

    Attributes
    ----------
    same_surface
        Share of the pixels, of those whose past lies in the frame, that show the same surface as
        `stillray.stages.reproject` would accept it; None without geometry.
    alike
        Correlation of the luminance of both, in blocks of 16 x 16 pixels; None where there are
        too few, or nothing varies.
    apart
        Mean absolute difference of those blocks, tone-mapped, in [0, 1].
    """

    same_surface: float | None
    alike: float | None
    apart: float

    @property
    def is_cut(self) -> bool:
        """Whether all that can be compared disagrees.

        Light that is switched on changes the picture and not its geometry; foliage or blur makes
        normals noisy and leaves the picture: neither is a cut.
        """
        if self.alike is None or self.alike >= LEAST_ALIKE or self.apart <= MOST_APART:
            return False
        return self.same_surface is None or self.same_surface < LEAST_SAME_SURFACE

    def __str__(self) -> str:
        parts = [] if self.alike is None else [f"luminance correlates {self.alike:.2f}"]
        if self.same_surface is not None:
            parts.append(f"{self.same_surface:.0%} of the pixels show the surface of before")
        return ", ".join(reversed(parts)) or "too small to tell"


class CutDetector:
    """Compares each frame with the one before it.

    Parameters
    ----------
    spec
        The model's: when surfaces are the same, and how frames are exposed.

    Notes
    -----
    Without motion nothing is compared, as there is no history then either.
    """

    def __init__(self, spec: ModelSpec) -> None:
        self._spec = spec
        self._before: tuple[Frame, np.ndarray] | None = None

    def reset(self) -> None:
        """Forget the last frame: the next is not compared with it."""
        self._before = None

    def compare(self, frame: Frame) -> Agreement | None:
        """How the frame agrees with the last; None where they cannot be compared.

        Its own picture is remembered for the next call.
        """
        before, toned = self._before, _toned(frame, self._spec)
        self._before = frame, toned
        if before is None or frame.motion is None or before[0].shape != frame.shape:
            return None
        column, row = _where_from(frame.motion, frame.shape)
        height, width = frame.shape
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        alike, apart = _luminance_agreement(before[1], toned, column, row, inside)
        return Agreement(
            same_surface=_share_of_same_surface(
                before[0], frame, column, row, inside, self._spec.temporal
            ),
            alike=alike,
            apart=apart,
        )


def _where_from(motion: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Nearest pixels that the sampled pixels were at: columns and rows; any integers."""
    sampled = _sampled(motion)
    row, column = np.mgrid[tuple(slice(_first(size), size, _STEP) for size in shape)]
    # what is not finite came from nowhere: far outside
    moved = np.nan_to_num(sampled, nan=MAX_MOTION, posinf=MAX_MOTION, neginf=-MAX_MOTION)
    moved = np.rint(np.clip(moved, -MAX_MOTION, MAX_MOTION)).astype(np.intp)
    return column + moved[..., 0], row + moved[..., 1]


def _share_of_same_surface(
    before: Frame,
    now: Frame,
    column: np.ndarray,
    row: np.ndarray,
    inside: np.ndarray,
    options: Temporal,
) -> float | None:
    present = [
        name
        for name in ("normal", "depth")
        if getattr(before, name) is not None and getattr(now, name) is not None
    ]
    # every other sample will do
    column, row, inside = (x[::2, ::2] for x in (column, row, inside))
    if not present or np.count_nonzero(inside) < LEAST_SAMPLES:
        return None
    at = row[inside], column[inside]
    past, own = (
        pack(normal=features.get("normal"), depth=features.get("depth"))[0]
        for features in (
            {name: _listed(getattr(before, name)[at]) for name in present},
            {name: _listed(_sampled(getattr(now, name))[::2, ::2][inside]) for name in present},
        )
    )
    same = (past[:, :3] * own[:, :3]).sum(axis=-1) >= options.normal_cosine
    same &= np.abs(past[:, 3] - own[:, 3]) <= np.log1p(options.depth_ratio)
    return float(same.mean())


def _luminance_agreement(
    before: np.ndarray, now: np.ndarray, column: np.ndarray, row: np.ndarray, inside: np.ndarray
) -> tuple[float | None, float]:
    height, width = now.shape
    at = np.minimum(row // _STEP, height - 1), np.minimum(column // _STEP, width - 1)
    past = before[np.where(inside, at[0], 0), np.where(inside, at[1], 0)]
    shown = _block_means(inside.astype(np.float32))
    seen = shown > 0.5
    if np.count_nonzero(seen) < LEAST_SAMPLES:
        return None, 0.0
    a, b = (_block_means(np.where(inside, x, 0))[seen] / shown[seen] for x in (past, now))
    apart = float(np.abs(a - b).mean())
    spread = float(a.std() * b.std())
    if spread == 0:
        return None, apart
    return float(((a - a.mean()) * (b - b.mean())).mean() / spread), apart


def _toned(frame: Frame, spec: ModelSpec) -> np.ndarray:
    """Tone-mapped luminance, a mean for every sampled pixel: ``(rows, columns)`` of samples."""
    rows = np.ascontiguousarray(frame.color[::2])  # half of them say enough, in half the time
    light = np.maximum(encode.luminance(rows), 0)  # NaN stays, negatives go
    toned = encode.tone_map(light, encode.frame_exposure(light, spec.transfer))
    height, width = (len(range(_first(size), size, _STEP)) for size in frame.shape)
    # one broken pixel costs its own sample, no more
    return np.nan_to_num(cv2.resize(toned, (width, height), interpolation=cv2.INTER_AREA))


def _block_means(samples: np.ndarray) -> np.ndarray:
    height, width = (size // _BLOCK for size in samples.shape)
    if not (height and width):
        return np.empty((0, 0), np.float32)
    whole = samples[: height * _BLOCK, : width * _BLOCK]
    return cv2.resize(whole.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA)


def _sampled(image: np.ndarray) -> np.ndarray:
    height, width = image.shape[:2]
    return image[_first(height) :: _STEP, _first(width) :: _STEP]


def _first(size: int) -> int:
    return min(_STEP // 2, size - 1)


def _listed(values: np.ndarray) -> np.ndarray:
    """Values of ``n`` pixels as a finite image of one row."""
    return np.ascontiguousarray(np.nan_to_num(values, posinf=0, neginf=0)[None], np.float32)
