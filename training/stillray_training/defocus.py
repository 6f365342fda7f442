"""A lens wide open or a shutter, before frames that were rendered through a pinhole in no time.

What a lens does not show sharp is a disc for every point, and each sample of a pixel meets another
point: color, albedo, normal and depth of few samples are noise together, at edges that are soft.
Here each sample of a pixel is that of a pixel drawn from its disc, the reference the mean over the
disc. A point shows where its own disc reaches, but for one that lies behind what is sharp: discs
gathered as they would be scattered (Potmesil and Chakravarty 1981 have the sizes of discs). While
a shutter is open points move, all by as much along one way: a line takes the place of the disc.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray_training.draws import log_uniform

_DISC = (1.0, 14.0)  # radius of the disc of what is far away, pixels
_LARGEST = 24.0  # of any
_MOVING = 0.25  # share of pictures in which things move while the shutter is open, all in focus
_ALL = 0.4  # and of those in which all moves, as where a camera turns
_BEHIND = 1.05  # times as far away as a point is what lies behind it
_GATHERED = 128  # of a disc, for a reference
_GOLDEN = np.pi * (3 - np.sqrt(5))
_FAR = 10.0  # times the largest depth is where nothing was hit


@dataclass(frozen=True, eq=False)
class Lens:
    """What a lens makes of a frame's points.

    Attributes
    ----------
    own : (h, w) float32
        Radius of each point's disc, pixels.
    reach : (h, w) float32
        Radius around each pixel in which points may lie whose discs reach it.
    depth : (h, w) float32
        Of the points, > 0.
    way
        Angle of the line that takes the place of every disc, radians; None for discs.
    """

    own: np.ndarray
    reach: np.ndarray
    depth: np.ndarray
    way: float | None = None

    def places(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """Places in the disc, or on the line, all as likely.

        Parameters
        ----------
        first, second : (h, w) or (1, 1)
            Even in [0, 1).

        Returns
        -------
        (2, h, w) or (2, 1, 1)
            Rows down and columns right, in radii.
        """
        far, turn = np.sqrt(first), 2 * np.pi * second
        if self.way is not None:
            far, turn = 2 * first - 1, np.full_like(second, self.way)
        return far * np.stack([np.sin(turn), np.cos(turn)])

    def seen(self, offset: np.ndarray, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Rows and columns of the pixels that samples show, ``(h, w)`` each.

        Parameters
        ----------
        offset : (2, h, w) or (2, 1, 1)
            Where in the disc, of a radius of 1.
        rng
            Rounds, so that the mean of many is as if pixels were interpolated.
        """
        height, width = self.own.shape
        rows, columns = np.mgrid[:height, :width]
        down, right = np.floor(offset * self.reach + rng.random((2, height, width))).astype(int)
        there = np.clip(rows + down, 0, height - 1), np.clip(columns + right, 0, width - 1)
        # half a pixel is what rounding moves
        apart = np.hypot(there[0] - rows, there[1] - columns) - 0.5
        behind = self.depth[there] > _BEHIND * self.depth
        shows = (self.own[there] >= apart) & ~(behind & (self.own < apart))
        return np.where(shows, there[0], rows), np.where(shows, there[1], columns)


@dataclass(frozen=True)
class Opening:
    """How a lens is set.

    Attributes
    ----------
    focus
        Distance of what is sharp, in units of depth, > 0.
    disc
        Radius of the disc of what is infinitely far away, pixels.
    way
        None for a lens. Else all is in focus, and what is no further away than ``focus`` moves by
        twice ``disc`` while the shutter is open, along a line of this angle, radians.
    """

    focus: float
    disc: float
    way: float | None = None


def draw_opening(depth: np.ndarray, rng: np.random.Generator) -> Opening:
    """Focused on one of a picture's points, and as wide open as is drawn.

    Parameters
    ----------
    depth : (h, w) float32
        0 where nothing was hit.
    rng
        Draws both.
    """
    distances = _hit(depth).reshape(-1)
    focus, disc = float(rng.choice(distances)), log_uniform(rng, _DISC)
    if rng.random() >= _MOVING:
        return Opening(focus, disc)
    if rng.random() < _ALL:
        focus = float(distances.max())
    return Opening(focus, disc, way=rng.uniform(0, np.pi))


def _hit(depth: np.ndarray) -> np.ndarray:
    """Depth, where nothing was hit that of something far away."""
    far = _FAR * max(float(depth.max()), 1e-6)
    return np.where(depth > 0, depth, far).astype(np.float32)


def lens_before(depth: np.ndarray, opening: Opening) -> Lens:
    """What the lens makes of a frame whose depth ``(h, w)`` is, 0 where nothing was hit."""
    depth, focus = _hit(depth), opening.focus
    if opening.way is None:
        own = np.minimum(opening.disc * np.abs(1 - focus / depth), _LARGEST)
        near = np.where(depth < focus, own, 0)
    else:
        near = own = np.where(depth <= focus, opening.disc, 0).astype(np.float32)
    side = 2 * int(np.ceil(near.max())) + 1
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (side, side))
    reach = np.maximum(own, cv2.dilate(near, disc))
    return Lens(own.astype(np.float32), reach.astype(np.float32), depth, opening.way)


def reference_through_lens(
    reference: np.ndarray, lens: Lens, rng: np.random.Generator
) -> np.ndarray:
    """The mean ``(h, w, 3)`` of what the samples of each pixel show."""
    total = np.zeros(reference.shape, np.float64)
    for index in range(_GATHERED):
        # a spiral of points that each stand for as much of the disc
        share, turn = (index + 0.5) / _GATHERED, index * _GOLDEN / (2 * np.pi) % 1
        offset = lens.places(np.full((1, 1), share), np.full((1, 1), turn))
        total += reference[lens.seen(offset, rng)]
    return (total / _GATHERED).astype(np.float32)


def sample_through_lens(frame: Frame, lens: Lens, rng: np.random.Generator) -> Frame:
    """A frame whose pixels show one point each, with its motion; exact for one sample a pixel."""
    seen = _disc_point(lens, rng)
    given = {
        name: getattr(frame, name)[seen]
        for name in ("color", "albedo", "normal", "depth", "motion")
        if getattr(frame, name) is not None
    }
    return replace(frame, **given)


def _disc_point(lens: Lens, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    shape = lens.own.shape
    return lens.seen(lens.places(rng.random(shape), rng.random(shape)), rng)


def frame_through_lens(
    frame: Frame, reference: np.ndarray, lens: Lens, samples: float, rng: np.random.Generator
) -> Frame:
    """A frame of so many samples a pixel, of which the noise-free radiance is known.

    A pixel's samples are not known one by one: each is taken for the reference of the pixel that it
    shows, and their mean is given the noise of the last one's, which is as large as theirs; no
    darker than black.

    Parameters
    ----------
    frame
        As it was rendered.
    reference : (h, w, 3)
        Its radiance without noise.
    lens
        In front of it.
    samples
        Its count.
    rng
        Draws what they show.
    """
    count, shape = max(round(samples), 1), frame.shape
    given = {
        name: getattr(frame, name)
        for name in ("albedo", "normal", "depth")
        if getattr(frame, name) is not None
    }
    color = np.zeros((*shape, 3), np.float32)
    sums = {name: np.zeros_like(plane) for name, plane in given.items()}
    last = (np.zeros(0, int), np.zeros(0, int))
    for _ in range(count):
        last = _disc_point(lens, rng)
        color += reference[last]
        for name, plane in given.items():
            sums[name] += plane[last]
    means = {name: total / np.float32(count) for name, total in sums.items()}
    # renderers write those of one sample: a mean would lie between surfaces
    for name in ("depth", "motion"):
        if getattr(frame, name) is not None:
            means[name] = getattr(frame, name)[last]
    color /= np.float32(count)
    clean = reference[last]
    share = np.minimum(1, color / np.maximum(clean, np.float32(1e-12)))
    return replace(frame, color=np.maximum(color + share * (frame.color[last] - clean), 0), **means)
