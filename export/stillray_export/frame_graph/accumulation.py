"""What a sample is worth, and its addition to the past: the twin of `stages.accumulate`."""

from __future__ import annotations

import torch
from torch import Tensor

from stillray.model_spec.stages import Temporal
from stillray.stages.accumulate import DARK, FIRST_SHARE, MIN_WEIGHT
from stillray.stages.sample_counts import FEW_SAMPLES, LEAST_SHARE, MOST_SCALE

_HUGE = 1e37


def sample_weight(
    luminance: Tensor, local: Tensor, held: Tensor, exposure: Tensor, options: Temporal
) -> Tensor:
    """What a new sample is worth, in (0, 1], see `stillray.stages.accumulate.sample_weight`."""
    usual = local.clamp(max=0.9999)
    usual = (usual / (1 - usual) + DARK) * (held + 1)
    above = luminance / usual * (exposure / (FIRST_SHARE * options.outlier_ratio))
    above = above.clamp(max=_HUGE)
    return 1 / (1 + above * (above / (1 + above)))


def bound(irradiance_nchw: Tensor, weight: Tensor) -> tuple[Tensor, Tensor]:
    """Weights of `MIN_WEIGHT` at least, and samples so much darker in turn."""
    return irradiance_nchw * (weight.clamp(max=MIN_WEIGHT) / MIN_WEIGHT), weight.clamp(
        min=MIN_WEIGHT
    )


def accumulate(
    new_nchw: Tensor, weight: Tensor, past_nchw: Tensor, held: Tensor, options: Temporal
) -> tuple[Tensor, Tensor]:
    """Running weighted mean: irradiance ``(1, 3, h, w)`` and the samples that it holds."""
    rest = held.clamp(max=options.max_samples)
    samples = rest + weight
    return past_nchw * (rest / samples) + new_nchw * (weight / samples), samples


class SampleCounts:
    """The samples of one frame, see `stillray.stages.sample_counts.SampleCounts`.

    Parameters
    ----------
    samples : (1, 1, h, w)
        0 or more; what is less, or not a number, is not said.
    before
        The mean of the frame before, a scalar; 0 if it is not known.

    Attributes
    ----------
    empty : (1, 1, h, w)
        1 where a pixel has no samples.
    mean
        Scalar; 0 where nobody said.
    share : (1, 1, h, w)
    past_scale, told
        Scalars.
    """

    def __init__(self, samples: Tensor, before: Tensor) -> None:
        sampled = samples > 0
        self.empty = (samples == 0).to(torch.float32)
        some = sampled.to(torch.float32).mean()
        mean = torch.where(sampled, samples, 0.0).mean() / some.clamp(min=1e-30)
        self.mean = torch.where(some > 0, mean, before)
        share = torch.where(sampled, samples / self.mean.clamp(min=1e-30), 1.0)
        self.share = share.clamp(min=LEAST_SHARE)
        known = (before > 0) & (self.mean > 0)
        scale = before / self.mean.clamp(min=1e-30)
        scale = scale.clamp(1 / MOST_SCALE, MOST_SCALE)
        self.past_scale = torch.where(known, scale, 1.0)
        self.told = torch.where(self.mean > 0, self.mean, 1.0)

    def albedo_frames(self, most: float) -> Tensor:
        """Frames that an albedo's past counts as, of ``most``, a scalar."""
        return most / (self.mean / FEW_SAMPLES).clamp(min=1)

    def past_weight(self, power: float) -> Tensor:
        """What a past weighs beside each pixel's samples, ``(1, 1, h, w)``; 1 where nobody said."""
        return (self.mean * self.share / FEW_SAMPLES).clamp(min=1) ** -power
