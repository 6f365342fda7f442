"""Numbers as integers of 8 bits: what a network in integers is given."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

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


@dataclass(frozen=True, eq=False)
class InSteps:
    """Planes of numbers, as a network in integers gives them.

    Attributes
    ----------
    integers : (planes, h, w) uint8
    steps
        What they stand for.
    """

    integers: np.ndarray
    steps: Steps

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the planes."""
        return self.integers.shape

    def numbers(self) -> np.ndarray:
        """The numbers, ``(planes, h, w)`` float32."""
        return numbers_of(self.steps)[self.integers]


#: What a network gives: planes of numbers, or of integers that stand for some.
Output = np.ndarray | InSteps


def in_numbers(outputs: Iterable[Output]) -> list[np.ndarray]:
    """Outputs of a network as numbers, whatever it gave."""
    return [each.numbers() if isinstance(each, InSteps) else each for each in outputs]


def numbers_of(steps: Steps) -> np.ndarray:
    """What each of the 256 integers stands for, float32."""
    return (np.arange(256) - steps.zero).astype(np.float32) * np.float32(steps.scale)


def in_steps(
    planes: Iterable[np.ndarray], steps: Sequence[Steps], out: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """Numbers as integers of 8 bits, pixel by pixel.

    Parameters
    ----------
    planes : (h, w) float32 each
        Within 2e9 steps of 0, as features are: what is beyond would wrap.
    steps
        What the integers of each plane stand for.
    out : (h, w, planes) uint8
        Contiguous; written and returned.
    workspace
        For what lies between.
    """
    shape, count = out.shape[:2], len(steps)
    integers = workspace.array("planes in steps", (count, *shape), np.uint8)
    whole = workspace.array("steps", shape)
    for plane, step, target in zip(planes, steps, integers, strict=True):
        # Rounded before the zero is added: a sum in float32 has lost what lies near a half, and
        # frames that differ in their exposure alone would be given other integers.
        np.divide(plane, np.float32(step.scale), out=whole)
        np.rint(whole, out=whole)
        cv2.addWeighted(whole, 1, whole, 0, step.zero, dst=target, dtype=cv2.CV_8U)
    cv2.transpose(integers.reshape(count, -1), dst=out.reshape(-1, count))
    return out
