"""Small lamps that were filtered away, found again in the samples and put back.

A filter takes what is far brighter than all around for fireflies: one sample by chance. Of a lamp
that pixels see themselves, a mirror or a chink in a shutter, every sample is as bright. So where
all pixels of a block are bright and alike, more so than the picture has them, the least of them is
light: chance alone would not have put it into so many pixels side by side. How likely that is is
told by bright pixels around, which stand alone.

The least of a block and the largest over all blocks that hold a pixel is the opening of
mathematical morphology (Serra 1982, chapter 2).
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave, with_halo
from stillray.arrays.workspace import Workspace
from stillray.stages.features import luminance
from stillray.stages.state import Prepared


@dataclass(frozen=True)
class Block:
    """What a block of pixels must have to be no chance.

    Attributes
    ----------
    height, width
        Pixels. No smaller than 2x3: a sample that a renderer's pixel filter spreads over pixels is
        as bright in 2x2 of them where it falls between.
    brighter
        Its least sample over the picture's largest pixel there: at a window's edge, which stays,
        samples see the window by chance. Of exponential noise so many pixels would have it once
        in a million.
    alike
        Its largest sample over its least, at most.
    strewn
        Share of pixels around, outside such blocks, that are as bright for their place, from which
        it counts for nothing; 1: it is not asked for.
    """

    height: int
    width: int
    brighter: float
    alike: float
    strewn: float


BLOCKS = (
    Block(3, 3, 1.6, 3.0, 0.1),
    Block(3, 3, 1.25, 1.1, 1.0),
    Block(2, 3, 2.4, 2.2, 0.07),
    Block(3, 2, 2.4, 2.2, 0.07),
)
_OF_SIZE = {
    size: [block for block in BLOCKS if (block.height, block.width) == size]
    for size in {(block.height, block.width): None for block in BLOCKS}
}
_ONES = np.ones((3, 3), np.uint8)
_OUTSIDE = cv2.BORDER_CONSTANT  # beyond the frame is no light
#: Over how much of ``brighter`` a block comes to count wholly.
FADE = 0.3
AROUND = 15  # pixels, odd: edge of the window that is "around"
DARKEST = 1e-3  # exposed radiance: a picture is taken for no darker
#: A pixel becomes no brighter than times the mean of the picture around: fireflies know no bounds,
#: and wide pixel filters make blocks of them. A lamp so much brighter than a wall is shown white.
MOST = 64.0
# What a pixel's share depends on: the window, what is next to a block, a block's other end and the
# blocks of those
_HALO = AROUND // 2 + 1 + 2 * (3 - 1)


@dataclass(frozen=True, eq=False)
class Restored:
    """Pixels whose light is put back.

    Attributes
    ----------
    rows, columns : (n,) int
        Where they are.
    share : (n, 1) float32
        How far they become what they were before they were filtered, (0, 1].
    scale : (n, 1) float32
        What that is multiplied by: the least of their block over theirs, (0, 1].
    """

    rows: np.ndarray
    columns: np.ndarray
    share: np.ndarray
    scale: np.ndarray

    def put_back(
        self, image: np.ndarray, light: np.ndarray, albedo: np.ndarray | None, zoom: int = 1
    ) -> np.ndarray:
        """Put the light of the picture, or of one of its layers, back into it.

        Parameters
        ----------
        image : (zoom h, zoom w, 3) float32
            Filtered; changed.
        light : (h, w, 3 or 4) float32
            The frame's own.
        albedo : (h, w, 3) float32 or None
            What that is multiplied by.
        zoom
            Pixels of the image for one of these, along each axis.

        Returns
        -------
        (zoom^2, n, 3) float32
            What was there before, for `take_back`.
        """
        own = light[self.rows, self.columns, :3] * self.scale
        if albedo is not None:
            own *= albedo[self.rows, self.columns]
        before = self.of(image, zoom)
        for at, filtered in zip(self._places(zoom), before, strict=True):
            image[at] = filtered + self.share * (own - filtered)
        return before

    def of(self, image: np.ndarray, zoom: int = 1) -> np.ndarray:
        """Those pixels of an image, ``(zoom h, zoom w, ...)`` to ``(zoom^2, n, ...)``."""
        return np.stack([image[at] for at in self._places(zoom)])

    def take_back(self, output: np.ndarray, before: np.ndarray, zoom: int = 1) -> None:
        """Undo it in a copy of the image, ``(zoom h, zoom w, 3 or 4)``, that is remembered.

        The next frame's picture is put together from this one's: at silhouettes lamps would spread
        over what moves before them.
        """
        for (rows, columns), filtered in zip(self._places(zoom), before, strict=True):
            output[rows, columns, :3] = filtered

    def _places(self, zoom: int) -> list[tuple[np.ndarray, np.ndarray]]:
        return [
            (zoom * self.rows + down, zoom * self.columns + right)
            for down, right in np.ndindex(zoom, zoom)
        ]


def restore(
    image: np.ndarray, prepared: Prepared, strips: Strips, workspace: Workspace
) -> tuple[Restored, np.ndarray]:
    """Put the light of small lamps back into a picture.

    Parameters
    ----------
    image : (h, w, 3) float32
        Radiance that was filtered, finite and >= 0; changed.
    prepared
        The frame it was made of.
    strips
        Where the work runs.
    workspace
        Where arrays lie from frame to frame.

    Returns
    -------
    restored : Restored
        Where, and how much; to be done alike to layers.
    before : (1, n, 3) float32
        What was there, see `Restored.take_back`.
    """
    height, width = image.shape[:2]
    mean, sample, albedo = prepared.history.mean, prepared.sample, prepared.remodulation_albedo
    samples, picture = (workspace.array(name, (height, width)) for name in ("samples", "picture"))

    def see(rows: slice) -> None:
        radiance = strips.workspace.array("radiance", image[rows].shape)
        if sample is None:
            cv2.cvtColor(mean[rows], cv2.COLOR_RGBA2RGB, dst=radiance)
        else:
            interleave(sample[:3, rows], out=radiance)
        if albedo is not None:
            radiance *= albedo[rows]
        luminance(radiance, out=samples[rows])
        luminance(image[rows], out=picture[rows])

    strips.run(see, height, width)
    found = find(samples, picture, prepared.history.exposure, strips)
    return found, found.put_back(image, own_light(sample, mean), albedo)


def own_light(sample: np.ndarray | None, mean: np.ndarray) -> np.ndarray:
    """A frame's own irradiance ``(h, w, 3 or 4)``, of its sample ``(4, h, w)`` beside a past.

    What was accumulated went from pixel to pixel, which makes blocks of fireflies.
    """
    return mean if sample is None else sample[:3].transpose(1, 2, 0)


def find(samples: np.ndarray, picture: np.ndarray, exposure: float, strips: Strips) -> Restored:
    """What is put back of a frame's samples.

    Parameters
    ----------
    samples, picture : (h, w) float32
        Luminance before and after filtering, finite and >= 0.
    exposure
        1 / radiance.
    strips
        Where the work runs.
    """
    height, width = samples.shape
    dark = np.float32(DARKEST / exposure)

    def work(rows: slice) -> Restored:
        near, own = with_halo(rows, _HALO, height)
        workspace = strips.workspace
        seen = workspace.array("seen", (near.stop - near.start, width))
        np.add(picture[near], dark, out=seen)
        opened = _opened(samples[near], seen, workspace)
        found = _found(samples[near], seen, opened, own)
        return replace(found, rows=found.rows + near.start)

    parts = strips.run(work, height, width)
    return Restored(
        *(np.concatenate([getattr(one, field.name) for one in parts]) for field in fields(Restored))
    )


def _opened(
    samples: np.ndarray, picture: np.ndarray, workspace: Workspace
) -> list[tuple[Block, np.ndarray]]:
    """Kinds of blocks that are there, alike and lost, and the largest of their least samples.

    There are none next to everywhere, and to see that is all that most frames cost.
    """
    least, kept, largest, limit = (
        workspace.array(name, samples.shape) for name in ("least", "kept", "largest", "limit")
    )
    lost, alike = (
        workspace.array(name, samples.shape, np.bool_) for name in ("lost blocks", "alike blocks")
    )
    found = []
    for (height, width), blocks in _OF_SIZE.items():
        kernel, first, last = _ONES[:height, :width], (0, 0), (width - 1, height - 1)
        cv2.erode(samples, kernel, least, first, 1, _OUTSIDE, 0)
        cv2.dilate(picture, kernel, kept, first, 1, _OUTSIDE, 0)
        for block in blocks:
            np.greater(least, np.multiply(kept, block.brighter, out=limit), out=lost)
            if not lost.any():
                continue
            cv2.dilate(samples, kernel, largest, first, 1, _OUTSIDE, 0)
            np.less_equal(largest, np.multiply(least, block.alike, out=limit), out=alike)
            lost &= alike
            if lost.any():
                np.multiply(least, lost, out=limit)
                found.append((block, cv2.dilate(limit, kernel, None, last, 1, _OUTSIDE, 0)))
    return found


def _found(
    samples: np.ndarray,
    picture: np.ndarray,
    opened: list[tuple[Block, np.ndarray]],
    rows: slice,
) -> Restored:
    """What is put back of some of these rows; the others are looked at."""
    anywhere = np.zeros(0, bool)
    if opened:
        anywhere = np.maximum.reduce([least[rows] for _, least in opened]) > 0
    # of few, far faster than np.nonzero
    down, across = np.divmod(np.flatnonzero(anywhere), samples.shape[1])
    at = (down + rows.start, across)
    before, after = samples[at], picture[at]
    most = np.float32(MOST) * _mean_around(picture, at)
    share, light = np.zeros_like(after), np.zeros_like(after)
    for block, least in opened:
        level = np.minimum(least[at], most)
        own = (level / after - block.brighter) * np.float32(1 / (FADE * block.brighter))
        own = np.clip(own, 0, 1)
        if block.strewn < 1 and own.any():
            own *= _by_design(samples, picture, least > 0, block, at)
        better = own * (level - after) > share * (light - after)
        share[better], light[better] = own[better], level[better]
    kept = share > 0
    scale = light[kept] / before[kept]
    return Restored(at[0][kept], at[1][kept], share[kept, None], scale[:, None])


def _mean_around(picture: np.ndarray, at: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Of some pixels; the border goes on."""
    if not len(at[0]):
        return np.empty(0, np.float32)
    mean = cv2.boxFilter(picture, -1, (AROUND, AROUND), borderType=cv2.BORDER_REPLICATE)
    return np.asarray(mean[at])


def _by_design(
    samples: np.ndarray,
    picture: np.ndarray,
    in_blocks: np.ndarray,
    block: Block,
    at: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Of some pixels: 1 where none around are as bright but in blocks, to 0 where many are."""
    beside = cv2.dilate(in_blocks.view(np.uint8), _ONES)
    strewn = samples > np.float32(block.brighter) * picture
    strewn &= beside == 0
    count = cv2.boxFilter(
        strewn.view(np.uint8), cv2.CV_8U, (AROUND, AROUND), normalize=False, borderType=_OUTSIDE
    )
    around = count[at] * np.float32(1 / AROUND**2)
    return np.clip(2 - around * np.float32(2 / block.strewn), 0, 1)
