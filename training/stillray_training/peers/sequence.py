"""What the classical peers share: repaired buffers, and the past brought to the current pixels."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.strips import planes_of
from stillray.frame import Frame
from stillray.model_spec.stages import Demodulate, Temporal, Transfer
from stillray.stages import features as encode
from stillray.stages import reproject
from stillray.stages.demodulate import demodulation_albedo
from stillray.stages.repair import repair_feature, repair_radiance

MAX_IRRADIANCE = 1e16  # its square, and a window's sum of squares, stay finite in float32
MAX_DEPTH = 1e15  # any unit; squared positions stay finite in float32
MAX_MOTION = 1e6  # pixels; outside of every frame


@dataclass(frozen=True, kw_only=True)
class SequenceOptions:
    """Demodulation and the tests of reprojection, the same as for stillray's own models.

    differs: both papers divide by the albedo itself and test with thresholds in units of their
    scenes; a peer gets the floor and the relative thresholds that our models get.
    """

    albedo_floor: float = 0.1  # smallest demodulation albedo of a channel, (0, 1]
    albedo_black: float = 0.001  # albedo below this in all channels: divide by 1, [0, floor]
    normal_cosine: float = 0.9  # of two normals of one surface at least, [-1, 1]
    depth_ratio: float = 0.1  # difference of two depths of one surface at most, share, > 0
    middle: float = 0.25  # exposed value of the frame's typical irradiance, > 0
    exposure_memory: float = 0.9  # share of the log exposure that is kept, [0, 1)


@dataclass(frozen=True, kw_only=True, eq=False)
class Buffers:
    """A frame as the peers filter it.

    Attributes
    ----------
    irradiance : (h, w, 3) float32
        Demodulated, in [0, MAX_IRRADIANCE].
    demodulation_albedo : (h, w, 3) float32
        What radiance was divided by; 1 where there is no albedo.
    normal : (h, w, 3) float32 or None
    depth : (h, w) float32 or None
        0 where nothing was hit.
    motion : (h, w, 2) float32 or None
        Pixels, finite.
    surface_guides : (h, w, 4) float32
        Normal and logarithm of depth, see `stillray.stages.reproject.pack`; a normal is always
        there.
    exposure
        1 / irradiance, steadied over the sequence.
    """

    irradiance: np.ndarray
    demodulation_albedo: np.ndarray
    normal: np.ndarray | None
    depth: np.ndarray | None
    motion: np.ndarray | None
    surface_guides: np.ndarray
    exposure: float

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.irradiance.shape[:2]
        return height, width


def prepare(frame: Frame, before: Buffers | None, options: SequenceOptions) -> Buffers:
    """Repair and demodulate a frame; ``before`` is the previous one, for a steady exposure."""
    color, _ = repair_radiance(frame.color)
    normal = None if frame.normal is None else repair_feature(frame.normal, -1, 1)
    depth = None if frame.depth is None else repair_feature(frame.depth, 0, MAX_DEPTH)
    motion = frame.motion
    if motion is not None:  # a point that came from nowhere came from far outside
        motion = np.nan_to_num(motion, nan=MAX_MOTION, posinf=MAX_MOTION, neginf=-MAX_MOTION)
    if frame.albedo is None:
        divide_by = np.ones_like(color)
    else:
        divide_by = demodulation_albedo(
            repair_feature(frame.albedo, 0, 1),
            Demodulate(floor=options.albedo_floor, black=options.albedo_black),
        )
    irradiance = np.minimum(color / divide_by, np.float32(MAX_IRRADIANCE))
    transfer = Transfer(
        middle=options.middle, local_size=1, exposure_memory=options.exposure_memory
    )
    exposure = encode.frame_exposure(encode.luminance(irradiance), transfer)
    if before is not None:
        exposure = encode.steady_exposure(exposure, before.exposure, transfer)
    if normal is None and depth is None:
        depth_of_all = np.ones(frame.shape, np.float32)
        surface_guides = reproject.pack(None, depth_of_all)
    else:
        surface_guides = reproject.pack(normal, depth)
    return Buffers(
        irradiance=irradiance,
        demodulation_albedo=divide_by,
        normal=normal,
        depth=depth,
        motion=motion,
        surface_guides=surface_guides,
        exposure=exposure,
    )


def bring(
    history: np.ndarray, before: Buffers, now: Buffers, options: SequenceOptions
) -> np.ndarray:
    """Bring a history to the current pixels, bilinear taps tested one by one.

    Parameters
    ----------
    history : (h, w, 4) float32
        Three values and, last, the frames that the pixel holds.
    before, now
        The frames that the history ends with and that it is wanted for, of one size.
    options
        The tests' thresholds.

    Returns
    -------
    (h, w, 4) float32
        Zeros where no tap was accepted or ``now`` has no motion.
    """
    if now.motion is None:
        return np.zeros_like(history)
    height, width = now.shape
    discontinuous = np.ones((height + 1, width + 1), np.uint8)
    reproject.mark_discontinuities(before.surface_guides, slice(0, height), discontinuous)
    temporal = Temporal(
        max_samples=1,  # not used here: each peer bounds its own memory
        outlier_ratio=1,
        normal_cosine=options.normal_cosine,
        depth_ratio=options.depth_ratio,
        albedo_samples=0,  # nor here
    )
    rows = slice(0, height)
    positions = reproject.positions_of(now.motion, rows) if now.motion.any() else None
    previous = reproject.PreviousFrame(history, before.surface_guides, discontinuous)
    return reproject.reproject(previous, planes_of(now.surface_guides), positions, rows, temporal)


def blend(
    values: np.ndarray, past: np.ndarray, least_share: float
) -> tuple[np.ndarray, np.ndarray]:
    """Running mean that becomes an exponential one: a share of ``max(1 / n, least_share)``.

    Parameters
    ----------
    values : (h, w, c) float32
        This frame's, c at most 3.
    past : (h, w, 4) float32
        As `bring` gives it: values, and the frames they hold.
    least_share
        Share of the current frame at least, (0, 1].

    Returns
    -------
    mean : (h, w, c) float32
    frames : (h, w) float32
        Frames that each pixel holds now, 1 or more.
    """
    frames = past[..., 3] + 1
    share = np.maximum(1 / frames, np.float32(least_share))[..., None]
    # two products: mean + share (new - mean) cancels where a firefly meets a dark past
    mean: np.ndarray = share * values + (1 - share) * past[..., : values.shape[2]]
    return mean, frames


def with_frames(values: np.ndarray, frames: np.ndarray) -> np.ndarray:
    """Values of up to three channels and frames held as one history ``(h, w, 4)``."""
    history = np.zeros((*frames.shape, 4), np.float32)
    history[..., : values.shape[2]] = values
    history[..., 3] = frames
    return history


def sample(image: np.ndarray, motion: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bilinear look-up of the previous picture without any test of geometry.

    Parameters
    ----------
    image : (h, w, 3) float32
    motion : (h, w, 2) float32
        Pixels, finite.

    Returns
    -------
    taken : (h, w, 3) float32
        Beyond its edge the image goes on with its last pixels.
    inside : (h, w) bool
        Whether at least one of the four taps lay in the image.
    """
    height, width = image.shape[:2]
    x = motion[..., 0] + np.arange(width, dtype=np.float32)
    y = motion[..., 1] + np.arange(height, dtype=np.float32)[:, None]
    inside = (x > -1) & (x < width) & (y > -1) & (y < height)
    np.clip(x, -1, width, out=x)
    np.clip(y, -1, height, out=y)
    taken = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return taken, inside
