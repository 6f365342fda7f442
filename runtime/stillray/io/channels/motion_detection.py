"""What a file's motion means, proven from two frames: the right convention warps one to the other.

Every convention that a renderer might use is tried: which component is x, both signs, pixels or
parts of the frame, vectors over a whole frame or half of it, stored where surfaces are now or where
they were. The previous frame's albedo and normal, or its color where it has neither, are taken
from where each candidate points and compared with the current frame's. A candidate is proven when
it is better than every other one on the very pixels where the two disagree, by a margin and beyond
chance. Otherwise nothing is proven, and the motion is not used.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise, product

import cv2
import numpy as np

from stillray.io.channels.motion_convention import UNITS, MotionConvention, nearest
from stillray.io.channels.roles import LayerMatch, find_layers, gather
from stillray.io.exr.file import Channels, ExrFile

_SAMPLES = 16_384  # moving pixels that are looked at, at most
_APART = 0.5  # pixels: two candidates disagree where they point further apart
_FEWEST = 64  # pixels on which two candidates disagree, for them to be told apart
_MARGIN = 0.9  # the best one's error is at most this share of a rival's
_DEVIATIONS = 2.5  # standard errors by which it must be better
_BLOCK = 8  # pixels: errors of one block count as one observation
_SLOWEST, _FASTEST = 0.1, 0.5  # 95th percentile of a plausible motion: pixels; share of the frame
_FLAT = 1e-3  # a feature whose pixels differ less than this has nothing to be recognised by
_SHARES = (1.0, 2.0)  # vectors over a whole frame's time, or a shutter of half of it
_BLUR = 3  # pixels
_ROW = 256  # samples are handled as an image of this width, as OpenCV wants them

_Tried = tuple[MotionConvention, np.ndarray, np.ndarray]  # with its motion and its errors


@dataclass(frozen=True)
class Candidate:
    """A convention, and the mean error of warping by it: 0 exact, 1 as bad as any other pixel."""

    convention: MotionConvention
    error: float


@dataclass(frozen=True)
class Detection:
    """What was found out.

    Attributes
    ----------
    convention
        The proven one; None where none is.
    reason
        The evidence, or why nothing is proven, in one line.
    match
        The motion layer that it is about; None where the file has none.
    features
        What was compared: ``"albedo"``, ``"normal"`` or ``"color"``.
    candidates
        The best ones, best first.
    still
        Error of no motion at all.
    pixels
        How many pixels were compared.
    """

    convention: MotionConvention | None
    reason: str
    match: LayerMatch | None = None
    features: tuple[str, ...] = ()
    candidates: tuple[Candidate, ...] = ()
    still: float = 1.0
    pixels: int = 0


def detect_motion(
    before: str | os.PathLike[str],
    now: str | os.PathLike[str],
    *,
    layers: Mapping[str, str] | None = None,
) -> Detection:
    """Prove the convention of a file's motion from it and the file of the frame before.

    Parameters
    ----------
    before, now
        Files of two consecutive frames, with the same layers.
    layers
        Role to the layer to take for it, as for `read_exr`.

    Returns
    -------
    Detection
        For `read_exr`'s ``convention``, if it is proven.

    Raises
    ------
    InputError
        A file cannot be read.
    """
    file, previous = (ExrFile.of_layers(path, layers) for path in (now, before))
    matches = {match.role: match for match in find_layers(file.channels, layers)}
    motion = matches.get("motion")
    if motion is None or motion.convention is None or "color" not in matches:
        return Detection(None, "the file has no motion to prove")
    roles: list[str] = [role for role in ("albedo", "normal") if role in matches] or ["color"]
    if any(name not in previous.channels for r in roles for name in matches[r].channels):
        return Detection(None, "the frame before has not the same layers", motion)
    window = file.window(matches["color"].channels[0])
    names = {name for role in (*roles, "motion") for name in matches[role].channels}
    planes = file.read(names, window)
    planes_before = previous.read([n for n in names if n in previous.channels], window)
    stored_before = all(name in planes_before for name in motion.channels)
    return prove(
        motion,
        _stacked(motion, planes),
        _stacked(motion, planes_before) if stored_before else None,
        {role: _comparable(role, gather(matches[role], planes)) for role in roles},
        {role: _comparable(role, gather(matches[role], planes_before)) for role in roles},
    )


def detect_in_sequence(
    paths: Sequence[str | os.PathLike[str]],
    *,
    layers: Mapping[str, str] | None = None,
    most: int = 8,
) -> Detection | None:
    """Prove what the motion of a sequence means, from the first two frames that can tell.

    Parameters
    ----------
    paths
        Files of consecutive frames, in order.
    layers
        As for `detect_motion`.
    most
        Pairs of frames to try.

    Returns
    -------
    Detection or None
        None where nothing has to be proven: there is no motion, or its renderer's is known.
    """
    if not paths or not needs_proof(paths[0], layers):
        return None
    detection = Detection(None, "one frame alone proves nothing")
    for before, now in list(pairwise(paths))[:most]:
        detection = detect_motion(before, now, layers=layers)
        if detection.convention is not None:
            break
    return detection


def needs_proof(path: str | os.PathLike[str], layers: Mapping[str, str] | None = None) -> bool:
    """Whether a file has motion that is of no use until its convention is proven."""
    names = ExrFile.of_layers(path, layers, headers_only=True).channels
    return any(m.role == "motion" and not m.used for m in find_layers(names, layers))


def prove(
    match: LayerMatch,
    vectors: np.ndarray,
    vectors_before: np.ndarray | None,
    now: Mapping[str, np.ndarray],
    before: Mapping[str, np.ndarray],
) -> Detection:
    """Compare all candidates.

    Parameters
    ----------
    match
        The motion layer; its convention is preferred among equals.
    vectors, vectors_before : (h, w, 2) float32
        As the files of the current and of the previous frame have them.
    now, before
        Feature to ``(h, w, 3)`` float32, of the current and of the previous frame.
    """
    documented = match.convention or MotionConvention()
    height, width = vectors.shape[:2]
    x, y = _moving(vectors, vectors_before)
    if x.size < _FEWEST:
        return Detection(None, "nothing moves in these frames", match)
    compared = {n: level for n in now if (level := _unrelated(before[n])) > _FLAT}
    if not compared:
        return Detection(None, "the frames have nothing to be recognised by", match)

    def error_of(motion: np.ndarray) -> np.ndarray:
        u, v = x + motion[..., 0], y + motion[..., 1]
        total = np.zeros(x.shape, np.float32)
        for name, level in compared.items():
            warped = cv2.remap(before[name], u, v, cv2.INTER_LINEAR)
            total += np.abs(warped - nearest(now[name], x, y)).mean(axis=-1) / level
        return np.minimum(total / len(compared), 1)

    still = error_of(np.zeros((*x.shape, 2), np.float32))
    vectors_here = nearest(vectors, x, y)
    tried: list[_Tried] = []
    for convention in _conventions(vectors_here, vectors_before, documented, height, width):
        if convention.stored == "before" and vectors_before is not None:
            motion, lost = convention.arriving(vectors_before, x, y)
        else:
            motion = convention.displacement(vectors_here, height, width)
            lost = ~np.isfinite(motion).all(axis=-1)
        place = np.stack([x, y], axis=-1) + motion
        lost |= (place < 0).any(axis=-1) | (place > (width - 1, height - 1)).any(axis=-1)
        # what came from out of the frame speaks neither for nor against
        tried.append((convention, motion, np.where(lost, still, error_of(motion))))
    if not tried:
        return Detection(None, "the vectors are no plausible motion in any unit", match)
    tried.sort(key=lambda entry: float(entry[2].mean()))  # stable: the documented one comes first
    tiles = -(-width // _BLOCK)
    blocks = ((y // _BLOCK) * tiles + x // _BLOCK).astype(np.intp)
    best = _preferred(tried, documented, blocks)
    listed = tuple(Candidate(convention, float(error.mean())) for convention, _, error in tried[:8])
    rest = (match, tuple(compared), listed, float(still.mean()), int(x.size))
    if best[2].mean() >= still.mean():
        return Detection(None, "no convention warps these frames better than no motion", *rest)
    for rival in tried:
        if not _alike(best, rival) and not _better(best[2], rival[2], best[1], rival[1], blocks):
            reason = f"these frames do not tell ({best[0]}) from ({rival[0]})"
            return Detection(None, reason, *rest)
    second = next((t for t in tried if not _alike(best, t)), None)
    reason = (
        f"{best[0]}: warping the previous {' and '.join(compared)} by it leaves an error of"
        f" {best[2].mean():.3f}, without motion {still.mean():.3f}"
    )
    if second is not None:
        reason += f", with the next best convention {second[2].mean():.3f}"
    return Detection(best[0], reason, *rest)


def _conventions(
    vectors: np.ndarray,
    vectors_before: np.ndarray | None,
    documented: MotionConvention,
    height: int,
    width: int,
) -> Iterator[MotionConvention]:
    """The plausible conventions, the documented one first; none twice under another unit."""
    places = ("now",) if vectors_before is None else ("now", "before")
    signs = [(sx * n, sy * n) for n in _SHARES for sx, sy in product((1.0, -1.0), repeat=2)]
    every = [
        MotionConvention(sign, swapped, unit, stored)
        for stored, swapped, unit, sign in product(places, (False, True), UNITS, signs)
    ]
    seen: set[tuple[object, ...]] = set()
    largest = np.percentile(np.abs(np.nan_to_num(vectors)), 95, axis=(0, 1))
    for convention in [documented, *every]:
        if convention.stored not in places:
            continue
        scales = convention.scales(height, width)
        key = (scales, convention.swapped, convention.stored)
        spans = largest[::-1] if convention.swapped else largest
        reach = np.hypot(spans[0] * scales[0], spans[1] * scales[1])
        if key not in seen and _SLOWEST <= reach <= _FASTEST * max(height, width):
            seen.add(key)
            yield convention


def _preferred(tried: Sequence[_Tried], documented: MotionConvention, blocks: np.ndarray) -> _Tried:
    """The one with the least error; the documented one where those pixels do not contradict it."""
    best = tried[0]
    for entry in tried:
        if entry[0] == documented and not _better(best[2], entry[2], best[1], entry[1], blocks):
            return entry
    return best


def _better(
    error: np.ndarray,
    rival: np.ndarray,
    motion: np.ndarray,
    motion_of_rival: np.ndarray,
    blocks: np.ndarray,
) -> bool:
    """Whether an error is smaller where the two motions disagree, by a margin and beyond chance.

    Errors of neighbours are alike: each block of pixels, by number in ``blocks``, counts once.
    """
    difference = motion - motion_of_rival
    apart = np.hypot(difference[..., 0], difference[..., 1]) > _APART
    if np.count_nonzero(apart) < _FEWEST:
        return False
    if error[apart].mean() > _MARGIN * rival[apart].mean():
        return False
    count = np.bincount(blocks[apart])
    seen = count > 0
    gains = np.bincount(blocks[apart], weights=(rival - error)[apart])[seen] / count[seen]
    if len(gains) < 2:
        return True  # too small a picture to count blocks
    chance = gains.std(ddof=1) / np.sqrt(len(gains))
    return bool(gains.mean() > _DEVIATIONS * chance)


def _alike(one: _Tried, other: _Tried) -> bool:
    """Whether two say the same of a motion that does not change between frames."""
    a, b = one[0], other[0]
    return (a.signs, a.swapped, a.unit) == (b.signs, b.swapped, b.unit)


def _moving(
    vectors: np.ndarray, vectors_before: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Some of the pixels with any motion, as ``(rows, _ROW)`` float32 positions."""
    moving = np.any(vectors != 0, axis=-1)
    if vectors_before is not None:
        moving |= np.any(vectors_before != 0, axis=-1)
    at = np.flatnonzero(moving)
    count = min(len(at), _SAMPLES)
    if count == 0:
        return np.zeros((0, 1), np.float32), np.zeros((0, 1), np.float32)
    at = at[np.linspace(0, len(at) - 1, count).astype(np.intp)]
    # an image has full rows only: a few pixels are left out of the last
    columns = min(_ROW, count)
    grid = at[: count // columns * columns].reshape(-1, columns)
    row, column = np.divmod(grid, vectors.shape[1])
    return column.astype(np.float32), row.astype(np.float32)


def _unrelated(image: np.ndarray) -> float:
    """The mean difference of pixels that have nothing to do with each other."""
    pixels = image.reshape(-1, image.shape[-1])
    shuffled = np.random.default_rng(0).permutation(pixels)
    return float(np.abs(pixels - shuffled).mean())


def _comparable(role: str, image: np.ndarray) -> np.ndarray:
    image = np.nan_to_num(image, posinf=0, neginf=0)
    if role == "color":  # one bright sample must not outweigh a surface
        image = np.log1p(np.maximum(image, 0))
    # renders of few samples have noisy colors and jagged edges, which no motion explains
    return cv2.blur(image, (_BLUR, _BLUR))


def _stacked(match: LayerMatch, planes: Channels) -> np.ndarray:
    return np.stack([planes[name] for name in match.channels], axis=-1)
