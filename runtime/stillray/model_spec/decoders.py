"""Tables of a specification for what makes a picture of a network's outputs: one a family."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Self

from stillray.model_spec.rules import SpecError, each, odd, within

#: exp of twice the bound of logits, times a window, must stay far inside float32 (3e38).
MAX_LOGIT = 40
_MAX_KERNELS = 16
_MAX_WINDOW = 127  # pixels of a reconstruction kernel
_MAX_FILTER_FEATURES = 32
_MOST_TONE = 1000.0
_MOST_NOISE = 100.0
#: Views of a frame, of which each costs a run of the network.
MOST_ENSEMBLE = 4


class Decoder:
    """What every decoder's options answer."""

    @property
    def fused_sizes(self) -> tuple[int, ...]:
        """Sizes of the kernels that it fuses, pixels, of which some can be left out; or none."""
        return ()

    def with_kernels(self, sizes: tuple[int, ...]) -> Self:
        """The same with fused kernels of other sizes, pixels.

        Raises
        ------
        SpecError
            It fuses none, or the sizes break their rules.
        """
        raise SpecError(f"decoder must fuse kernels, got {type(self).__name__}")

    @property
    def most_ensemble(self) -> int:
        """How many pictures of mirrored frames it can average."""
        return 1

    @property
    def minds_filter(self) -> bool:
        """Whether it looks at the renderer's pixel filter."""
        return False

    def with_ensemble(self, size: int) -> Self:
        """The same as the mean of so many pictures, 1 to `most_ensemble`.

        Raises
        ------
        SpecError
            It cannot be.
        """
        within("ensemble", size, 1, self.most_ensemble)
        return self


@dataclass(frozen=True, kw_only=True)
class FusedKernels(Decoder):
    """Fused weight-sharing kernels (Fan et al. 2021, eq. 2 to 5)."""

    kernel_sizes: tuple[int, ...]  # pixels, odd, one importance map each
    logit_bound: float  # importance and fusion logits are clipped to +- this, (0, 40]
    weigh_samples: bool  # multiply importance by the samples that a pixel holds

    def __post_init__(self) -> None:
        _kernels(self.kernel_sizes)
        within("decoder.logit_bound", self.logit_bound, 1e-3, MAX_LOGIT)

    @property
    def fused_sizes(self) -> tuple[int, ...]:
        return self.kernel_sizes

    def with_kernels(self, sizes: tuple[int, ...]) -> Self:
        return dataclasses.replace(self, kernel_sizes=sizes)


@dataclass(frozen=True, kw_only=True)
class PyramidKernels(Decoder):
    """Weight-sharing kernels at several resolutions, then a resolve with the previous output."""

    kernel_sizes: tuple[int, ...]  # pixels of each level, odd, one importance map each
    finest_kernels: bool  # whether the finest level has them too, or the coarser alone
    predicted: bool  # whether pixels of the coarser levels have a weight for each neighbour, too
    logit_bound: float  # logits are clipped to +- this, (0, 40]
    sharp_recall: bool  # whether the previous output is interpolated by cubic convolution
    # Distances, in pixels, at which pixels of the finest level have a weight for each of eight
    # neighbours. Models that were exported before it was known lack it.
    finest_neighbours: tuple[int, ...] = ()
    # Distances, in pixels, of the 3x3 filters by feature distances that the finest level goes
    # through at last, one after the other, and how many features they compare.
    finest_filters: tuple[int, ...] = ()
    filter_features: int = 0
    # In those a pixel weighs 1 / (1 + tone x) of what the network says, to itself and to others,
    # x being how far its exposed luminance is above 1 before they begin: light of a window, many
    # times that, then does not reach the dark bars before it; 0: all of it.
    filter_tone: float = 0.0
    # In the resolve a neighbour brighter than the pixel weighs (1 + tone x) / (1 + tone y) of what
    # the network says, x and y being the exposed luminance of pixel and neighbour; 0: all of it.
    # Less where the renderer's pixel filter is softer than a box, up to none of it.
    resolve_tone: float = 0.0
    # Distances, in pixels, at which the albedo that the picture is multiplied by is averaged with
    # its eight neighbours, one after the other, weighed by the squares of what the resolve weighs
    # them: where the resolve is wide open, at what a lens does not show sharp, albedo is noise.
    albedo_filters: tuple[int, ...] = ()
    # In the resolve the last output weighs ``(samples / 2) ** -recall_power`` of what the network
    # says, where a frame tells that it has more than 2 samples a pixel: looks between pixels and
    # mirrors put it off, however little noise there is; [0, 1], 0: all of it.
    recall_power: float = 0.0
    # And less where it differs from the frame's sample by more than so many times the noise of the
    # frame, see `stillray.stages.recall`, which also tells samples that a frame does not tell;
    # [1, 100], or 0: neither of these rules.
    recall_noise: float = 0.0
    # Views of a frame whose pictures are averaged, 1 to 4, see `stillray.families.views`.
    ensemble: int = 1

    def __post_init__(self) -> None:
        _kernels(self.kernel_sizes)
        within("decoder.ensemble", self.ensemble, 1, MOST_ENSEMBLE)
        within("decoder.logit_bound", self.logit_bound, 1e-3, MAX_LOGIT)
        within("decoder.filter_tone", self.filter_tone, 0, _MOST_TONE)
        within("decoder.resolve_tone", self.resolve_tone, 0, _MOST_TONE)
        within("decoder.recall_power", self.recall_power, 0, 1)
        if self.recall_noise:
            within("decoder.recall_noise", self.recall_noise, 1, _MOST_NOISE)
        each("decoder.finest_neighbours", self.finest_neighbours, 1, _MAX_WINDOW // 2)
        each("decoder.finest_filters", self.finest_filters, 1, _MAX_WINDOW // 2)
        each("decoder.albedo_filters", self.albedo_filters, 1, _MAX_WINDOW // 2)
        within(
            "decoder.filter_features",
            self.filter_features,
            1 if self.finest_filters else 0,
            _MAX_FILTER_FEATURES if self.finest_filters else 0,
        )

    @property
    def most_ensemble(self) -> int:
        return MOST_ENSEMBLE

    @property
    def minds_filter(self) -> bool:
        return self.resolve_tone > 0

    def with_ensemble(self, size: int) -> Self:
        return dataclasses.replace(self, ensemble=size)


@dataclass(frozen=True, kw_only=True)
class BilateralGrids(Decoder):
    """Bilateral grids at one or several scales (Meng et al. 2020, eq. 8 to 15)."""

    grids: int  # one a scale; every scale doubles the rates
    spacing: int  # pixels from cell to cell of the finest grid, along x and y
    depth_spacing: float  # and along its guide, of which there are 255
    weigh_samples: bool  # splat a pixel by the samples that it holds

    def __post_init__(self) -> None:
        within("decoder.grids", self.grids, 1, 5)
        within("decoder.spacing", self.spacing, 1, 64)
        within("decoder.depth_spacing", self.depth_spacing, 1, 255)


@dataclass(frozen=True, kw_only=True)
class CrossBilateral(Decoder):
    """A cross-bilateral filter that is learned while it runs (Choi et al. 2024, eq. 8 to 13)."""

    learning_rate: float  # of Adam, one step a frame, [0, 0.1]

    def __post_init__(self) -> None:
        within("decoder.learning_rate", self.learning_rate, 0, 0.1)


@dataclass(frozen=True, kw_only=True)
class FeatureFilters(Decoder):
    """Gaussians of feature distances that enlarge, accumulate and denoise (Kazmierczyk et al.
    2025, section 3.4)."""

    scale: int  # pixels of the picture for one of the frame, along each axis: 1 or 2
    features: int  # of a pixel, that its filters compare with its neighbours'
    logit_bound: float  # features and logits are clipped to +- this, (0, 20]
    # Distances, in pixels of the coarsest level, of the 3x3 filters that it goes through one after
    # the other. Models that were exported before it was known have one.
    coarsest_filters: tuple[int, ...] = (1,)
    # Whether the last output is interpolated by cubic convolution. Models that were exported
    # before it was known have none of it.
    sharp_recall: bool = False
    # In the filters that denoise a pixel weighs 1 / (1 + tone x) of what the network says, x being
    # how far the exposed luminance of its light is above 1; 0: all of it.
    filter_tone: float = 0.0
    # What is accumulated and the last output weigh less of what the network says where the last
    # output differs from the frame's sample by more than so many times the noise of the frame, see
    # `stillray.stages.recall`; [1, 100], 0: all of it.
    recall_noise: float = 0.0

    def __post_init__(self) -> None:
        within("decoder.scale", self.scale, 1, 2)
        if self.recall_noise:
            within("decoder.recall_noise", self.recall_noise, 1, _MOST_NOISE)
        within("decoder.filter_tone", self.filter_tone, 0, _MOST_TONE)
        each("decoder.coarsest_filters", self.coarsest_filters, 1, _MAX_WINDOW // 2)
        within("decoder.features", self.features, 1, _MAX_FILTER_FEATURES)
        within("decoder.logit_bound", self.logit_bound, 1e-3, 20)


def _kernels(sizes: tuple[int, ...]) -> None:
    within("the number of decoder.kernel_sizes", len(sizes), 1, _MAX_KERNELS)
    odd("decoder.kernel_sizes", sizes, _MAX_WINDOW)
