"""Spatiotemporal variance-guided filtering (Schied et al. 2017), on the CPU, for comparison.

Irradiance and the moments of its luminance are accumulated over time; their variance steers five
passes of an edge-avoiding wavelet filter, the first of which is what the next frame remembers.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from itertools import product

import cv2
import numpy as np

from stillray.arrays.strips import Strips, available_threads
from stillray.frame import Frame
from stillray.stages import features as encode
from stillray_training.peers.sequence import (
    Buffers,
    SequenceOptions,
    blend,
    bring,
    prepare,
    with_frames,
)
from stillray_training.peers.taa import antialias, to_picture, to_radiance

# h of eq. 1: the cubic B-spline, along each axis
KERNEL = (1 / 16, 1 / 4, 3 / 8, 1 / 4, 1 / 16)
# share of a pixel's depth that neighbours may differ by where the surface faces the camera; the
# paper's epsilon is absolute, our depth comes in any unit
DEPTH_EPSILON = 1e-3
LUMINANCE_EPSILON = 1e-10  # irradiance: keeps 0/0 out where variance is 0 (eq. 5)
_VARIANCE_REACH = 3  # pixels: windows of 7x7
_SUM = np.ones((1, 3), np.float32)
# unit of depth: where nothing was hit, all that was hit is far away; yet the largest depth over it
# is a float32
_NO_DEPTH = np.float32(1e-18)


@dataclass(frozen=True, kw_only=True)
class SvgfOptions:
    """Parameters as published; the share of the antialiasing pass is Koskela et al.'s."""

    color_share: float = 0.2  # of the current frame in irradiance at least, (0, 1]
    moments_share: float = 0.2  # of the current frame in moments at least, (0, 1]
    depth_sigma: float = 1.0  # of eq. 3, > 0
    normal_power: float = 128.0  # of eq. 4, >= 0
    luminance_sigma: float = 4.0  # of eq. 5, > 0
    iterations: int = 5  # wavelet passes, 1 or more
    trusted_frames: float = 4.0  # fewer frames: variance is estimated in space
    antialias_share: float = 0.2  # of the new picture, (0, 1]
    sequence: SequenceOptions = field(default_factory=SequenceOptions)


@dataclass(frozen=True, kw_only=True, eq=False)
class Edges:
    """What the edge-stopping functions know of a frame.

    Attributes
    ----------
    normal : (h, w, 3) float32
        Unit normals; where nothing was hit or known, one and the same.
    depth : (h, w) float32
        0 where nothing was hit.
    slope_x, slope_y : (h, w) float32
        Change of depth from a pixel to the next.
    """

    normal: np.ndarray
    depth: np.ndarray
    slope_x: np.ndarray
    slope_y: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class SvgfHistory:
    """What is remembered of the past."""

    buffers: Buffers
    color: np.ndarray  # (h, w, 4): irradiance after the first pass, and frames
    moments: np.ndarray  # (h, w, 4): first and second moment of luminance, 0, frames
    picture: np.ndarray  # (h, w, 3): the last result, tone-mapped


class Svgf:
    """A stream of frames through SVGF; holds the history between them.

    differs: the paper filters direct and indirect light apart, with noise-free features from a
    rasteriser; here there is one colour, and its features are samples of it.

    Parameters
    ----------
    options
        Defaults are the published ones.
    """

    def __init__(self, options: SvgfOptions | None = None) -> None:
        self.options = options or SvgfOptions()
        self.history: SvgfHistory | None = None
        self._strips = Strips(available_threads())

    def denoise(self, frame: Frame) -> np.ndarray:
        """Denoise the next frame; one of another size than the last starts anew.

        Returns
        -------
        (h, w, 3) float32
            Radiance, finite and >= 0.
        """
        options, history = self.options, self.history
        if history is not None and history.buffers.shape != frame.shape:
            history = None
        now = prepare(frame, history.buffers if history else None, options.sequence)
        light = encode.luminance(now.irradiance)
        first_and_second = np.stack([light, light**2], axis=-1)
        if history is None:
            past_color = past_moments = np.zeros((*now.shape, 4), np.float32)
        else:
            past_color, past_moments = (
                bring(part, history.buffers, now, options.sequence)
                for part in (history.color, history.moments)
            )
        mean, frames = blend(now.irradiance, past_color, options.color_share)
        moments, _ = blend(first_and_second, past_moments, options.moments_share)
        edges = find_edges(now)
        variance = estimate_variance(moments, frames, edges, options, self._strips)
        remembered = mean
        for level in range(options.iterations):
            mean, variance = wavelet_pass(mean, variance, edges, 1 << level, options, self._strips)
            if level == 0:  # section 4.3: the next frame's history
                remembered = mean
        new_picture = to_picture(mean * now.demodulation_albedo, now.exposure)
        picture = antialias(
            new_picture, history.picture if history else None, now.motion, options.antialias_share
        )
        self.history = SvgfHistory(
            buffers=now,
            color=with_frames(remembered, frames),
            moments=with_frames(moments, frames),
            picture=picture,
        )
        return to_radiance(picture, now.exposure)


def find_edges(buffers: Buffers) -> Edges:
    """Normals, depth and its slope.

    differs: the paper takes the rasteriser's derivative of depth (eq. 3). Ours comes from samples
    at random places of their pixels, so a single difference is noise: the slope is the median of
    the nine one-sided differences around, which a straight edge does not move.
    """
    depth = buffers.depth
    if depth is None:  # what was hit lies at 1
        depth = (buffers.surface_guides[..., 3] >= 0).astype(np.float32)
    ahead_x = np.diff(depth, axis=1, append=depth[:, -1:])
    ahead_y = np.diff(depth, axis=0, append=depth[-1:])
    return Edges(
        normal=np.ascontiguousarray(buffers.surface_guides[..., :3]),
        depth=depth,
        slope_x=cv2.medianBlur(ahead_x, 3),
        slope_y=cv2.medianBlur(ahead_y, 3),
    )


def estimate_variance(
    moments: np.ndarray,
    frames: np.ndarray,
    edges: Edges,
    options: SvgfOptions,
    strips: Strips,
) -> np.ndarray:
    """Variance of luminance: over time, or over 7x7 pixels where history is short (section 4.2).

    Parameters
    ----------
    moments : (h, w, 2) float32
        Accumulated first and second moment of luminance.
    frames : (h, w) float32
        Frames that they hold.

    Returns
    -------
    (h, w) float32
        >= 0.
    """
    variance = np.maximum(moments[..., 1] - moments[..., 0] ** 2, 0)
    short = frames < options.trusted_frames
    if not short.any():
        return variance
    height, width = frames.shape
    reach = range(-_VARIANCE_REACH, _VARIANCE_REACH + 1)
    planes = np.ascontiguousarray(moments.transpose(2, 0, 1))
    spatial = np.empty_like(variance)

    def work(rows: slice) -> None:
        total = np.zeros((2, rows.stop - rows.start, width), np.float32)
        weight_sum = np.zeros(total.shape[1:], np.float32)
        for tap in _taps(rows, (height, width), product(reach, reach)):
            weight = _geometry_weight(edges, tap, options)
            total[:, *tap.out] += weight * planes[:, *tap.there]
            weight_sum[tap.out] += weight
        first, second = total / weight_sum  # the centre weighs 1
        spatial[rows] = np.maximum(second - first**2, 0)

    strips.run(work, height, width)
    return np.where(short, spatial, variance)


def wavelet_pass(
    irradiance: np.ndarray,
    variance: np.ndarray,
    edges: Edges,
    step: int,
    options: SvgfOptions,
    strips: Strips,
) -> tuple[np.ndarray, np.ndarray]:
    """One pass of the edge-avoiding wavelet filter: eq. 1 for irradiance, eq. 2 for variance.

    Taps outside of the image do not count.

    Parameters
    ----------
    irradiance : (h, w, 3) float32
    variance : (h, w) float32
        Of its luminance, >= 0.
    step
        Pixels between taps: 1, 2, 4, ...

    Returns
    -------
    irradiance : (h, w, 3) float32
    variance : (h, w) float32
    """
    height, width = variance.shape
    light = encode.luminance(irradiance)
    # eq. 5 steers by the standard deviation of a 3x3 Gaussian mean of variance
    steady = cv2.GaussianBlur(variance, (3, 3), 0, borderType=cv2.BORDER_REPLICATE)
    scale = np.float32(options.luminance_sigma) * np.sqrt(np.maximum(steady, 0))
    per_luminance = 1 / (scale + np.float32(LUMINANCE_EPSILON))
    planes = np.ascontiguousarray(irradiance.transpose(2, 0, 1))
    kernel = {
        (tap_y * step, tap_x * step): h_y * h_x
        for tap_y, h_y in enumerate(KERNEL, -2)
        for tap_x, h_x in enumerate(KERNEL, -2)
    }
    result, result_variance = np.empty_like(irradiance), np.empty_like(variance)

    def work(rows: slice) -> None:
        total = np.zeros((3, rows.stop - rows.start, width), np.float32)
        variance_total = np.zeros(total.shape[1:], np.float32)
        weight_sum = np.zeros(total.shape[1:], np.float32)
        for tap in _taps(rows, (height, width), kernel):
            apart = np.abs(light[tap.here] - light[tap.there]) * per_luminance[tap.here]
            weight = _geometry_weight(edges, tap, options, apart)
            weight *= np.float32(kernel[tap.dy, tap.dx])
            total[:, *tap.out] += weight * planes[:, *tap.there]
            weight_sum[tap.out] += weight
            variance_total[tap.out] += weight**2 * variance[tap.there]
        # the centre's weight is h(0)^2 at least: no division by zero
        result[rows] = (total / weight_sum).transpose(1, 2, 0)
        result_variance[rows] = variance_total / weight_sum**2

    strips.run(work, height, width)
    return result, result_variance


def _geometry_weight(
    edges: Edges, tap: _Tap, options: SvgfOptions, exponent: np.ndarray | float = 0.0
) -> np.ndarray:
    """``w_z w_n`` of eq. 3 and 4 times ``exp(-exponent)``, for one offset."""
    depth = edges.depth[tap.here]
    if tap.dy == 0 and tap.dx == 0:  # a normal that is not quite a unit one agrees with itself
        return np.ones(depth.shape, np.float32)
    expected = np.abs(
        edges.slope_x[tap.here] * np.float32(tap.dx) + edges.slope_y[tap.here] * np.float32(tap.dy)
    )
    expected *= np.float32(options.depth_sigma)
    expected += np.float32(DEPTH_EPSILON) * depth + _NO_DEPTH
    apart = np.abs(depth - edges.depth[tap.there]) / expected + exponent
    weight = cv2.exp(np.negative(apart, out=apart))
    cosine = cv2.transform(edges.normal[tap.here] * edges.normal[tap.there], _SUM)
    weight *= cv2.pow(np.clip(cosine, 0, 1), options.normal_power)
    return weight


@dataclass(frozen=True, kw_only=True)
class _Tap:
    """One offset of a window: the pixels whose neighbour at it lies in the image."""

    dy: int
    dx: int
    here: tuple[slice, slice]  # those pixels
    there: tuple[slice, slice]  # their neighbours
    out: tuple[slice, slice]  # those pixels, counted from the first of the strip's rows


def _taps(
    rows: slice, shape: tuple[int, int], offsets: Iterable[tuple[int, int]]
) -> Iterator[_Tap]:
    height, width = shape
    for dy, dx in offsets:
        top, bottom = max(rows.start, -dy), min(rows.stop, height - dy)
        left, right = max(0, -dx), min(width, width - dx)
        if top < bottom and left < right:
            yield _Tap(
                dy=dy,
                dx=dx,
                here=(slice(top, bottom), slice(left, right)),
                there=(slice(top + dy, bottom + dy), slice(left + dx, right + dx)),
                out=(slice(top - rows.start, bottom - rows.start), slice(left, right)),
            )
