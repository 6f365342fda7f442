"""Reprojection: where a pixel's surface was in the previous frame, and what was known of it."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_least
from stillray.arrays.strips import Strips, interleave, pixels_of, planes_of
from stillray.arrays.workspace import Workspace
from stillray.model_spec.stages import Temporal
from stillray.stages.sharpening import Sharpening

# A 2x2 block of the previous frame is one smooth surface when its normals' components and its
# depth's logarithm span no more than this: then its four taps are accepted or refused together.
SMOOTH_NORMAL = 0.2
SMOOTH_DEPTH = 0.1
_SMOOTH = np.array([SMOOTH_NORMAL] * 3 + [SMOOTH_DEPTH], np.float32)
_FOUR_TRUE = np.ones(4, bool).view(np.uint32)[0]
_NEAREST, _FARTHEST = np.float32(1e-30), np.float32(1e30)  # unit of depth: finite logarithms
_EMPTY_DEPTH = np.float32(-100)  # "logarithm of the depth" of background: far from all surfaces
_NO_NORMAL = 0.25  # a normal with no component beyond this points nowhere
_EVEN_LENGTH = (0.98, 1.02)  # squared length of a normal that is left as it is: rounding of halves
_AROUND = np.ones((3, 3), np.uint8)
_TINY = np.float32(1e-12)  # share of a tap: keeps 0/0 out of pixels without a tap
#: Square pixels of blur below which a look does not count as between pixels.
LEAST_BLUR = 1e-6


def pack(
    normal: np.ndarray | None, depth: np.ndarray | None, workspace: Workspace | None = None
) -> np.ndarray:
    """Guides of a frame's rows as ``(h, w, 4)``, see `surface_guide_planes`."""
    planes = surface_guide_planes(normal, depth, workspace or Workspace())
    return interleave(planes, out=np.empty((*planes.shape[1:], 4), np.float32))


def surface_guide_planes(
    normal: np.ndarray | None, depth: np.ndarray | None, workspace: Workspace
) -> np.ndarray:
    """Guides of a frame's rows: the geometry that tells whether two pixels show one surface.

    A feature that is missing agrees with everything.

    Parameters
    ----------
    normal : (h, w, 3) float32 or None
        0 where nothing was hit.
    depth : (h, w) float32 or None
        0 where nothing was hit. One of both must be given.
    workspace
        Where the result and what leads to it lie.

    Returns
    -------
    (4, h, w) float32
        Normal and the logarithm of depth.
    """
    present = normal if normal is not None else depth
    if present is None:
        raise ValueError("one of normal and depth must be given")
    shape = present.shape[:2]
    planes = workspace.array("guides", (4, *shape))
    x, y, z, logarithm = planes
    if depth is None:
        logarithm.fill(0)
    else:
        cv2.log(np.clip(depth, _NEAREST, _FARTHEST, out=logarithm), dst=logarithm)
        if depth.min() <= 0:
            np.copyto(logarithm, _EMPTY_DEPTH, where=depth <= 0)
    if normal is None:
        x.fill(1)
        y.fill(0)
        z.fill(0)
        return planes
    planes_of(normal, out=planes[:3])
    length = np.square(x, out=workspace.array("length", shape))
    cv2.accumulateSquare(y, length)
    cv2.accumulateSquare(z, length)
    # what has no normal gets one, so that it agrees with its like; its depth tells it apart
    none: np.ndarray | None = None
    if length.min() <= 4 * _NO_NORMAL**2:  # three such components square to 3 times that at most
        none = cv2.inRange(normal, (-_NO_NORMAL,) * 3, (_NO_NORMAL,) * 3) > 0
        length[none] = 1
    least, most = _EVEN_LENGTH
    if length.min() < least or length.max() > most:
        # filtered, packed or scaled normals: their length says nothing of the surface
        planes[:3] *= np.reciprocal(np.sqrt(length, out=length), out=length)
    if none is not None:
        x[none] = 1
        y[none] = z[none] = 0
        if depth is None:
            logarithm[none] = _EMPTY_DEPTH
    return planes


def mark_discontinuities(
    packed: np.ndarray, rows: slice, out: np.ndarray, workspace: Workspace | None = None
) -> None:
    """Mark where the 2x2 block that begins at a pixel holds more than one smooth surface.

    Parameters
    ----------
    packed : (h, w, 4) float32
        Guides of the whole previous frame.
    rows
        The rows of the frame to mark.
    out : (h + 1, w + 1) uint8
        Element (y, x) is of the block with its top left at (y - 1, x - 1): 1 for more than one.
        Blocks that stick out of the frame are.
    workspace
        Where temporaries lie, if given.
    """
    workspace = workspace or Workspace()
    top = max(rows.start - 1, 0)
    strip = packed[top : rows.stop]
    block = np.ones((2, 2), np.uint8)
    most, least = (workspace.array(name, strip.shape) for name in ("most", "least"))
    # anchored at its bottom right, the block of (y, x) holds (y - 1, x - 1) .. (y, x)
    cv2.dilate(strip, block, dst=most, anchor=(1, 1))
    cv2.erode(strip, block, dst=least, anchor=(1, 1))
    most -= least
    limits = np.tile(_SMOOTH, strip.shape[1])
    smooth = most.reshape(len(strip), -1) <= limits
    # four booleans at once
    discontinuous = smooth.view(np.uint32) != _FOUR_TRUE
    out[rows, 0] = out[rows, -1] = 1
    out[top + 1 : rows.stop, 1:-1] = discontinuous[1:, 1:]
    if rows.start == 0:
        out[0] = 1
    if rows.stop == len(packed):
        out[rows.stop] = 1


def positions_of(motion: np.ndarray, rows: slice, out: np.ndarray | None = None) -> np.ndarray:
    """Where the pixels of some rows were in the previous frame.

    Parameters
    ----------
    motion : (rows, w, 2) float32
        Of these rows, pixels.
    rows
        Which rows of the frame they are.
    out : (rows, w, 2) float32, optional
        Written and returned.

    Returns
    -------
    (rows, w, 2) float32
        x and y, pixels.
    """
    columns = np.zeros((motion.shape[1], 2), np.float32)
    columns[:, 0] = np.arange(motion.shape[1])
    positions: np.ndarray = np.add(motion, columns, out=out)
    positions[..., 1] += np.arange(rows.start, rows.stop, dtype=np.float32)[:, None]
    return positions


@dataclass(frozen=True, eq=False)
class Edges:
    """Where an output has edges, and how sharp they are.

    Attributes
    ----------
    output
        The output's luminance.
    contrasts : (H, W) uint8
        From its `Sharpening.contrasts`.
    near : (H, W) uint8
        1 where these are within a pixel: a look has one among the 4x4 pixels around it.
    """

    output: Sharpening
    contrasts: np.ndarray
    near: np.ndarray

    @classmethod
    def of(
        cls,
        output: np.ndarray | None,
        contrast: float,
        strips: Strips,
        light: Sharpening | None = None,
    ) -> Edges | None:
        """Of an output ``(H, W, 4)``; None without one, or where the contrast asked for is 0.

        ``light`` is the output's, where it has been made already.
        """
        if output is None or not contrast:
            return None
        light = light or Sharpening(output, strips)
        contrasts = light.contrasts(contrast)
        near = strips.workspace.array("near contrasts", contrasts.shape, np.uint8)
        return cls(light, contrasts, cv2.dilate(contrasts, _AROUND, dst=near))

    def sharpen(self, taken: np.ndarray, positions: np.ndarray, workspace: Workspace) -> None:
        """See `Sharpening.sharpen`."""
        self.output.sharpen(taken, positions, self.contrasts, workspace)

    def least(
        self, everywhere: float, here: float, positions: np.ndarray, workspace: Workspace
    ) -> np.ndarray:
        """The least of two numbers near these edges, ``(h, w)`` float32; elsewhere the first."""
        corner = np.floor(positions, out=workspace.array("corner", positions.shape))
        border = cv2.BORDER_CONSTANT  # beside the frame there are none
        near = cv2.remap(self.near, corner, None, cv2.INTER_NEAREST, None, border, 0)
        numbers = np.array([everywhere, min(everywhere, here)], np.float32)
        room = workspace.array("number near edges", near.shape)
        return np.take(numbers, near, out=room, mode="clip")


@dataclass(frozen=True, eq=False)
class PreviousFrame:
    """What is remembered of the previous frame, whole.

    Attributes
    ----------
    light : (H, w, 4) float32
        Irradiance and, last, the samples that it holds.
    surface_guides : (H, w, 4) float32 or None
        See `pack`; None where it had none.
    discontinuities : (H + 1, w + 1) uint8 or None
        Their `mark_discontinuities`; not needed where nothing moves.
    edges
        Those of its output, by which looks at the light are sharpened; None: they are not.
    """

    light: np.ndarray
    surface_guides: np.ndarray | None = None
    discontinuities: np.ndarray | None = None
    edges: Edges | None = None


def reproject(
    previous: PreviousFrame,
    now: np.ndarray | None,
    positions: np.ndarray | None,
    rows: slice,
    options: Temporal,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """Bring the history to the current pixels, bilinear taps accepted one by one.

    A tap counts when it lies in the frame and shows the same surface: its normal within
    ``normal_cosine`` of the current pixel's, and the deeper of both at most ``1 + depth_ratio``
    times as deep as the other. The weights of the accepted taps are normalised, so that one good
    tap is enough; the sample count is scaled by the accepted share, so that a pixel at a
    disocclusion does not claim more than it has (Fan et al. 2021, section 4.1; differs: per tap,
    as in Schied et al. 2017, section 4.1, and no world positions are needed).

    A look between pixels blurs: two taps at distances ``f`` and ``1 - f`` spread light by ``f (1 -
    f)`` square pixels in each direction. What is held for ``n`` frames has been looked at ``n``
    times, and light of a bright window has come into the bars before it; so with ``most_blur`` no
    pixel claims more samples than that over the blur of this look, and with ``edge_blur`` those
    that have an edge of the last output among the 4x4 pixels around them (docs/decisions.md).

    With ``sharp_contrast`` a look at one surface where the last output has an edge of that contrast
    is made as sharp as a look at that output by cubic convolution: a mean of four, frame after
    frame, would bring a window's light into the bars before it.

    Most pixels look back at one smooth surface, where the four taps share their fate and one
    interpolation answers for them all; only the others are taken apart.

    Parameters
    ----------
    previous
        Where it is brought from.
    now : (4, h, w) float32 or None
        Guides of the rows to fill, see `surface_guide_planes`.
    positions : (h, w, 2) float32 or None
        Where each of the pixels to fill was, x and y in pixels, finite; None where nothing moves.
    rows
        The rows of the frame to fill.
    options
        Thresholds.
    workspace
        Where the result and what leads to it lie, if given.

    Returns
    -------
    (h, w, 4) float32
        Irradiance and samples at the current pixels; zeros where no tap was accepted.
    """
    workspace = workspace or Workspace()
    history, before = previous.light, previous.surface_guides
    (height, width), count = history.shape[:2], rows.stop - rows.start
    taken = workspace.array("taken", (count, width, 4))
    compared = workspace.array("compared", (count, width, 4))
    if positions is None:
        np.copyto(taken, history[rows])
        if before is not None:
            np.copyto(compared, before[rows])
    else:
        bilinear(history, positions, taken)
        if before is not None:
            bilinear(before, positions, compared)
    if before is not None and now is not None:
        same = _same_surface(
            planes_of(compared, out=workspace.array("before", (4, count, width))), now, options
        )
        pixels_of(taken)[np.flatnonzero(~same)] = 0
    if positions is None:
        return taken
    if previous.edges is not None:
        previous.edges.sharpen(taken, positions, workspace)
    corner = np.floor(positions, out=workspace.array("corner", positions.shape))
    if previous.discontinuities is None:
        left, top = corner[..., 0], corner[..., 1]
        apart = (left < 0) | (left >= width - 1) | (top < 0) | (top >= height - 1)
    else:
        corner += 1
        apart = _nearest(previous.discontinuities, corner).view(bool)
    at = np.flatnonzero(apart)
    if at.size:
        now_listed = None if now is None else np.take(now.reshape(4, -1), at, axis=1)
        positions_listed = np.take(pixels_of(positions), at)
        listed = _tap_by_tap(
            history, before, now_listed, positions_listed.view(np.float32).reshape(-1, 2), options
        )
        pixels_of(taken)[at] = pixels_of(listed)
    if options.edge_blur and previous.edges is not None:
        everywhere = options.most_blur or np.inf
        most = previous.edges.least(everywhere, options.edge_blur, positions, workspace)
        bound_blur(taken, positions, most, workspace)
    elif options.most_blur:
        bound_blur(taken, positions, options.most_blur, workspace)
    return taken


def bound_blur(
    taken: np.ndarray, positions: np.ndarray, most: float | np.ndarray, workspace: Workspace
) -> None:
    """Bound samples of ``taken``, ``(h, w, 4)``, by what looking between pixels blurs.

    Parameters
    ----------
    taken : (h, w, 4) float32
        What was looked up; its last channel, the samples that it is worth, is bounded in place.
    positions : (h, w, 2) float32
        Where, x and y in pixels.
    most : or (h, w) float32
        Square pixels, see `reproject`.
    workspace
        For what lies between.
    """
    share = np.floor(positions, out=workspace.array("corner", positions.shape))
    np.subtract(positions, share, out=share)
    share -= np.square(share, out=workspace.array("squared share", share.shape))
    blur = np.add(share[..., 0], share[..., 1], out=workspace.array("blur", share.shape[:2]))
    at_least(blur, LEAST_BLUR, out=blur)
    np.minimum(taken[..., 3], np.divide(most, blur, out=blur), out=taken[..., 3])


def _tap_by_tap(
    history: np.ndarray,
    before: np.ndarray | None,
    now: np.ndarray | None,
    positions: np.ndarray,
    options: Temporal,
) -> np.ndarray:
    """The definition, for a list of ``n`` pixels: guides ``(4, n)``, positions ``(n, 2)``."""
    count, (height, width) = len(positions), history.shape[:2]
    corner = np.floor(positions)
    column, share_x = _both_taps(positions[:, 0] - corner[:, 0], corner[:, 0], width)
    row, share_y = _both_taps(positions[:, 1] - corner[:, 1], corner[:, 1], height)
    at = (row[:, None] * width + column).reshape(4, count)
    weight = (share_y[:, None] * share_x).reshape(4, count)

    def taps(image: np.ndarray) -> np.ndarray:
        return planes_of(np.take(pixels_of(image), at).view(np.float32).reshape(4, count, 4))

    if before is not None and now is not None:
        weight *= _same_surface(taps(before), now.reshape(4, 1, count), options)
    total = np.einsum("ctn,tn->cn", taps(history), weight)
    # samples stay scaled by the accepted share; irradiance is normalised
    total[:3] /= np.maximum(weight.sum(axis=0), _TINY)
    return interleave(total[:, None], out=np.empty((1, count, 4), np.float32))


def _both_taps(share: np.ndarray, corner: np.ndarray, extent: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices and weights ``(2, n)`` of the taps along one axis; weight 0 outside of the frame."""
    tap = np.stack([corner, corner + 1])
    weight = np.stack([1 - share, share])
    weight *= (tap >= 0) & (tap < extent)
    return np.clip(tap, 0, extent - 1).astype(np.intp), weight


def _same_surface(before: np.ndarray, now: np.ndarray, options: Temporal) -> np.ndarray:
    """Whether planes of guides ``(4, h, w)`` show one surface: ``(h, w)`` bool; overwrites."""
    depth_apart = before[3]
    depth_apart -= now[3]
    np.abs(depth_apart, out=depth_apart)
    near: np.ndarray = depth_apart <= np.float32(np.log1p(options.depth_ratio))
    before[:3] *= now[:3]
    cosine = before[0]
    cosine += before[1]
    cosine += before[2]
    near &= cosine >= np.float32(options.normal_cosine)
    return near


def bilinear(image: np.ndarray, positions: np.ndarray, out: np.ndarray) -> None:
    """An image of four channels at positions ``(h, w, 2)``, into ``out``; zeros lie outside of it.

    Exact at four channels; for some other counts OpenCV rounds positions to 1/32 pixel.
    """
    cv2.remap(image, positions, None, cv2.INTER_LINEAR, out, cv2.BORDER_CONSTANT, 0)


def _nearest(image: np.ndarray, at: np.ndarray) -> np.ndarray:
    border = cv2.BORDER_CONSTANT
    return cv2.remap(image, at, None, cv2.INTER_NEAREST, borderMode=border, borderValue=1)
