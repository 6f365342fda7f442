"""Model specifications: one TOML file a model, read strictly.

A spec says everything that turns buffers into a picture: inputs, transfer, network, decoder,
temporal accumulation and the training recipe. The same spec, as JSON, is embedded in the model's
.onnx file; the runtime reads nothing else.
"""

from __future__ import annotations

import dataclasses
import json
import reprlib
import tomllib
import types
import typing
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

from stillray.errors import InputError

FORMAT = 1

PIXEL_FILTER = "pixel_filter"  # the plane that tells of it
#: Every network input plane by name, in the order that `stillray.stages.features` describes them.
FEATURES = (
    "irradiance.r", "irradiance.g", "irradiance.b", "irradiance.luminance",
    "sample.luminance", "local_luminance", "samples", PIXEL_FILTER,
    "albedo.r", "albedo.g", "albedo.b", "albedo.luminance",
    "normal.x", "normal.y", "normal.z", "depth",
    "previous.r", "previous.g", "previous.b", "previous.luminance", "previous.valid",
    # as Fan et al. 2021, section 5.1, have it: radiance with its albedo as displayed, normals in
    # [0, 1]
    "ldr.r", "ldr.g", "ldr.b", "scaled_normal.x", "scaled_normal.y", "scaled_normal.z",
    "pilot_a.r", "pilot_a.g", "pilot_a.b", "pilot_b.r", "pilot_b.g", "pilot_b.b",
)  # fmt: skip
#: What the network of a model that learns while it denoises is given, in this order.
ONLINE_FEATURES = (
    "pilot_a.r", "pilot_a.g", "pilot_a.b", "pilot_b.r", "pilot_b.g", "pilot_b.b",
    "albedo.r", "albedo.g", "albedo.b", "normal.x", "normal.y", "normal.z",
    "previous.r", "previous.g", "previous.b",
)  # fmt: skip
#: Planes of a network of two branches, in the order that `stillray.families.target_planes` fills
#: them; counts of samples are told by sines and cosines, see there.
RADIANCE_FEATURES = (
    "color.r", "color.g", "color.b", "past.r", "past.g", "past.b",
    "output.r", "output.g", "output.b",
    "past.count.0", "past.count.1", "past.count.2", "past.count.3", "offset.x", "offset.y",
)  # fmt: skip
GUIDE_FEATURES = (
    "albedo.r", "albedo.g", "albedo.b", "specular.r", "specular.g", "specular.b",
    "normal.x", "normal.y", "normal.z", "roughness", "depth", "depth.change",
    "past_albedo.r", "past_albedo.g", "past_albedo.b",
    "past_specular.r", "past_specular.g", "past_specular.b",
    "past_albedo.count.0", "past_albedo.count.1", "past_albedo.count.2", "past_albedo.count.3",
    "past_specular.count.0", "past_specular.count.1", "past_specular.count.2",
    "past_specular.count.3", "offset.x", "offset.y",
)  # fmt: skip
#: exp of twice the bound of logits, times a window, must stay far inside float32 (3e38).
MAX_LOGIT = 40
# A specification may come from anybody. Its numbers set loops, windows and arrays: beyond these
# a denoiser would not end, or not fit into memory, and no model that makes sense comes near.
_MAX_CHARACTERS = 2**18  # of a specification
_MAX_TEXT = 500  # characters of one value
_MAX_NAME = 64
_MAX_LIST = 64  # values
_MAX_WIDTH = 1024  # planes
_MAX_ONLINE_WIDTH = 64  # planes of a network whose weights and moments are kept with the past
_MAX_BLOCKS = 64
_MAX_LEVELS = 8  # every one halves the resolution
_MAX_NETWORK_KERNEL = 31  # pixels
_MAX_KERNELS = 16
_MAX_WINDOW = 127  # pixels of a reconstruction kernel
_MAX_FILTER_FEATURES = 32
_MOST_TONE = 1000.0
_MAX_LOCAL_SIZE = 255  # pixels
_MAX_COUNT = 10**9  # steps and the like, of training
BUFFERS = (
    "color", "albedo", "normal", "depth", "motion", "color_b", "jitter",
    "roughness", "specular_albedo",
)  # fmt: skip


@dataclass(frozen=True)
class Family:
    """What the tables of a specification hold in one family of models."""

    network: type
    decoder: type
    most_block: int = 2  # pixels, of the networks that know blocks
    weighs_past: bool = False  # the network itself, pixel by pixel: no rule bounds it beside edges


class SpecError(InputError):
    """A specification that cannot be used: the message names the key and the rule."""


@dataclass(frozen=True, kw_only=True)
class Inputs:
    """Buffers of `stillray.Frame` that the model takes."""

    required: tuple[str, ...]
    optional: tuple[str, ...]


@dataclass(frozen=True, kw_only=True)
class Demodulate:
    """Division of radiance by albedo before filtering (Fan et al. 2021, section 4.2)."""

    floor: float  # smallest demodulation albedo of a channel, (0, 1]
    black: float  # albedo below this in all channels says nothing: white there, [0, floor]
    specular: float = 0.0  # what surfaces reflect besides, uncoloured: added to the albedo, [0, 1]


@dataclass(frozen=True, kw_only=True)
class Relief:
    """Shading by the fine part of normals that is put back, see `stillray.stages.relief`."""

    # standard deviation of the window in which what was filtered away is explained, pixels; 0: it
    # is left away
    window: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """Light of small lamps that is put back, see `stillray.stages.lamps`."""

    restored: bool = False


@dataclass(frozen=True, kw_only=True)
class Transfer:
    """From scene-linear irradiance to network features."""

    middle: float  # exposed value of the frame's typical irradiance, > 0
    local_size: int  # pixels, odd: window of the local luminance
    exposure_memory: float  # share of the previous frame's log exposure that is kept, [0, 1)


@dataclass(frozen=True, kw_only=True)
class Temporal:
    """Reprojection and accumulation before the network (Fan et al. 2021, section 4.1)."""

    max_samples: float  # samples that a pixel's history counts as at most, >= 1
    # a sample this many times its surroundings counts two thirds in a pixel that holds three, > 0
    outlier_ratio: float
    normal_cosine: float  # a tap is accepted when its normal agrees at least so much, [-1, 1]
    depth_ratio: float  # and its depth differs at most by this share, > 0
    # samples that the albedo's past counts as at most, where the result is multiplied by it, >= 0;
    # 0: by this frame's alone
    albedo_samples: float
    # Standard deviations that a pixel may stand above the 3x3 pixels around it before it is given
    # their median, >= 0; 0: nothing is removed. Models that were exported before it was known lack
    # it.
    outlier_deviations: float = 0.0
    # Square pixels by which looking between pixels may blur a past, >= 0: it counts as no more
    # samples than that over what one look blurs; 0: as ``max_samples`` alone. Younger, too.
    most_blur: float = 0.0
    # How many times the darkest of four pixels of the last output the brightest must be for a look
    # at accumulated light between them to be made as sharp as one at that output, >= 1; 0: none is.
    # Younger, too.
    sharp_contrast: float = 0.0
    # As ``most_blur``, where such an edge is among the 4x4 pixels around a look, >= 0; 0: as
    # ``most_blur`` alone. Younger, too.
    edge_blur: float = 0.0


@dataclass(frozen=True, kw_only=True)
class ImportanceNetwork:
    """ImportanceNet: a chain of RepVGG blocks (Fan et al. 2021, figure 2)."""

    features: tuple[str, ...]  # input planes by name
    # pixels, 1 or 2: the network works on squares of pixels with this side, as if they were pixels
    # of so many times the features, and tells them apart in its logits alone
    block: int
    widths: tuple[int, ...]  # output channels of every block but the last
    kernel_sizes: tuple[int, ...]  # of each block, odd, in pixels or squares of them
    # kernel sizes trained side by side and fused for inference; a block has those below its own
    branches: tuple[int, ...]
    identity: bool  # an identity branch where input and output widths agree (training only)

    def __post_init__(self) -> None:
        blocks = len(self.widths) + 1
        if len(self.kernel_sizes) != blocks:
            raise SpecError(
                f"network.kernel_sizes must have {blocks} entries for {len(self.widths)} widths, "
                f"got {self.kernel_sizes}"
            )
        _odd("network.kernel_sizes", self.kernel_sizes, _MAX_NETWORK_KERNEL)
        _features(self.features)
        _branches(max(self.kernel_sizes), self.branches)
        _within("network.block", self.block, 1, 2)
        _each("network.widths", self.widths, 1, _MAX_WIDTH)

    def block_branches(self, block: int) -> tuple[int, ...]:
        """Kernel sizes that are trained side by side in a block, its own first."""
        own = self.kernel_sizes[block]
        return own, *(size for size in self.branches if size < own)


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
        _within("ensemble", size, 1, self.most_ensemble)
        return self


@dataclass(frozen=True, kw_only=True)
class FusedKernels(Decoder):
    """Fused weight-sharing kernels (Fan et al. 2021, eq. 2 to 5)."""

    kernel_sizes: tuple[int, ...]  # pixels, odd, one importance map each
    logit_bound: float  # importance and fusion logits are clipped to +- this, (0, 40]
    weigh_samples: bool  # multiply importance by the samples that a pixel holds

    def __post_init__(self) -> None:
        _kernels(self.kernel_sizes)
        _within("decoder.logit_bound", self.logit_bound, 1e-3, MAX_LOGIT)

    @property
    def fused_sizes(self) -> tuple[int, ...]:
        return self.kernel_sizes

    def with_kernels(self, sizes: tuple[int, ...]) -> Self:
        return dataclasses.replace(self, kernel_sizes=sizes)


@dataclass(frozen=True, kw_only=True)
class PyramidNetwork:
    """A U-Net of RepVGG blocks that gives logits at every resolution, finest first."""

    features: tuple[str, ...]  # input planes by name
    # pixels, 1 or 2: the finest level works on blocks with this side, and tells their pixels apart
    # in its logits alone; with 2 it gives those of two resolutions
    block: int
    widths: tuple[int, ...]  # channels of each level; every level halves the resolution
    encoder_blocks: tuple[int, ...]  # blocks of each level on the way down, after its entry
    decoder_blocks: tuple[int, ...]  # blocks of each level but the coarsest on the way up
    concatenate: tuple[bool, ...]  # of each level but the coarsest: append the skip, or add it
    kernel_size: int  # pixels, odd
    branches: tuple[int, ...]  # kernel sizes trained side by side and fused for inference
    identity: bool  # an identity branch where input and output widths agree (training only)

    def __post_init__(self) -> None:
        _features(self.features)
        _branches(self.kernel_size, self.branches)
        _within("network.block", self.block, 1, 2)
        _each("network.widths", self.widths, 1, _MAX_WIDTH)
        for key in ("encoder_blocks", "decoder_blocks"):
            _each(f"network.{key}", getattr(self, key), 0, _MAX_BLOCKS)
        levels = len(self.widths)
        _within("levels of network.widths", levels, 1, _MAX_LEVELS)
        for key, count in (
            ("encoder_blocks", levels),
            ("decoder_blocks", levels - 1),
            ("concatenate", levels - 1),
        ):
            if len(getattr(self, key)) != count:
                raise SpecError(
                    f"network.{key} must have {count} entries for {levels} widths, "
                    f"got {getattr(self, key)}"
                )

    @property
    def resolutions(self) -> int:
        """How many resolutions there are logits for."""
        return len(self.widths) + self.block - 1


#: Views of a frame, of which each costs a run of the network.
MOST_ENSEMBLE = 4


@dataclass(frozen=True, kw_only=True)
class PyramidKernels(Decoder):
    """Weight-sharing kernels at several resolutions, then a resolve with the previous output."""

    kernel_sizes: tuple[int, ...]  # pixels of each level, odd, one importance map each
    finest_kernels: bool  # whether the finest level has them too, or the coarser alone
    predicted: bool  # whether pixels of the coarser levels have a weight for each neighbour, too
    logit_bound: float  # logits are clipped to +- this, (0, 20]
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
    # Views of a frame whose pictures are averaged, 1 to 4, see `stillray.families.views`.
    ensemble: int = 1

    def __post_init__(self) -> None:
        _kernels(self.kernel_sizes)
        _within("decoder.ensemble", self.ensemble, 1, MOST_ENSEMBLE)
        _within("decoder.logit_bound", self.logit_bound, 1e-3, MAX_LOGIT)
        _within("decoder.filter_tone", self.filter_tone, 0, _MOST_TONE)
        _within("decoder.resolve_tone", self.resolve_tone, 0, _MOST_TONE)
        _each("decoder.finest_neighbours", self.finest_neighbours, 1, _MAX_WINDOW // 2)
        _each("decoder.finest_filters", self.finest_filters, 1, _MAX_WINDOW // 2)
        _within(
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
class GuideNetwork:
    """GuideNet: two convolutions, or a dense block between them (Meng et al. 2020, figure 2)."""

    features: tuple[str, ...]  # input planes by name
    width: int  # output channels of the first block
    dense_layers: int  # blocks that each see all before them, 0: none
    growth: int  # output channels of each of those
    kernel_size: int  # pixels, odd
    branches: tuple[int, ...]  # kernel sizes trained side by side and fused for inference
    identity: bool  # an identity branch where input and output widths agree (training only)

    def __post_init__(self) -> None:
        _features(self.features)
        _branches(self.kernel_size, self.branches)
        _within("network.width", self.width, 1, _MAX_WIDTH)
        _within("network.dense_layers", self.dense_layers, 0, _MAX_BLOCKS)
        # of no account without such layers
        _within("network.growth", self.growth, 1 if self.dense_layers else 0, _MAX_WIDTH)


@dataclass(frozen=True, kw_only=True)
class BilateralGrids(Decoder):
    """Bilateral grids at one or several scales (Meng et al. 2020, eq. 8 to 15)."""

    grids: int  # one a scale; every scale doubles the rates
    spacing: int  # pixels from cell to cell of the finest grid, along x and y
    depth_spacing: float  # and along its guide, of which there are 255
    weigh_samples: bool  # splat a pixel by the samples that it holds

    def __post_init__(self) -> None:
        _within("decoder.grids", self.grids, 1, 5)
        _within("decoder.spacing", self.spacing, 1, 64)
        _within("decoder.depth_spacing", self.depth_spacing, 1, 255)


@dataclass(frozen=True, kw_only=True)
class FilterNetwork:
    """A U-Net of plain convolutions that sets a filter (Choi et al. 2024, section 4.4)."""

    features: tuple[str, ...]  # input planes by name
    widths: tuple[int, ...]  # filters of each level; every level halves the resolution

    def __post_init__(self) -> None:
        if self.features != ONLINE_FEATURES:
            raise SpecError(f"network.features must be {', '.join(ONLINE_FEATURES)}")
        _within("levels of network.widths", len(self.widths), 1, _MAX_LEVELS)
        _each("network.widths", self.widths, 1, _MAX_ONLINE_WIDTH)


@dataclass(frozen=True, kw_only=True)
class CrossBilateral(Decoder):
    """A cross-bilateral filter that is learned while it runs (Choi et al. 2024, eq. 8 to 13)."""

    learning_rate: float  # of Adam, one step a frame, [0, 0.1]

    def __post_init__(self) -> None:
        _within("decoder.learning_rate", self.learning_rate, 0, 0.1)


@dataclass(frozen=True, kw_only=True)
class BranchNetwork:
    """MUNet: a U-Net whose radiance branch a smaller one of guides steers (Kazmierczyk et al. 2025,
    figure 3)."""

    radiance: tuple[str, ...]  # input planes of the radiance branch, by name
    guides: tuple[str, ...]  # and of the guiding branch
    # channels of each level; the first has half the resolution of the planes, every other one half
    # of that before it
    radiance_widths: tuple[int, ...]
    guide_widths: tuple[int, ...]
    partial: bool  # whether all levels but the first convolve half of their channels alone
    kernel_size: int  # pixels, odd
    branches: tuple[int, ...]  # kernel sizes trained side by side and fused for inference
    identity: bool  # an identity branch beside them (training only)

    def __post_init__(self) -> None:
        _branches(self.kernel_size, self.branches)
        levels = len(self.radiance_widths)
        _within("levels of network.radiance_widths", levels, 1, _MAX_LEVELS)
        if len(self.guide_widths) != levels:
            raise SpecError(
                f"network.guide_widths must have {levels} entries like radiance_widths, "
                f"got {self.guide_widths}"
            )
        for key in ("radiance_widths", "guide_widths"):
            _each(f"network.{key}", getattr(self, key), 2, _MAX_WIDTH)
            if any(width % 2 for width in getattr(self, key)):
                raise SpecError(f"network.{key} must be even, got {getattr(self, key)}")
        for key, known in (("radiance", RADIANCE_FEATURES), ("guides", GUIDE_FEATURES)):
            if not getattr(self, key):
                raise SpecError(f"network.{key} must not be empty")
            for name in getattr(self, key):
                _one_of(f"network.{key}", name, known)

    @property
    def features(self) -> tuple[str, ...]:
        """All input planes, those of the radiance branch first."""
        return self.radiance + self.guides

    @property
    def resolutions(self) -> int:
        """How many resolutions there are planes for: that of the picture, and each level's."""
        return len(self.radiance_widths) + 1


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

    def __post_init__(self) -> None:
        _within("decoder.scale", self.scale, 1, 2)
        _within("decoder.filter_tone", self.filter_tone, 0, _MOST_TONE)
        _each("decoder.coarsest_filters", self.coarsest_filters, 1, _MAX_WINDOW // 2)
        _within("decoder.features", self.features, 1, _MAX_FILTER_FEATURES)
        _within("decoder.logit_bound", self.logit_bound, 1e-3, 20)


OPTIMISERS = ("adam", "muon")


@dataclass(frozen=True, kw_only=True)
class Training:
    """The recipe that `stillray-train` follows."""

    steps: int
    batch: int
    patch: int  # pixels
    learning_rate: float  # of the optimiser, cosine decay to 1 % of it
    smape_epsilon: float  # Fan et al. 2021, eq. 6, in exposed radiance
    display_weight: float  # weight of the error as displayed beside SMAPE, >= 0
    # weight of its square there, which is what PSNR counts, >= 0
    squared_weight: float
    structure_weight: float  # weight of one minus the structural similarity, >= 0
    steady_weight: float  # weight of the change against the previous output, >= 0
    quiet_share: float  # share of patches of little noise and a few fireflies, [0, 1]
    history_from: int  # step from which previous outputs are given; 0: the model takes none
    history_every: int  # steps between renewals of those outputs
    drop_feature: float  # probability that albedo, normal or depth is withheld from a patch
    exposure_stops: float  # exposure is varied by +- this
    seed: int
    # What follows may be left out: models that were exported before it was known lack it.
    # weights of errors of slopes, and of means of 4x4 and 16x16 pixels, as displayed, >= 0
    slope_weight: float = 0.0
    blur_weight: float = 0.0
    hinge_weight: float = 0.0  # weight of squares further off than the input was, >= 0
    # Patches weigh by their input's error as displayed to the power of minus this: with 0.5 those
    # that begin with a hundredth of the error count ten times as much. [0, 1]
    quiet_power: float = 0.0
    average: float = 0.0  # decay of the mean of weights over steps, which is what is kept; 0: none
    # Whether the network's convolutions run so where the processor can: half the time, less exact
    bfloat16: bool = False
    still_share: float = 0.0  # share of patches of single frames of 2 to 32 samples a pixel, [0, 1]
    alone: bool = False  # whether no patch has a past: for a model of single frames
    # share of patches of a recurrent model that have neither jitter nor roughness nor specular
    # albedo, as most renderers write them, [0, 1]
    plain_share: float = 0.0
    # share of patches of a recurrent model over which a shadow or a bright patch moves, or whose
    # light is switched, [0, 1]
    shade_share: float = 0.0
    # share of patches of a recurrent model whose texture changes, or whose albedo is black in
    # places, [0, 1]
    paint_share: float = 0.0
    # share of patches of a recurrent model with fireflies, [0, 1]
    firefly_share: float = 0.0
    # share of patches of a recurrent model, of those where nothing moves, whose frames are means of
    # several, as of samples all over their pixels, [0, 1]
    mean_share: float = 0.0
    # share of sequences into which small lamps are painted, of models of patches, [0, 1]
    lamp_share: float = 0.0
    # share of batches whose patches have 32, 48 or 64 pixels a side, so that pictures are met whose
    # coarser levels have next to no pixels, of models of patches, [0, 1]
    small_share: float = 0.0
    frames: int = 1  # that a recurrent model is unrolled over
    warm_frames: int = 0  # most frames before those, which are run and not learned from
    fresh_share: float = 0.0  # share of batches that have none of those, [0, 1]
    weight_decay: float = 0.0  # decoupled, see `torch.optim.AdamW`; >= 0
    optimiser: str = "adam"  # one of OPTIMISERS
    albedo_weight: float = 0.0  # weight of the error of accumulated albedos, >= 0
    smape_weight: float = 1.0  # weight of SMAPE itself, >= 0
    # weight of the error after a filmic curve, which Meng et al. 2020 train by, >= 0
    filmic_weight: float = 0.0
    mean_weight: float = 0.0  # weight of how far a patch's mean as displayed is off, >= 0

    def __post_init__(self) -> None:
        for key in (
            "display_weight", "squared_weight", "structure_weight", "steady_weight",
            "slope_weight", "blur_weight", "hinge_weight", "weight_decay", "albedo_weight",
            "smape_weight", "filmic_weight", "mean_weight",
        ):  # fmt: skip
            _within(f"training.{key}", getattr(self, key), 0, 1e3)
        for key in (
            "quiet_power", "average", "still_share", "quiet_share", "drop_feature", "plain_share",
            "shade_share", "paint_share", "firefly_share", "lamp_share", "fresh_share",
            "mean_share", "small_share",
        ):  # fmt: skip
            _within(f"training.{key}", getattr(self, key), 0, 1)
        for key in ("steps", "batch", "patch", "frames"):
            _within(f"training.{key}", getattr(self, key), 1, _MAX_COUNT)
        for key in ("history_from", "history_every", "seed", "warm_frames"):
            _within(f"training.{key}", getattr(self, key), 0, _MAX_COUNT)
        _one_of("training.optimiser", self.optimiser, OPTIMISERS)
        _within("training.learning_rate", self.learning_rate, 1e-12, 1e3)
        _within("training.smape_epsilon", self.smape_epsilon, 1e-12, 1e6)
        _within("training.exposure_stops", self.exposure_stops, 0, 32)


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """Everything about one model but its weights."""

    format: int
    name: str
    family: str
    summary: str
    aliases: tuple[str, ...]
    inputs: Inputs
    demodulate: Demodulate
    transfer: Transfer
    temporal: Temporal
    network: ImportanceNetwork | PyramidNetwork | GuideNetwork | FilterNetwork | BranchNetwork
    decoder: FusedKernels | PyramidKernels | BilateralGrids | CrossBilateral | FeatureFilters
    training: Training
    # Models that were exported before it was known have none.
    relief: Relief = Relief()
    lamps: Lamps = Lamps()
    # How it differs from the paper it follows, "what the paper says; here what is done". Prose:
    # no part of what a model is, and models that were exported before it was known lack it.
    differs: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    @property
    def knows_samples(self) -> bool:
        """Whether its network learned what samples a pixel mean, and is told them."""
        return "samples" in self.network.features and self.training.still_share > 0

    @property
    def knows_filter(self) -> bool:
        """Whether its network or its resolve is told the renderer's pixel filter."""
        return PIXEL_FILTER in self.network.features or self.decoder.minds_filter

    @property
    def knows_past(self) -> bool:
        """Whether frames may have a past: otherwise each is denoised alone, whatever is asked."""
        return not self.training.alone

    @property
    def knows_jitter(self) -> bool:
        """Whether jitter is looked at: pictures then lie at the centres of their pixels."""
        return "jitter" in (*self.inputs.required, *self.inputs.optional)

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise SpecError(f"format must be {FORMAT}, got {self.format}")
        _one_of("family", self.family, FAMILIES)
        for name in (self.name, *self.aliases):
            _require_name(name)
        for name in self.inputs.required + self.inputs.optional:
            _one_of("inputs", name, BUFFERS)
        family = FAMILIES[self.family]
        for key in ("network", "decoder"):
            kind = getattr(family, key)
            if not isinstance(getattr(self, key), kind):
                raise SpecError(
                    f"{key} of {self.family} must be {kind.__name__}, "
                    f"got {type(getattr(self, key)).__name__}"
                )
        _within("network.block", getattr(self.network, "block", 1), 1, family.most_block)
        _odd("transfer.local_size", (self.transfer.local_size,), _MAX_LOCAL_SIZE)
        _within("demodulate.floor", self.demodulate.floor, 1e-6, 1)
        _within("demodulate.black", self.demodulate.black, 0, self.demodulate.floor)
        _within("demodulate.specular", self.demodulate.specular, 0, 1)
        _within("transfer.middle", self.transfer.middle, 1e-6, 1e6)
        _within("transfer.exposure_memory", self.transfer.exposure_memory, 0, 0.999)
        _within("temporal.max_samples", self.temporal.max_samples, 1, 1e6)
        _within("temporal.outlier_ratio", self.temporal.outlier_ratio, 1e-3, 1e9)
        _within("temporal.normal_cosine", self.temporal.normal_cosine, -1, 1)
        _within("temporal.albedo_samples", self.temporal.albedo_samples, 0, 1e6)
        _within("temporal.depth_ratio", self.temporal.depth_ratio, 1e-6, 1e6)
        _within("temporal.outlier_deviations", self.temporal.outlier_deviations, 0, 100)
        _within("temporal.most_blur", self.temporal.most_blur, 0, 1e6)
        _within("temporal.sharp_contrast", self.temporal.sharp_contrast or 1.0, 1, 1e6)
        # edges are those of some contrast
        bounded = self.temporal.sharp_contrast > 0 and not family.weighs_past
        _within("temporal.edge_blur", self.temporal.edge_blur, 0, 1e6 if bounded else 0)
        _within("relief.window", self.relief.window, 0, 1e3)

    def to_json(self) -> str:
        """The spec as JSON text, as it is embedded in a model file."""
        data = dataclasses.asdict(self)
        # as before they were known
        for name, unsaid in (("differs", ()), ("relief", Relief()), ("lamps", Lamps())):
            if getattr(self, name) == unsaid:
                del data[name]
        return json.dumps(data, sort_keys=True)


FAMILIES = {
    "weight-sharing-kernels": Family(ImportanceNetwork, FusedKernels),
    "kernel-pyramid": Family(PyramidNetwork, PyramidKernels),
    "multi-resolution-kernels": Family(PyramidNetwork, FusedKernels, most_block=1),
    "bilateral-grids": Family(GuideNetwork, BilateralGrids),
    "cross-regression": Family(FilterNetwork, CrossBilateral),
    "feature-filters": Family(BranchNetwork, FeatureFilters, weighs_past=True),
}


def parse(data: dict[str, Any]) -> ModelSpec:
    """Build a spec from nested dictionaries.

    Raises
    ------
    SpecError
        A key is unknown or missing, or a value breaks its rule.
    """
    hints = typing.get_type_hints(ModelSpec)
    # an unknown or missing family is reported with the other keys
    if isinstance(data, dict) and (family := FAMILIES.get(str(data.get("family")))):
        hints.update(network=family.network, decoder=family.decoder)
    elif isinstance(data, dict) and "family" in data:
        _one_of("family", str(data["family"]), FAMILIES)
    return _build(ModelSpec, hints, data, "")


def load(name: str) -> ModelSpec:
    """Load the packaged spec of a model by name, ``load("wskp-3")``.

    Raises
    ------
    SpecError
        There is no such spec (the message lists those there are), or it breaks a rule.
    """
    folder = _specs()
    names = sorted(path.stem for path in folder.glob("*.toml"))
    if name not in names:
        raise SpecError(f"model must be one of {', '.join(names)}, got {name}")
    return parse(tomllib.loads((folder / f"{name}.toml").read_text()))


def _specs() -> Path:
    here = Path(__file__).parent
    installed = here / "specs"
    # the repository keeps them at its root; an installed package carries a copy
    return installed if installed.is_dir() else here.parents[2] / "models_spec"


def from_json(text: str) -> ModelSpec:
    """Read back what `ModelSpec.to_json` wrote.

    Raises
    ------
    SpecError
        It is not that, or too long.
    """
    if len(text) > _MAX_CHARACTERS:
        raise SpecError(f"a specification must have {_MAX_CHARACTERS} characters at most")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SpecError(f"a specification must be JSON: {error}") from None
    return parse(data)


def _build(kind: type, hints: dict[str, Any], data: Any, path: str) -> Any:
    if not isinstance(data, dict):
        name = path.rstrip(".") or "a specification"
        raise SpecError(f"{name} must be a table, got {_brief(data)}")
    if unknown := sorted(set(data) - set(hints)):
        known = ", ".join(hints)
        raise SpecError(f"unknown key {path}{unknown[0][:_MAX_NAME]}; known keys: {known}")
    optional = {
        field.name for field in dataclasses.fields(kind) if field.default is not dataclasses.MISSING
    }
    if missing := [key for key in hints if key not in data and key not in optional]:
        raise SpecError(f"missing key {path}{missing[0]}")
    given = {key: hint for key, hint in hints.items() if key in data}
    return kind(**{key: _value(hint, data[key], path + key) for key, hint in given.items()})


def _value(hint: Any, value: Any, path: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), typing.get_type_hints(hint), value, path + ".")
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise SpecError(f"{path} must be a list, got {_brief(value)}")
        if len(value) > _MAX_LIST:
            raise SpecError(f"{path} must have {_MAX_LIST} entries at most, got {len(value)}")
        return tuple(_value(typing.get_args(hint)[0], item, path) for item in value)
    # as integers beyond what floats hold are not turned into any
    if hint is float and type(value) is int and abs(value) < 2**53:
        return float(value)
    if isinstance(hint, types.UnionType) or type(value) is not hint:
        raise SpecError(f"{path} must be of type {hint.__name__}, got {_brief(value)}")
    if hint is str and not (len(value) <= _MAX_TEXT and value.isprintable()):
        raise SpecError(
            f"{path} must be {_MAX_TEXT} printable characters at most, got {_brief(value)}"
        )
    return value


def _brief(value: Any) -> str:
    """A value in a message: what a file holds may be long, or deep."""
    return reprlib.repr(value)


def _require_name(name: str) -> None:
    # it becomes a file's name and a word in tables
    if not 1 <= len(name) <= _MAX_NAME or set(name) & set("/\\") or name[0] in ".-":
        raise SpecError(
            f"name and aliases must be 1 to {_MAX_NAME} characters without slashes, not beginning "
            f"with a dot or dash, got {_brief(name)}"
        )


def _odd(key: str, sizes: Iterable[int], most: int) -> None:
    for size in sizes:
        if not 1 <= size <= most or size % 2 == 0:
            raise SpecError(f"{key} must be odd and 1 to {most} pixels, got {size}")


def _kernels(sizes: tuple[int, ...]) -> None:
    _within("the number of decoder.kernel_sizes", len(sizes), 1, _MAX_KERNELS)
    _odd("decoder.kernel_sizes", sizes, _MAX_WINDOW)


def _features(names: tuple[str, ...]) -> None:
    if not names:
        raise SpecError("network.features must not be empty")
    for name in names:
        _one_of("network.features", name, FEATURES)


def _branches(kernel_size: int, branches: tuple[int, ...]) -> None:
    _odd("network.kernel_size", (kernel_size,), _MAX_NETWORK_KERNEL)
    _odd("network.branches", branches, _MAX_NETWORK_KERNEL)
    if max(branches, default=0) != kernel_size:
        raise SpecError(
            f"network.branches must have the network's kernel size ({kernel_size}) as their "
            f"largest, got {branches}"
        )


def _one_of(key: str, value: str, known: Iterable[str]) -> None:
    if value not in known:
        raise SpecError(f"{key} must be one of {', '.join(known)}, got {value[:_MAX_NAME]}")


def _each(key: str, values: Iterable[int], low: int, high: int) -> None:
    for value in values:
        _within(key, value, low, high)


def _within(key: str, value: float, low: float, high: float) -> None:
    if not low <= value <= high:
        raise SpecError(f"{key} must be in [{low:g}, {high:g}], got {_brief(value)}")
