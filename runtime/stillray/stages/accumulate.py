"""Accumulation over time that neither smears fireflies nor forgets how much a pixel knows."""

from __future__ import annotations

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.workspace import Workspace
from stillray.model_spec.stages import Temporal, Transfer
from stillray.stages.features import local_luminance, luminance, tone_map

#: Exposed irradiance below which surroundings no longer count as darker.
DARK = 0.02
#: Share of ``outlier_ratio`` that a pixel's first sample may stand above its surroundings.
FIRST_SHARE = 0.25
#: Smallest weight of a sample: what would weigh less is made darker instead, see `clamp_fireflies`.
MIN_WEIGHT = 0.1
#: Weight of what was filled in from neighbours: better than nothing, and than nothing else.
FILLED_WEIGHT = 1e-6
USUAL_PAST = 15.0  # samples held, of which `bounded` measures a sample
_HUGE = np.float32(1e37)  # relative brightness that float32 still holds, with its reciprocal
# Up to it a luminance of 1e31, over `DARK`, stays below `_HUGE`; frames of normal exposure do.
_SAFE_SCALE = 1e4


def sample_weight(
    luminance: np.ndarray,
    local: np.ndarray,
    held: np.ndarray | None,
    exposure: float,
    options: Temporal,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """The weight of a new sample, in (0, 1]: less, the further it stands above what is usual.

    A sample of luminance ``L`` weighs ``1 / (1 + x^2 / (1 + x))`` with ``x = L / u``, where ``u =
    outlier_ratio / 4 (1 + n) (s + s0)``, ``s`` is the local radiance and ``n`` the samples that
    the pixel holds. For ``x`` well below 1 that is 1, so that ordinary noise is averaged plainly
    and keeps its energy. The product with ``L`` stays below ``u``: one firefly moves a mean of any
    number of samples by about ``outlier_ratio / 4`` times its surroundings at most, and the
    pixel's sample count says that little is known there. What a bright sample is denied in a new
    pixel it is given in one with a past, where it does less harm: where few samples carry the
    light, the mean comes to it as samples grow.

    differs: Fan et al. 2021 average plainly (section 4.1), which smears fireflies over the frames
    that follow. Figures of other weights: docs/decisions.md.

    Parameters
    ----------
    luminance : (h, w) float32
        Irradiance luminance, >= 0.
    local : (h, w) float32
        Tone-mapped local luminance ``t = s e / (1 + s e)`` in [0, 1), see
        `stillray.stages.features.local_luminance`.
    held : (h, w) float32 or None
        Samples of the past at these pixels, >= 0, at most ``max_samples + 1`` as `accumulate`
        leaves them; None where there is no past.
    exposure
        ``e``, 1 / irradiance.
    options
        The outlier ratio.
    workspace
        Where the result and what leads to it lie, if given.

    Returns
    -------
    (h, w) float32
        Not bounded from below, see `clamp_fireflies`.
    """
    workspace = workspace or Workspace()
    # in exposed units: s e = t / (1 - t); DARK is a small share of the frame's typical value
    usual = workspace.array("usual", local.shape)
    weight = workspace.array("weight", local.shape)
    cv2.threshold(local, 0.9999, 0, cv2.THRESH_TRUNC, dst=usual)  # a third of np.minimum's time
    usual /= np.subtract(1, usual, out=weight)
    usual += np.float32(DARK)
    if held is not None:
        usual *= np.add(held, 1, out=weight)
    # x, then x / (1 + x) in place of usual: no square, which would leave float32
    np.divide(luminance, usual, out=weight)
    scale = np.float32(exposure / (FIRST_SHARE * options.outlier_ratio))
    with np.errstate(over="ignore"):
        weight *= scale
    if scale > _SAFE_SCALE:
        at_most(weight, _HUGE, out=weight)
    np.add(weight, 1, out=usual)
    np.divide(weight, usual, out=usual)
    weight *= usual
    weight += 1
    return np.reciprocal(weight, out=weight)


def bounded(
    radiance: np.ndarray, exposure: float, transfer: Transfer, options: Temporal
) -> np.ndarray:
    """Radiance in which no sample stands far above its surroundings.

    For models that average what a frame shows, not what a past and a weight make of it: a sample
    is multiplied by the `sample_weight` that it would have beside a past of `USUAL_PAST` samples,
    so that one of 25 times its surroundings keeps 99 % of its light, and none shows more than 256
    times as much, with an ``outlier_ratio`` of 64.

    Parameters
    ----------
    radiance : (h, w, 3) float32
        Finite, >= 0; not changed.
    exposure
        1 / radiance.
    transfer
        How large surroundings are.
    options
        The outlier ratio.

    Returns
    -------
    (h, w, 3) float32
    """
    light = luminance(radiance)
    local = local_luminance(tone_map(light, exposure), transfer)
    held = np.full_like(light, USUAL_PAST)
    return radiance * sample_weight(light, local, held, exposure, options)[..., None]


def clamp_fireflies(irradiance: np.ndarray, weight: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Raise weights to `MIN_WEIGHT`, and make those samples darker in turn.

    A weight of next to nothing does not bound what a sample does where nothing else is known: in a
    new pixel, or where a network takes pixels by what they show and not by what they weigh.
    So a sample counts as at most ``outlier_ratio / 4 (1 + n) / MIN_WEIGHT`` times its surroundings:
    160 times in a new pixel, 2,700 times where 16 samples are held. Other smallest weights:
    docs/decisions.md.

    Parameters
    ----------
    irradiance : (h, w, 3) float32
        Samples.
    weight : (h, w) float32
        Changed where it is below.
    out : (h, w, 3) float32
        Where the result lies if a weight was below; may be ``irradiance``, which is not changed
        otherwise.

    Returns
    -------
    (h, w, 3) float32
        ``irradiance``, itself where no weight was below; products with weights are kept.
    """
    if weight.min() >= MIN_WEIGHT:
        return irradiance
    if out is not irradiance:
        np.copyto(out, irradiance)
    # fireflies are few: a list of them is faster than masks
    low = np.flatnonzero(weight < MIN_WEIGHT)
    out.reshape(-1, 3)[low] *= weight.reshape(-1)[low, None] / np.float32(MIN_WEIGHT)
    weight.reshape(-1)[low] = MIN_WEIGHT
    return out


def accumulate(
    new: np.ndarray,
    weight: np.ndarray,
    planes: np.ndarray,
    options: Temporal,
    workspace: Workspace | None = None,
) -> None:
    """Running weighted mean of samples.

    Parameters
    ----------
    new : (3, h, w) float32
        Irradiance of this frame's sample.
    weight : (h, w) float32
        Of each sample, in (0, 1].
    planes : (4, h, w) float32
        The past at these pixels: finite irradiance and, last, its samples, 0 where there is no
        past. Overwritten with the mean irradiance and the samples that it holds, at most
        ``max_samples + 1``.
    workspace
        Where temporaries lie, if given.
    """
    workspace = workspace or Workspace()
    samples = planes[3]
    rest = workspace.array("rest", samples.shape)
    cv2.threshold(samples, options.max_samples, 0, cv2.THRESH_TRUNC, dst=rest)
    np.add(rest, weight, out=samples)
    share = np.divide(weight, samples, out=workspace.array("share", samples.shape))
    # not 1 - share: a past that weighs little would lose its digits, and it may be very bright
    rest /= samples
    # mean + share (new - mean) cancels where a firefly meets a dark past; two products do not
    planes[:3] *= rest
    for mean, sample in zip(planes[:3], new, strict=True):
        cv2.accumulateProduct(sample, share, mean)
