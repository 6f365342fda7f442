"""Direct kernel prediction, the learned peer "KP" of Fan et al. 2021, section 6.1.

Six RepVGG blocks give every pixel its own 13x13 kernel, a channel a weight (Bako et al. 2017);
ours give six importance maps, whose kernels neighbours share. Input, accumulation, demodulation and
loss are the same, so that the two differ in nothing but the kernels.

`FAMILY` takes the specification of a model of ours with one kernel size and trains and runs it in
this way instead. It is not among the families that specifications name: no user's model is one.
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.arrays.strips import Strips, interleave, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.box_filter import bounded_exp
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FusedKernels
from stillray.model_spec.networks import ImportanceNetwork
from stillray.stages.state import Filterable
from stillray.timing import timed
from stillray_training.families import BoxFilter, Family
from stillray_training.networks.repvgg import RepVGGBlock


@dataclass(frozen=True, kw_only=True)
class PredictedKernels:
    """The reconstruction; defaults are the paper's six-layer variant."""

    kernel_size: int = 13  # pixels, odd: filter kernels
    logit_bound: float = 12.0  # logits are clipped to +- this, (0, 40]
    weigh_samples: bool = True  # multiply weights by the samples that a pixel holds


@dataclass(frozen=True, kw_only=True)
class KernelPrediction(PredictedKernels):
    """The network and its reconstruction; defaults are the paper's six-layer variant."""

    widths: tuple[int, ...] = (16,) * 5  # output channels of every block but the last
    branches: tuple[int, ...] = (5, 3, 1)  # pixels, odd: convolutions trained side by side
    identity: bool = True  # an identity branch where input and output widths agree


class KernelPredictionNet(nn.Module):
    """A chain of RepVGG blocks; the last has no ReLU, since logits may be negative.

    Parameters
    ----------
    features
        Input planes.
    options
        Widths and branches.
    outputs
        Planes that it gives; None for a plane a weight of the kernel.
    """

    def __init__(
        self, features: int, options: KernelPrediction, outputs: int | None = None
    ) -> None:
        super().__init__()
        widths = (features, *options.widths, outputs or options.kernel_size**2)
        last = len(widths) - 2
        self.blocks = nn.Sequential(
            *(
                RepVGGBlock(
                    widths[index],
                    widths[index + 1],
                    options.branches,
                    identity=options.identity,
                    activation=index != last,
                )
                for index in range(len(widths) - 1)
            )
        )

    def forward(self, features_nchw: Tensor) -> Tensor:
        """``(n, features, h, w)`` to ``(n, outputs, h, w)``: logits of each pixel's kernel."""
        logits: Tensor = self.blocks(features_nchw)
        return logits


def predicted_kernels(
    irradiance_nchw: Tensor, samples_nchw: Tensor, logits_nchw: Tensor, options: PredictedKernels
) -> Tensor:
    """Filter every pixel with its own kernel: softmax of its logits (Bako et al. 2017).

    differs: logits are bounded and weights multiplied by samples, as our own kernels have it.

    Parameters
    ----------
    irradiance_nchw : (n, 3, h, w)
    samples_nchw : (n, 1, h, w)
        Samples that each pixel holds, > 0.
    logits_nchw : (n, k k, h, w)
        Row by row from the top left of the window. Pixels outside of the image do not count.

    Returns
    -------
    (n, 3, h, w)
        Differentiable in all arguments.
    """
    here = samples_nchw if options.weigh_samples else torch.ones_like(samples_nchw)
    # zero samples outside: those taps vanish from both sums
    planes = F.pad(torch.cat([irradiance_nchw * here, here], dim=1), [options.kernel_size // 2] * 4)
    bounded = logits_nchw.contiguous().clamp(-options.logit_bound, options.logit_bound)
    sums = _WindowSums.apply(planes, bounded.softmax(dim=1), options.kernel_size)
    return sums[:, :3] / sums[:, 3:]


class _WindowSums(torch.autograd.Function):
    """Weighted sums of k x k windows, a tap at a time: unfolded, a batch takes k k times as much.

    From ``(n, c, h + k - 1, w + k - 1)`` and weights ``(n, k k, h, w)`` to ``(n, c, h, w)``.
    """

    @staticmethod
    def forward(ctx: Any, planes: Tensor, weights: Tensor, size: int) -> Tensor:
        ctx.save_for_backward(planes, weights)
        ctx.size = size
        height, width = weights.shape[2:]
        total = planes.new_zeros(*planes.shape[:2], height, width)
        for index, rows, columns in _windows(size, height, width):
            total.addcmul_(weights[:, index : index + 1], planes[:, :, rows, columns])
        return total

    @staticmethod
    def backward(ctx: Any, *gradients: Any) -> tuple[Tensor | None, Tensor, None]:
        (given,) = gradients
        planes, weights = ctx.saved_tensors
        to_planes = torch.zeros_like(planes) if ctx.needs_input_grad[0] else None
        to_weights = torch.empty_like(weights)
        for index, rows, columns in _windows(ctx.size, *weights.shape[2:]):
            torch.sum(given * planes[:, :, rows, columns], dim=1, out=to_weights[:, index])
            if to_planes is not None:
                to_planes[:, :, rows, columns].addcmul_(weights[:, index : index + 1], given)
        return to_planes, to_weights, None


def _windows(size: int, height: int, width: int) -> Iterator[tuple[int, slice, slice]]:
    for index in range(size**2):
        dy, dx = divmod(index, size)
        yield index, slice(dy, dy + height), slice(dx, dx + width)


def filter_rows(
    mean: np.ndarray,
    logits: np.ndarray,
    inner: slice,
    options: PredictedKernels,
    workspace: Workspace | None = None,
) -> np.ndarray:
    """The twin of `predicted_kernels` without PyTorch, for timing beside
    `stillray.families.box_filter`.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Irradiance, >= 0 and finite, and samples, > 0: an image, or a strip with its neighbouring
        rows, ``kernel_size // 2`` of them where the image goes on.
    logits : (k k, h, w) float32
        Any values; NaN says nothing.
    inner
        The rows of the result.
    workspace
        Where temporaries lie, if given.

    Returns
    -------
    (rows, w, 3) float32
        In the range of each window's irradiance.
    """
    workspace = workspace or Workspace()
    planes = filter_planes(mean, logits, inner, options, workspace)
    if np.isnan(planes.max()):
        planes = filter_planes(mean, np.nan_to_num(logits, nan=0.0), inner, options, workspace)
    return interleave(planes, out=np.empty((*planes.shape[1:], 3), np.float32))


def filter_planes(
    mean: np.ndarray,
    logits: np.ndarray,
    inner: slice,
    options: PredictedKernels,
    workspace: Workspace,
) -> np.ndarray:
    """`filter_rows` as planes ``(3, rows, w)``, in the workspace; without a look for NaN logits.

    Logits beyond those of the kernel are not looked at.
    """
    size, half = options.kernel_size, options.kernel_size // 2
    padded = cv2.copyMakeBorder(mean, half, half, half, half, cv2.BORDER_CONSTANT)
    planes = planes_of(padded, out=workspace.array("mean", (4, *padded.shape[:2])))
    *colors, samples = planes
    if not options.weigh_samples:
        samples = (samples > 0).astype(np.float32)
    shape = inner.stop - inner.start, mean.shape[1]
    total, weight_sum = workspace.array("total", (3, *shape)), workspace.array("weight_sum", shape)
    weight = workspace.array("weight", shape)
    total.fill(0)
    weight_sum.fill(0)
    # the mean of a window instead of its sum: large radiance stays finite
    share = np.float32(1 / size**2)
    for index in range(size**2):
        dy, dx = divmod(index, size)
        tap = (slice(inner.start + dy, inner.stop + dy), slice(dx, dx + shape[1]))
        bounded_exp(logits[index, inner], options.logit_bound, weight)
        weight *= samples[tap]
        weight *= share
        weight_sum += weight
        for plane, sums in zip(colors, total, strict=True):
            cv2.accumulateProduct(weight, plane[tap], sums)
    total /= weight_sum
    return total


class KernelsOfPixels(TemporalKernels):
    """Peers as `stillray.Denoiser` runs them: accumulation and features are those of a model."""

    @abstractmethod
    def filter(
        self, mean: np.ndarray, logits: np.ndarray, inner: slice, workspace: Workspace
    ) -> np.ndarray:
        """The peer's `filter_rows`."""

    def reconstruct(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """Filter and remodulate, see `TemporalKernels`."""
        (logits,) = outputs
        mean = light.mean
        height, width = mean.shape[:2]
        image = np.empty((height, width, 3), np.float32)

        def work(rows: slice) -> None:
            near, own = with_halo(rows, self.looks.reach, height)
            image[rows] = self.filter(mean[near], logits[:, near], own, strips.workspace)

        with timed(timings, "reconstruct"):
            strips.run(work, height, width)
        if light.remodulation_albedo is not None:
            with timed(timings, "remodulate"):
                image *= light.remodulation_albedo
        return image


class PredictedKernelsModel(KernelsOfPixels):
    """The peer with one kernel a pixel."""

    def __init__(self, spec: ModelSpec) -> None:
        self._options = options_of(spec)
        size = self._options.kernel_size
        self.method = f"a {size} x {size} kernel a pixel"
        # an exponential, a weight, its sum and three channels; a logit a tap, light and image
        self.cost = (size**2 * (1.0 + 2 + 1 + 3 * 2) + 3, size**2 + 4.0 + 3.0)
        super().__init__(spec, Looks(reach=size // 2, receptive_field=None))

    def filter(
        self, mean: np.ndarray, logits: np.ndarray, inner: slice, workspace: Workspace
    ) -> np.ndarray:
        """See `KernelsOfPixels`."""
        return filter_rows(mean, logits, inner, self._options, workspace)


def options_of(spec: ModelSpec, size: int | None = None) -> KernelPrediction:
    """The peer of a model with one kernel size: the same network up to its last block.

    Parameters
    ----------
    spec
        The model's.
    size
        Of a kernel, pixels, for a model that has several; None for the one that it has.
    """
    network, decoder = spec.network, spec.decoder
    assert isinstance(network, ImportanceNetwork)
    assert isinstance(decoder, FusedKernels)
    if size is not None:
        decoder = decoder.with_kernels((size,))
    return KernelPrediction(
        **dataclasses.asdict(kernels_of(decoder)),
        widths=network.widths,
        branches=network.branches,
        identity=network.identity,
    )


def kernels_of(decoder: FusedKernels) -> PredictedKernels:
    """Kernels predicted in the place of shared-weight ones of one size."""
    (kernel_size,) = decoder.kernel_sizes
    return PredictedKernels(
        kernel_size=kernel_size,
        logit_bound=decoder.logit_bound,
        weigh_samples=decoder.weigh_samples,
    )


def _network(spec: ModelSpec) -> nn.Module:
    return KernelPredictionNet(len(spec.network.features), options_of(spec))


def _decode(logits: Tensor, batch: Mapping[str, Tensor], spec: ModelSpec, box: BoxFilter) -> Tensor:
    return predicted_kernels(batch["irradiance"], batch["samples"], logits, options_of(spec))


#: For training, as `stillray_training.families.FAMILIES` has them.
FAMILY = Family(_network, _decode, inputs=("irradiance", "samples"), modulates=False)
