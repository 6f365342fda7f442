"""What mirrors show moves otherwise than the mirrors: the motion of reflections.

Motion vectors follow surfaces. A flat mirror's picture lies behind it: what a pixel shows is a
point farther away than the mirror, which stands still in a still scene and moves as a point of its
depth does. So does what is seen through clear glass. Files do not hold that depth, and one noisy
sample does not tell it. But the frame's other pixels tell how points of any depth move, and of a
few depths the right one brings the past nearest to what is there now.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.resample import double, halve
from stillray.arrays.strips import STRIP_PIXELS, Strips, with_halo
from stillray.model_spec.stages import Demodulate
from stillray.stages import features as encode

# Of the surface's inverse depth: what is shown is infinitely far, four times or twice as far.
# Eight more depths took three times as long and found the past no better.
_NEARNESS = (0.0, 0.25, 0.5)
_LEAST_SHARE = 1e-3  # of the frame that mirrors must fill to be looked at
_LEAST_SIZE = 16  # pixels of a frame's shorter side
_WINDOW = 7  # pixels at half resolution, over which past and present are compared
# Another depth must bring the past this much nearer than the surface does: of noise alone, all
# depths are as near as one another.
_NEARER = np.float32(0.9)
_SAMPLES = 1024  # pixels from which the camera's motion is learned
_LEAST_SAMPLES = 64
_ROUNDS = 3  # of the fit: pixels that do not agree, as things that move, are left out of the next
_AGREES = 0.25  # pixels of motion
_TRUSTED = 0.05  # pixels: median error beyond which the fit is no camera
_NEAREST = np.float32(16)  # times the typical inverse depth; nearer points would rule the fit


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """How still points move from the previous frame, by place and depth.

    A quadratic of the place for the camera's turning, and a linear function of the place times the
    inverse depth for its travel: a perspective camera's motion field, to the second order.

    Attributes
    ----------
    turning : (6, 2) float32
        Coefficients of 1, x, y, x x, x y, y y.
    travel : (3, 2) float32
        Coefficients of 1, x, y, times the inverse depth in its unit.
    unit
        Of inverse depth.
    shape
        Height and width of the frame, pixels: x and y are 0 in its middle, and the same unit.
    """

    turning: np.ndarray
    travel: np.ndarray
    unit: float
    shape: tuple[int, int]

    def parts(
        self, rows: np.ndarray, columns: np.ndarray, depth: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Motion of points infinitely far away, and what their depth adds to it, pixels.

        Parameters
        ----------
        rows, columns
            Pixels, broadcast against each other.
        depth : float32 array
            Of their common shape, > 0.

        Returns
        -------
        far, near
            Arrays of that shape with an axis of x and y behind it, float32.
        """
        x, y = _place(rows, columns, self.shape)
        inverse = _inverse(depth, self.unit)
        far, near = (np.empty((*depth.shape, 2), np.float32) for _ in range(2))
        for axis in (0, 1):
            one, by_x, by_y, by_xx, by_xy, by_yy = self.turning[:, axis]
            far[..., axis] = (one + x * (by_x + by_xx * x)) + y * (by_y + by_yy * y)
            far[..., axis] += by_xy * x * y
            one, by_x, by_y = self.travel[:, axis]
            near[..., axis] = ((one + by_x * x) + by_y * y) * inverse
        return far, near


def camera_motion(motion: np.ndarray, depth: np.ndarray) -> CameraMotion | None:
    """Learn how still points move from a frame's motion and depth.

    Parameters
    ----------
    motion : (h, w, 2) float32
        Pixels, finite.
    depth : (h, w) float32
        Finite, 0 where nothing was hit.

    Returns
    -------
    CameraMotion or None
        None where most of the frame does not move as one camera makes it move.
    """
    height, width = shape = depth.shape
    step = max(1, int((height * width / _SAMPLES) ** 0.5))
    rows, columns = np.mgrid[step // 2 : height : step, step // 2 : width : step]
    sampled = depth[rows, columns]
    hit = sampled > 0
    if hit.sum() < _LEAST_SAMPLES:
        return None
    unit = float(np.median(1 / sampled[hit].astype(np.float64)))
    x, y = (part.astype(np.float64) for part in _place(rows[hit], columns[hit], shape))
    inverse = _inverse(sampled[hit], unit).astype(np.float64)
    place = [np.ones_like(x), x, y]
    terms = np.stack([*place, x * x, x * y, y * y, *(part * inverse for part in place)], axis=-1)
    moved = motion[rows, columns][hit].astype(np.float64)
    kept = inverse < _NEAREST
    for _ in range(_ROUNDS):
        if kept.sum() < _LEAST_SAMPLES:
            return None
        # the normal equations: nine unknowns of about one size
        square = terms[kept].T @ terms[kept]
        found = np.linalg.lstsq(square, terms[kept].T @ moved[kept], rcond=None)[0]
        error = np.abs(terms @ found - moved).max(axis=-1)
        typical = float(np.median(error))
        # half of what is looked at may disagree with the rest and does not spoil it
        kept = error <= max(_AGREES, typical)
    if typical > _TRUSTED:
        return None
    return CameraMotion(found[:6].astype(np.float32), found[6:].astype(np.float32), unit, shape)


def _place(
    rows: np.ndarray, columns: np.ndarray, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    half = np.float32(max(shape) / 2)
    x, y = columns - np.float32(shape[1] / 2), rows - np.float32(shape[0] / 2)
    return x.astype(np.float32) / half, y.astype(np.float32) / half


def _inverse(depth: np.ndarray, unit: float) -> np.ndarray:
    with np.errstate(over="ignore", divide="ignore", under="ignore"):
        return at_most(np.float32(1) / (depth * np.float32(unit)), _NEAREST)


def has_mirrors(albedo: np.ndarray, black: float) -> bool:
    """Whether so much of a frame may be mirrors that they are worth a search.

    Parameters
    ----------
    albedo : (h, w, 3) float32
    black
        Albedo that says nothing, at most.
    """
    if min(albedo.shape[:2]) < _LEAST_SIZE:
        return False
    # most frames have none, which one pixel in sixteen tells
    few = cv2.resize(albedo, None, fx=0.25, fy=0.25, interpolation=cv2.INTER_NEAREST)
    few = _is_black(few, black)
    return cv2.countNonZero(few) >= max(_LEAST_SHARE * few.size, 1)


@dataclass(frozen=True, eq=False)
class Surfaces:
    """A frame's surfaces, as its buffers have them.

    Attributes
    ----------
    motion : (h, w, 2) float32
        Of surfaces, pixels, finite.
    depth : (h, w) float32
        0 where nothing was hit.
    albedo : (h, w, 3) float32
        Renderers report 0 for valid hits of smooth mirrors and glass.
    """

    motion: np.ndarray
    depth: np.ndarray
    albedo: np.ndarray


def virtual_motion(
    surfaces: Surfaces,
    now: np.ndarray,
    past: np.ndarray,
    exposure: float,
    options: Demodulate,
    strips: Strips,
) -> np.ndarray:
    """Motion that follows what mirrors and clear glass show, where that brings the past nearer.

    For frames that `has_mirrors` picks out: the search takes time.

    Parameters
    ----------
    surfaces
        Where mirrors are looked for; not changed.
    now : (h, w) float32
        Luminance of this frame's irradiance.
    past : (h, w, 4) float32
        The irradiance accumulated up to the previous frame, in that frame's pixels.
    exposure
        1 / irradiance, to compare tone-mapped.
    options
        Albedo of at most ``black`` says nothing.
    strips
        Where the search runs.

    Returns
    -------
    (h, w, 2) float32
        Finite; the input itself where there is no mirror, or nothing shows in it that moves
        otherwise.
    """
    motion, depth, albedo = surfaces.motion, surfaces.depth, surfaces.albedo
    if not motion.any():
        return motion
    shows = _mirrors(surfaces, options.black, strips)
    if not shows.any():
        return motion
    camera = camera_motion(motion, depth)
    if camera is None:
        return motion
    left, top, wide, high = cv2.boundingRect(shows)
    before, here = _half_size(past, now, exposure, strips)
    result = _copy(motion, strips)

    def work(rows: slice) -> bool:
        rows = slice(top + rows.start, top + rows.stop)
        around, own = with_halo(rows, _WINDOW // 2, len(shows))
        box = (around, slice(left, left + wide))
        full = tuple(slice(2 * part.start, 2 * part.stop) for part in box)
        found, follows = _search(
            camera,
            _every_second(motion[full]),
            _every_second(depth[full]),
            shows[box].copy(),
            (before, here[box]),
            box,
        )
        found, follows = found[own], follows[own]
        if not follows.any():
            return False
        mine = (slice(2 * rows.start, 2 * rows.stop), full[1])
        # a motion field is smooth: what is mirror of a block follows as one
        changed = double(follows) & _is_black(np.ascontiguousarray(albedo[mine]), options.black)
        inside = np.ascontiguousarray(motion[mine])
        result[mine] = cv2.copyTo(double(found), changed, inside)
        return True

    return result if any(strips.run(work, high, wide)) else motion


def _mirrors(surfaces: Surfaces, black: float, strips: Strips) -> np.ndarray:
    """Not 0 where a mirror may be, at half the resolution, uint8."""
    half = tuple(size // 2 for size in surfaces.depth.shape)
    shows = np.empty(half, np.uint8)

    def work(blocks: slice) -> None:
        part = (slice(2 * blocks.start, 2 * blocks.stop), slice(0, 2 * half[1]))
        hit = 255 * np.greater(_every_second(surfaces.depth[part]), 0).view(np.uint8)
        dark = _is_black(_every_second(surfaces.albedo[part]), black)
        cv2.bitwise_and(dark, hit, dst=shows[blocks])

    strips.run(work, *half, pixels=STRIP_PIXELS // 4)
    return shows


def _half_size(
    past: np.ndarray, now: np.ndarray, exposure: float, strips: Strips
) -> tuple[np.ndarray, np.ndarray]:
    """Luminance of the past and of what there is now, tone-mapped, at half the resolution."""
    half = tuple(size // 2 for size in now.shape)
    before, here = np.empty(half, np.float32), np.empty(half, np.float32)

    def work(blocks: slice) -> None:
        rows = slice(2 * blocks.start, 2 * blocks.stop)
        # toned before they are averaged: a window's frame would drown in the light beside it
        for light, target in ((encode.luminance(past[rows]), before), (now[rows], here)):
            target[blocks] = halve(encode.tone_map(light[:, : 2 * half[1]], exposure))

    strips.run(work, *half, pixels=STRIP_PIXELS // 4)
    return before, here


def _copy(motion: np.ndarray, strips: Strips) -> np.ndarray:
    copy = np.empty_like(motion)

    def work(rows: slice) -> None:
        copy[rows] = motion[rows]

    strips.run(work, *motion.shape[:2])
    return copy


def _search(
    camera: CameraMotion,
    moved: np.ndarray,
    depth: np.ndarray,
    shows: np.ndarray,
    lights: tuple[np.ndarray, np.ndarray],
    box: tuple[slice, slice],
) -> tuple[np.ndarray, np.ndarray]:
    """The motion of the best of the depths, and 255 where it is not the surface's.

    Parameters
    ----------
    camera
        How still points move.
    moved : (h, w, 2) float32
        Motion of the surfaces, full-size pixels; everything here has half the resolution.
    depth : (h, w) float32
        0 where nothing was hit.
    shows : (h, w) uint8
        Not 0 in mirrors. Overwritten.
    lights
        The whole past, and what there is now ``(h, w)``, tone-mapped.
    box
        Where these pixels lie in the frame of half the size.
    """
    before, here = lights
    np.copyto(depth, np.float32(1 / camera.unit), where=depth <= 0)
    down, right = np.ogrid[box]
    far, near = camera.parts(2 * down, 2 * right, depth)
    # a mirror that moves itself shows what no camera tells
    astray = cv2.subtract(cv2.add(far, near), moved)
    shows &= cv2.inRange(astray, (-_AGREES,) * 2, (_AGREES,) * 2)
    weight = shows.astype(np.float32)
    places = cv2.merge([part.astype(np.float32) for part in np.broadcast_arrays(right, down)])

    def apart(by: np.ndarray) -> np.ndarray:
        """How far the past that a motion leads to is from the present, summed over windows."""
        at = cv2.scaleAdd(by, 0.5, places)
        taken = cv2.remap(before, at, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        difference = cv2.multiply(cv2.absdiff(taken, here), weight)
        window = (_WINDOW, _WINDOW)
        return cv2.boxFilter(difference, -1, window, borderType=cv2.BORDER_CONSTANT)

    least = apart(moved) * _NEARER
    nearness, follows = np.zeros_like(weight), np.zeros_like(shows)
    for share in _NEARNESS:
        distance = apart(cv2.scaleAdd(near, share, far))
        nearer = cv2.compare(distance, least, cv2.CMP_LT) & shows
        follows |= nearer
        cv2.copyTo(distance, nearer, least)
        nearness[nearer > 0] = share
    return far + near * nearness[..., None], follows


def _is_black(albedo: np.ndarray, black: float) -> np.ndarray:
    """255 where no channel is above, ``(h, w)`` uint8."""
    return cv2.inRange(albedo, (-1.0,) * 3, (black,) * 3)


def _every_second(image: np.ndarray) -> np.ndarray:
    """Every second pixel of every second row of an image of even sizes."""
    return cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_NEAREST)
