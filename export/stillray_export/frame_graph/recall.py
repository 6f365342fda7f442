"""The previous output: the twin of `stillray.stages.previous_output` and of `recall` there."""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor

from stillray.model_spec.decoders import PyramidKernels
from stillray.stages import recall as stage
from stillray_export.frame_graph.accumulation import SampleCounts
from stillray_export.frame_graph.lookup import cubic_taps, linear_taps, mean_of, planes_like
from stillray_export.frame_graph.windows import enlarged, least_around, mean_around, most_around
from stillray_training.decoders.luminance import luminance

_LEAST_VALID, _WHOLE = 1e-3, 1 - 1e-3
_DARK, _MOST = 1e-30, 4096.0
_STEEP = 2.0


def recall(output_nhwc: Tensor, places: Tensor, *, sharp: bool) -> tuple[Tensor, Tensor]:
    """Radiance ``(1, 3, h, w)`` and how much of it lay in the frame ``(1, 1, h, w)``.

    Parameters
    ----------
    output_nhwc : (h, w, 3)
        The last output.
    places : (1, 2, h, w)
        Where the pixels' picture was, x and y in pixels.
    sharp
        See `stillray.stages.previous_output.recall`.
    """
    pixels = output_nhwc.flatten(0, 1)
    taps = linear_taps(places, places)
    valid = sum(tap.weight * tap.inside for tap in taps)
    assert isinstance(valid, Tensor)
    taken = mean_of(taps, pixels, zeros=True)
    taken = taken / torch.where(valid < _WHOLE, valid.clamp(min=_LEAST_VALID), 1.0)
    if sharp:
        factor, _ = sharpness(output_nhwc, places)
        taken = taken * torch.where(valid < _WHOLE, 1.0, factor)
    return planes_like(taken, places), planes_like(valid, places)


def sharpness(output_nhwc: Tensor, places: Tensor) -> tuple[Tensor, Tensor]:
    """What makes linear interpolation as sharp as cubic convolution, and what it is among.

    Parameters
    ----------
    output_nhwc : (h, w, 3)
        The last output.
    places : (1, 2, h, w)
        Where it is looked at, x and y in pixels.

    Returns
    -------
    factor : (h w, 1)
        See `stillray.stages.sharpening.Sharpening.factor`.
    contrast : (h w, 1)
        The brightest of the four pixels around over the darkest.
    """
    light = luminance(output_nhwc.permute(2, 0, 1)[None]).flatten()[:, None]
    taps = linear_taps(places, places)
    four = [tap.of(light) for tap in taps]
    most = torch.maximum(torch.maximum(four[0], four[1]), torch.maximum(four[2], four[3]))
    least = torch.minimum(torch.minimum(four[0], four[1]), torch.minimum(four[2], four[3]))
    cubic = mean_of(cubic_taps(places, places), light, zeros=False)
    cubic = torch.minimum(torch.maximum(cubic, least), most).clamp(min=_DARK)
    linear = mean_of(taps, light, zeros=False)
    factor = (cubic / linear.clamp(min=_DARK)).clamp(max=_MOST)
    return factor, most / least.clamp(min=_DARK)


def near_edges(output_nhwc: Tensor, places: Tensor, contrast: float) -> Tensor:
    """1 where an output's edges are, see `stillray.stages.reproject.Edges.near`.

    Parameters
    ----------
    output_nhwc : (h, w, 3)
        The last output.
    places : (1, 2, h, w)
        Where it is looked at, x and y in pixels.
    contrast
        Of an edge: how many times the darkest of four pixels the brightest is.

    Returns
    -------
    (h w, 1)
    """
    light = luminance(output_nhwc.permute(2, 0, 1)[None])
    # the last row and column once more
    light = torch.cat([light, light[:, :, -1:]], 2)
    light = torch.cat([light, light[..., -1:]], 3)
    most, least = F.max_pool2d(light, 2, 1), -F.max_pool2d(-light, 2, 1)
    near = most_around((most > contrast * least).to(torch.float32))
    corner = linear_taps(places, places)[0]
    return corner.of(near.flatten()[:, None]) * corner.inside


def forget_uncovered(
    past: Tensor, valid: Tensor, disoccluded: Tensor, confidence: Tensor
) -> tuple[Tensor, Tensor]:
    """Without what the frame has just uncovered, see `stages.previous_output.forget_uncovered`.

    Parameters
    ----------
    past : (1, 3, h, w)
    valid, disoccluded, confidence : (1, 1, h, w)
        ``disoccluded`` is 1 where a pixel had no past, else 0.
    """
    opened = most_around(least_around(disoccluded))
    trusted = (_STEEP * confidence + (1 - _STEEP)).clamp(0, 1)
    kept = (trusted > 0).to(torch.float32) * (1 - opened)
    return past * kept, valid * trusted * kept


def recalled_share(
    lights: tuple[Tensor, Tensor],
    worth: Tensor,
    valid: Tensor,
    exposure: Tensor,
    counts: SampleCounts,
    options: PyramidKernels,
) -> tuple[Tensor, Tensor]:
    """What is taken of the past, see `stillray.stages.recall.Recall.share`.

    Parameters
    ----------
    lights : (1, 3, h, w) each
        Radiance of the last output and of this frame.
    worth : (1, 1, h, w)
        What this frame's samples weigh.
    valid : (1, 1, h, w)
        How much of the last output is.
    exposure
        1 / radiance, a scalar.
    counts
        The frame's samples.
    options
        ``recall_power`` and ``recall_noise``.

    Returns
    -------
    agreed, output : (1, 1, h, w)
        Of `stillray.stages.recall.Recalled`.
    """
    height, width = valid.shape[2:]
    last, own = (
        (light * exposure).clamp(max=float(stage._BRIGHTEST)) + stage.DARK for light in lights
    )
    apart = (last / own).log().abs().mean(1, keepdim=True)
    noise = _noise(apart, valid)
    reach = enlarged(noise + stage.TAIL * noise.square(), stage.BLOCK, height, width)
    beyond = (apart / reach - options.recall_noise).clamp(min=0).square()
    agreed = 1 - worth.clamp(max=1) * (1 - 1 / (1 + beyond))
    if not options.recall_power:
        return agreed, agreed
    quiet = (noise / stage.USUAL_NOISE).clamp(max=1)
    by_noise = enlarged(quiet, stage.BLOCK, height, width)
    told = counts.past_weight(options.recall_power)
    return agreed, agreed * torch.where(counts.mean > 0, told, by_noise)


def believed(mean: Tensor, total: Tensor, sample: Tensor, agreed: Tensor) -> tuple[Tensor, Tensor]:
    """What was accumulated, as far as it is believed, see `stillray.stages.recall.believed`.

    Parameters
    ----------
    mean, total : (1, 3, h, w), (1, 1, h, w)
        Light, and the samples that pixels hold.
    sample : (1, 4, h, w)
        This frame's light, and what its samples weigh.
    agreed : (1, 1, h, w)
        See `recalled_share`.
    """
    kept, gained = agreed * total, (1 - agreed) * sample[:, 3:]
    left = kept + gained
    return kept / left * mean + gained / left * sample[:, :3], left


def _noise(apart: Tensor, valid: Tensor) -> Tensor:
    """The noise of blocks, ``(1, 1, rows, columns)``, of what pixels differ by."""
    block = stage.BLOCK
    height, width = valid.shape[2:]
    told = ((apart > stage.LEAST_APART) & (valid > 0)).to(torch.float32)
    said = told * apart.clamp(min=stage.LEAST_APART).log()
    planes = F.pad(torch.cat([told, said], 1), (0, -width % block, 0, -height % block))
    sums = F.avg_pool2d(planes, block)
    counted, total = sums.sum((2, 3)).split(1, 1)
    least = math.log(stage.LEAST_APART)
    usual = torch.where(counted > 0, total / counted.clamp(min=1e-30), least)[..., None, None]
    inside, around = mean_around(sums, 3).split(1, 1)
    local = (around + stage.LITTLE_TOLD * usual) / (inside + stage.LITTLE_TOLD)
    return torch.maximum(local, usual).exp()
