"""Images multiplied by what is one number a pixel."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace


def multiply(image: np.ndarray, gain: np.ndarray, workspace: Workspace) -> None:
    """Multiply an ``(h, w, 3)`` image by a gain ``(h, w)``."""
    of_colors = workspace.array("gain of colors", image.shape)
    image *= cv2.cvtColor(gain, cv2.COLOR_GRAY2RGB, dst=of_colors)


def multiply_all(image: np.ndarray, gain: np.ndarray, strips: Strips) -> None:
    """`multiply`, strip by strip."""

    def work(rows: slice) -> None:
        multiply(image[rows], gain[rows], strips.workspace)

    strips.run(work, *gain.shape)
