"""Means of 3x3 pixels whose weights fall with the distance of features (a joint bilateral filter).

Kazmierczyk et al. 2025, section 3.4, and Işık et al. 2021 (Interactive Monte Carlo Denoising using
Affinity of Neural Features), whose networks predict the features; the second also spread the
pixels apart.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.workspace import Workspace
from stillray.families.pyramid_logits import NEIGHBOURS

#: Squared distances beyond it weigh as it does, 1e-26: their exponentials would be denormal.
MOST_DISTANCE = 60.0


@dataclass(frozen=True, eq=False)
class Weights:
    """What nine pixels weigh in a mean, for an image with a border of the distance d.

    Attributes
    ----------
    features : (k, h + 2 d, w + 2 d) float32
    other : (h + 2 d, w + 2 d) float32
        What a pixel weighs to others, >= 0; 0 where the border lies outside of the frame.
    own : (h, w) float32
        What it weighs to itself, > 0.
    """

    features: np.ndarray
    other: np.ndarray
    own: np.ndarray


def gaussian(
    values: np.ndarray,
    weights: Weights,
    out: np.ndarray,
    workspace: Workspace,
    distance: int = 1,
) -> None:
    """Weighted means of nine pixels: itself, and the eight at a distance.

    A neighbour q of p weighs ``other_q exp(-|f_p - f_q|^2)``, p itself ``own_p``.

    Parameters
    ----------
    values : (c, h + 2 d, w + 2 d) float32
        With a border of the distance d.
    weights
        Of the pixels.
    out : (c, h, w) float32
        Written.
    workspace
        Where temporaries lie.
    distance
        From pixel to pixel.
    """
    height, width = out.shape[1:]
    inner = _window(distance, distance, height, width)
    total = workspace.array("total", (height, width))
    np.copyto(total, weights.own)
    for plane, sums in zip(values, out, strict=True):
        np.multiply(plane[inner], weights.own, out=sums)
    share = workspace.array("share", (height, width))
    for down, right in NEIGHBOURS[len(NEIGHBOURS) // 2 :]:
        across, beyond = distance * abs(right), distance * max(right, 0)
        # pixels of which either is in the result, and the others of their pairs
        rows, columns = height + distance * down, width + across
        first = _window(distance - distance * down, distance - beyond, rows, columns)
        second = _window(distance, distance * (1 + right) - beyond, rows, columns)
        alike = workspace.array("alike", (rows, columns))
        _likeness(weights.features, first, second, alike, workspace)
        for sign, left in ((1, beyond), (-1, across - beyond)):
            top = distance * down * (sign > 0)
            place = _window(
                distance + sign * distance * down, distance * (1 + sign * right), height, width
            )
            reached = alike[_window(top, left, height, width)]
            np.multiply(reached, weights.other[place], out=share)
            total += share
            for plane, sums in zip(values, out, strict=True):
                cv2.accumulateProduct(plane[place], share, sums)
    np.reciprocal(total, out=total)
    out *= total


def framed(array: np.ndarray, filled: slice, margin: int) -> np.ndarray:
    """An array with zeros around the rows that will be filled, and left and right of them.

    Parameters
    ----------
    array : (c, h, w) float32
        Written.
    filled
        Of its rows.
    margin
        Columns on each side, 1 or more.
    """
    array[:, : filled.start] = 0
    array[:, filled.stop :] = 0
    array[..., :margin] = 0
    array[..., -margin:] = 0
    return array


_Window = tuple[slice, slice]


def _likeness(
    features: np.ndarray, first: _Window, second: _Window, out: np.ndarray, workspace: Workspace
) -> None:
    """``exp(-|f_p - f_q|^2)`` of pairs of pixels: the same for both."""
    apart = workspace.array("apart", out.shape)
    out.fill(0)
    for plane in features:
        np.subtract(plane[first], plane[second], out=apart)
        cv2.accumulateSquare(apart, out)
    np.minimum(out, np.float32(MOST_DISTANCE), out=out)
    np.negative(out, out=out)
    cv2.exp(out, dst=out)


def _window(top: int, left: int, height: int, width: int) -> _Window:
    return slice(top, top + height), slice(left, left + width)
