"""A stream of frames through direct kernel prediction: a user's way of a frame, other kernels."""

from __future__ import annotations

from stillray.families.temporal_kernels import TemporalKernels
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray_training.peers.fused_prediction import FusedPredictionModel
from stillray_training.peers.kernel_prediction import PredictedKernelsModel
from stillray_training.peers.multi_resolution_prediction import MultiResolutionPredictedModel


def _of_one_resolution(spec: ModelSpec) -> TemporalKernels:
    """The peer with one kernel a pixel, or with several that are fused."""
    several = len(spec.decoder.fused_sizes) > 1
    return FusedPredictionModel(spec) if several else PredictedKernelsModel(spec)


class KernelPredictor(Denoiser):
    """`stillray.Denoiser` of a network that gives a channel a kernel weight.

    Its file holds the specification of the shared-weight model that the peer stands beside, which
    is why such a file must not be given to `stillray.Denoiser`.
    """

    #: By the family of the model that the peer stands beside.
    families = {  # noqa: RUF012  read only
        "weight-sharing-kernels": _of_one_resolution,
        "multi-resolution-kernels": MultiResolutionPredictedModel,
    }
