"""Temporal antialiasing, the last pass of both classical peers.

Schied et al. 2017 and Koskela et al. 2019 both end with the pass of Karis 2014, "High-quality
temporal supersampling": the previous picture, clipped to the colours around the pixel, is blended
with the new one.
"""

from __future__ import annotations

import cv2
import numpy as np

from stillray.stages import features as encode
from stillray_training.peers.sequence import sample

# exposed radiance beyond which the tone curve is not inverted: 1 - 1e-6 is exact in float32
MOST_EXPOSED = 1e6
# Y, Co and Cg from R, G and B
_YCOCG = np.array([[0.25, 0.5, 0.25], [0.5, 0, -0.5], [-0.25, 0.5, -0.25]], np.float32)
_RGB = np.array([[1, 1, -1], [1, 0, 1], [1, -1, -1]], np.float32)
_BOX = np.ones((3, 3), np.uint8)
_CROSS = np.array([[0, 1, 0], [1, 1, 1], [0, 1, 0]], np.uint8)


def antialias(
    picture: np.ndarray, before: np.ndarray | None, motion: np.ndarray | None, share: float
) -> np.ndarray:
    """Blend a picture with the one before it.

    The clipping box is the mean of those of the 3x3 neighbourhood and of its cross, in YCoCg
    (as the authors' program of Koskela et al. 2019 has it, after Karis 2014).

    Parameters
    ----------
    picture : (h, w, 3) float32
        Tone-mapped, in [0, 1].
    before : (h, w, 3) float32 or None
        The previous result of this function.
    motion : (h, w, 2) float32 or None
        Pixels, finite. Without it, or without a picture before, nothing is blended.
    share
        Of the new picture, (0, 1].

    Returns
    -------
    (h, w, 3) float32
        Tone-mapped, in [0, 1].
    """
    if before is None or motion is None or before.shape != picture.shape:
        return picture
    past, inside = sample(before, motion)
    colors = cv2.transform(picture, _YCOCG)
    # OpenCV's own border values never win, so windows end at the edge of the image
    least = (cv2.erode(colors, _BOX) + cv2.erode(colors, _CROSS)) / 2
    most = (cv2.dilate(colors, _BOX) + cv2.dilate(colors, _CROSS)) / 2
    clipped = cv2.transform(np.clip(cv2.transform(past, _YCOCG), least, most), _RGB)
    # a box in YCoCg has corners outside of the RGB cube
    blended = np.clip(np.float32(share) * picture + np.float32(1 - share) * clipped, 0, 1)
    return np.where(inside[..., None], blended, picture)


def to_picture(radiance: np.ndarray, exposure: float) -> np.ndarray:
    """Tone-map radiance so that it can be undone; beyond `MOST_EXPOSED` it is clipped.

    differs: both papers show the tone-mapped picture; here radiance is wanted back, so the curve
    is ``x e / (1 + x e)``.
    """
    return encode.tone_map(np.minimum(radiance, np.float32(MOST_EXPOSED / exposure)), exposure)


def to_radiance(picture: np.ndarray, exposure: float) -> np.ndarray:
    """The inverse of `to_picture`."""
    rest = np.maximum(1 - picture, np.float32(1 / (1 + MOST_EXPOSED)))
    radiance: np.ndarray = picture / rest / np.float32(exposure)
    return radiance
