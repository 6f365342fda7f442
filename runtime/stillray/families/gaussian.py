"""Means of 3x3 pixels whose weights fall with the distance of features (a joint bilateral filter).

Kazmierczyk et al. 2025, section 3.4, and Işık et al. 2021 (Interactive Monte Carlo Denoising using
Affinity of Neural Features), whose networks predict the features; the second also spread the
pixels apart.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_least
from stillray.arrays.workspace import Workspace
from stillray.families.pyramid_logits import NEIGHBOURS
from stillray.stages.features import luminance_of_planes

#: Squared distances beyond it weigh as it does, 1e-26: their exponentials would be denormal.
MOST_DISTANCE = 60.0
#: A pixel never weighs less than its inverse by its brightness alone: sums stay far above zero.
MOST_TONED = np.float32(1e6)
_ROOT = math.sqrt(2)


@dataclass(frozen=True, eq=False)
class Weights:
    """What nine pixels weigh in a mean, for an image with a border of the distance d.

    Attributes
    ----------
    features : (k, h + 2 d, w + 2 d) float32
        Times the root of 2, see `measured`.
    norms : (h + 2 d, w + 2 d) float32
        Of the features.
    other : (h + 2 d, w + 2 d) float32
        What a pixel weighs to others, >= 0; 0 where the border lies outside of the frame.
    own : (h, w) float32
        What it weighs to itself, > 0.
    """

    features: np.ndarray
    norms: np.ndarray
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
        cv2.multiply(plane[inner], weights.own, dst=sums)
    # what a pixel gives to others is weighed once, not for each of them
    given = workspace.array("given", values.shape)
    for plane, target in zip(values, given, strict=True):
        cv2.multiply(plane, weights.other, dst=target)
    norms = weights.norms
    for down, right in NEIGHBOURS[len(NEIGHBOURS) // 2 :]:
        across, beyond = distance * abs(right), distance * max(right, 0)
        # pixels of which either is in the result, and the others of their pairs
        rows, columns = height + distance * down, width + across
        first = _window(distance - distance * down, distance - beyond, rows, columns)
        second = _window(distance, distance * (1 + right) - beyond, rows, columns)
        alike = workspace.array("alike", (rows, columns))
        # |f_p - f_q|^2 = |f_p|^2 + |f_q|^2 - 2 f_p f_q: a product a feature, no difference; what
        # cancels is at most k times the bound of features squared, 1e-4 of a share in float32
        cv2.add(norms[first], norms[second], dst=alike)
        for plane in weights.features:
            cv2.accumulateProduct(plane[first], plane[second], alike)
        at_least(alike, -MOST_DISTANCE, out=alike)
        cv2.exp(alike, dst=alike)
        for sign, left in ((1, beyond), (-1, across - beyond)):
            top = distance * down * (sign > 0)
            place = _window(
                distance + sign * distance * down, distance * (1 + sign * right), height, width
            )
            reached = alike[_window(top, left, height, width)]
            cv2.accumulateProduct(weights.other[place], reached, total)
            for plane, sums in zip(given, out, strict=True):
                cv2.accumulateProduct(plane[place], reached, sums)
    np.reciprocal(total, out=total)
    for sums in out:
        cv2.multiply(sums, total, dst=sums)


def measured(features: np.ndarray, norms: np.ndarray) -> None:
    """Make features ready for `Weights`.

    Parameters
    ----------
    features : (k, h, w) float32
        Multiplied by the root of 2: their product is then twice that of the features.
    norms : (h, w) float32
        Written: minus the squared length of the features, as they were given.
    """
    norms.fill(0)
    for plane in features:
        # not by OpenCV, which takes four rows of one pixel for a scalar, as in all it adds one to
        plane *= _ROOT
        cv2.accumulateSquare(plane, norms)
    norms *= np.float32(-0.5)


def share_of_bright(light: np.ndarray, exposure: float, tone: float, out: np.ndarray) -> None:
    """What bright pixels weigh of what a network says: 1 / (1 + tone x).

    Parameters
    ----------
    light : (3, h, w) float32
        Irradiance >= 0.
    exposure
        What its luminance is multiplied by; x is how far the product is above 1.
    tone
        Above 0.
    out : (h, w) float32
        Written: 1 where x is 0, no less than 1 / `MOST_TONED`.
    """
    luminance_of_planes(light, out)
    out *= np.float32(tone * exposure)
    out -= np.float32(tone - 1)
    np.clip(out, np.float32(1), MOST_TONED, out=out)
    np.reciprocal(out, out=out)


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


def _window(top: int, left: int, height: int, width: int) -> _Window:
    return slice(top, top + height), slice(left, left + width)
