"""Numbers as integers of 8 bits: what a network in integers is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import groupby

import cv2
import numpy as np

from stillray.arrays.workspace import Workspace


@dataclass(frozen=True)
class Steps:
    """Numbers as integers of 8 bits: ``scale (integer - zero)``, rounded to the nearest, bounded.

    Attributes
    ----------
    scale
        Of one step, > 0.
    zero
        The integer that stands for 0, 0 to 255.
    """

    scale: float
    zero: int


def in_steps(
    planes: np.ndarray, steps: Sequence[Steps], out: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """Numbers as integers of 8 bits, pixel by pixel.

    Parameters
    ----------
    planes : (c, h, w) float32
        Contiguous; within 2e9 steps of 0, as features are: what is beyond would wrap.
    steps
        What the integers of each plane stand for.
    out : (h, w, c) uint8
        Contiguous; written and returned.
    workspace
        For what lies between.
    """
    flat = planes.reshape(len(planes), -1)
    integers = workspace.array("planes in steps", flat.shape, np.uint8)
    first = 0
    for step, alike in groupby(steps):
        part = slice(first, first := first + len(list(alike)))
        values, target = flat[part], integers[part]
        rounded(values, step, target, workspace)
    return interleaved(integers, out)


def rounded(values: np.ndarray, step: Steps, out: np.ndarray, workspace: Workspace) -> None:
    """Numbers ``(h, w)`` as integers into ``out``, uint8."""
    # Rounded before the zero is added: a sum in float32 has lost what lies near a half, and frames
    # that differ in their exposure alone would be given other integers.
    whole = np.divide(values, np.float32(step.scale), out=workspace.array("steps", values.shape))
    np.rint(whole, out=whole)
    cv2.addWeighted(whole, 1, whole, 0, step.zero, dst=out, dtype=cv2.CV_8U)


def interleaved(integers: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Planes ``(c, ...)`` uint8 as pixels ``(..., c)``, both contiguous."""
    count = len(integers)
    cv2.transpose(integers.reshape(count, -1), dst=out.reshape(-1, count))
    return out
