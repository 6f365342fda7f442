"""Numbers as integers of 8 bits: what a network in integers is given."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stillray.arrays.workspace import Workspace

#: Metadata of a file whose features lie otherwise than in their specification's order: `layout_of`.
PLACES_KEY = "stillray.places"
_SHOWN = 80  # characters of what cannot be read


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


@dataclass(frozen=True)
class Column:
    """How a plane of numbers is part of a pixel of integers.

    Attributes
    ----------
    place
        Which of the pixel's integers it is.
    steps
        What they stand for.
    """

    place: int
    steps: Steps


@dataclass(frozen=True)
class PixelLayout:
    """What the integers of a pixel are.

    Attributes
    ----------
    columns
        Of each feature.
    size
        Integers of a pixel. Those that are of no feature are 0, and nothing depends on them:
        ONNX Runtime convolves a multiple of four planes faster.
    """

    columns: tuple[Column, ...]
    size: int


def layout_of(steps: Sequence[Steps], told: str | None) -> PixelLayout:
    """Where each of a network's features is in a pixel.

    Parameters
    ----------
    steps
        What the integers of a pixel stand for, one after the other.
    told
        A file's metadata of `PLACES_KEY`: a place for each feature, as JSON, and no two alike;
        None where they lie in the order of the specification.

    Raises
    ------
    ValueError
        A place is told twice, or is none of a pixel's.
    """
    size = len(steps)
    try:
        places: Any = list(range(size)) if told is None else json.loads(told)
    except (ValueError, RecursionError):
        places = None
    known = isinstance(places, list) and all(type(place) is int for place in places)
    if not known or not places or len(set(places) & set(range(size))) < len(places):
        found = str(told)[:_SHOWN]
        raise ValueError(f"{PLACES_KEY} must hold some of {size} places, each once, got {found}")
    return PixelLayout(tuple(Column(place, steps[place]) for place in places), size)


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
    planes: Iterable[np.ndarray], layout: PixelLayout, out: np.ndarray, workspace: Workspace
) -> np.ndarray:
    """Numbers as integers of 8 bits, pixel by pixel.

    Parameters
    ----------
    planes : (h, w) float32 each
        Within 2e9 steps of 0, as features are: what is beyond would wrap.
    layout
        Of the network.
    out : (h, w, layout.size) uint8
        Contiguous; written and returned.
    workspace
        For what lies between.
    """
    shape, columns = out.shape[:2], layout.columns
    integers = workspace.array("planes in steps", (layout.size, *shape), np.uint8)
    if layout.size > len(columns):
        integers[:] = 0
    whole = workspace.array("steps", shape)
    for plane, column in zip(planes, columns, strict=True):
        # Rounded before the zero is added: a sum in float32 has lost what lies near a half, and
        # frames that differ in their exposure alone would be given other integers.
        np.divide(plane, np.float32(column.steps.scale), out=whole)
        np.rint(whole, out=whole)
        target, zero = integers[column.place], column.steps.zero
        cv2.addWeighted(whole, 1, whole, 0, zero, dst=target, dtype=cv2.CV_8U)
    cv2.transpose(integers.reshape(layout.size, -1), dst=out.reshape(-1, layout.size))
    return out
