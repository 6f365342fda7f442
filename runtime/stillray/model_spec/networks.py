"""Tables of a specification for networks: one a family."""

from __future__ import annotations

from dataclasses import dataclass

from stillray.model_spec.planes import FEATURES, GUIDE_FEATURES, ONLINE_FEATURES, RADIANCE_FEATURES
from stillray.model_spec.rules import SpecError, each, odd, one_of, within

_MAX_WIDTH = 1024  # planes
_MAX_ONLINE_WIDTH = 64  # planes of a network whose weights and moments are kept with the past
_MAX_BLOCKS = 64
_MAX_LEVELS = 8  # every one halves the resolution
_MAX_NETWORK_KERNEL = 31  # pixels


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
        odd("network.kernel_sizes", self.kernel_sizes, _MAX_NETWORK_KERNEL)
        _features(self.features)
        _branches(max(self.kernel_sizes), self.branches)
        within("network.block", self.block, 1, 2)
        each("network.widths", self.widths, 1, _MAX_WIDTH)

    def block_branches(self, block: int) -> tuple[int, ...]:
        """Kernel sizes that are trained side by side in a block, its own first."""
        own = self.kernel_sizes[block]
        return own, *(size for size in self.branches if size < own)


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
        within("network.block", self.block, 1, 2)
        each("network.widths", self.widths, 1, _MAX_WIDTH)
        for key in ("encoder_blocks", "decoder_blocks"):
            each(f"network.{key}", getattr(self, key), 0, _MAX_BLOCKS)
        levels = len(self.widths)
        within("levels of network.widths", levels, 1, _MAX_LEVELS)
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
        within("network.width", self.width, 1, _MAX_WIDTH)
        within("network.dense_layers", self.dense_layers, 0, _MAX_BLOCKS)
        # of no account without such layers
        within("network.growth", self.growth, 1 if self.dense_layers else 0, _MAX_WIDTH)


@dataclass(frozen=True, kw_only=True)
class FilterNetwork:
    """A U-Net of plain convolutions that sets a filter (Choi et al. 2024, section 4.4)."""

    features: tuple[str, ...]  # input planes by name
    widths: tuple[int, ...]  # filters of each level; every level halves the resolution

    def __post_init__(self) -> None:
        if self.features != ONLINE_FEATURES:
            raise SpecError(f"network.features must be {', '.join(ONLINE_FEATURES)}")
        within("levels of network.widths", len(self.widths), 1, _MAX_LEVELS)
        each("network.widths", self.widths, 1, _MAX_ONLINE_WIDTH)


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
        within("levels of network.radiance_widths", levels, 1, _MAX_LEVELS)
        if len(self.guide_widths) != levels:
            raise SpecError(
                f"network.guide_widths must have {levels} entries like radiance_widths, "
                f"got {self.guide_widths}"
            )
        for key in ("radiance_widths", "guide_widths"):
            each(f"network.{key}", getattr(self, key), 2, _MAX_WIDTH)
            if any(width % 2 for width in getattr(self, key)):
                raise SpecError(f"network.{key} must be even, got {getattr(self, key)}")
        for key, known in (("radiance", RADIANCE_FEATURES), ("guides", GUIDE_FEATURES)):
            if not getattr(self, key):
                raise SpecError(f"network.{key} must not be empty")
            for name in getattr(self, key):
                one_of(f"network.{key}", name, known)

    @property
    def features(self) -> tuple[str, ...]:
        """All input planes, those of the radiance branch first."""
        return self.radiance + self.guides

    @property
    def resolutions(self) -> int:
        """How many resolutions there are planes for: that of the picture, and each level's."""
        return len(self.radiance_widths) + 1


def _features(names: tuple[str, ...]) -> None:
    if not names:
        raise SpecError("network.features must not be empty")
    for name in names:
        one_of("network.features", name, FEATURES)


def _branches(kernel_size: int, branches: tuple[int, ...]) -> None:
    odd("network.kernel_size", (kernel_size,), _MAX_NETWORK_KERNEL)
    odd("network.branches", branches, _MAX_NETWORK_KERNEL)
    if max(branches, default=0) != kernel_size:
        raise SpecError(
            f"network.branches must have the network's kernel size ({kernel_size}) as their "
            f"largest, got {branches}"
        )
