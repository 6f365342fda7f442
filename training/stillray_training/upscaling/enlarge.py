"""What doubling is compared with: a picture made larger after it was denoised."""

from __future__ import annotations

import cv2
import numpy as np


def enlarge(image: np.ndarray, times: int) -> np.ndarray:
    """Radiance ``(h, w, 3)``, >= 0, at some times its size, by Lanczos.

    Of its logarithm: of radiance itself Lanczos draws black rims around what is bright.
    """
    height, width = image.shape[:2]
    size = (width * times, height * times)
    enlarged = cv2.resize(np.log1p(image), size, interpolation=cv2.INTER_LANCZOS4)
    return np.asarray(np.expm1(np.maximum(enlarged, 0)))
