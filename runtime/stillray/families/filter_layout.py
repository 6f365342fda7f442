"""What the planes of a network of feature filters are for, resolution by resolution.

See `stillray.families.feature_filters`.
"""

from __future__ import annotations

from dataclasses import dataclass

from stillray.model_spec.decoders import FeatureFilters

#: What is accumulated, in the order of its logits: light, diffuse and specular albedo.
ACCUMULATED = 3


@dataclass(frozen=True)
class GaussianPlanes:
    """Where a filter's planes lie.

    Attributes
    ----------
    features
        By whose distance neighbours are weighed.
    importance
        Logit of a pixel's own weight, whoever looks at it.
    """

    features: slice
    importance: int


@dataclass(frozen=True)
class TargetLayout:
    """The planes of the picture's resolution.

    Attributes
    ----------
    light, guides
        The filters that enlarge this frame's light, and its albedos.
    keep
        Logits of the past beside this frame, of light, diffuse and specular albedo.
    partition
        Logits of what a pixel gives to each coarser level, against its own at logit 0.
    denoise
        The filter of this level.
    coarser
        Logit of what it takes of the next level, against its own.
    compose
        Logits of light over diffuse albedo, over specular albedo, and of this frame's light
        alone, against the light that is not divided at logit 0.
    output
        Logit of the last output, against the picture.
    planes
        How many there are.
    """

    light: GaussianPlanes
    guides: GaussianPlanes
    keep: slice
    partition: slice
    denoise: GaussianPlanes
    coarser: int
    compose: slice
    output: int
    planes: int


@dataclass(frozen=True)
class LevelLayout:
    """The planes of a coarser level.

    Attributes
    ----------
    denoise
        The filter of this level.
    distances
        From pixel to pixel of that filter's passes, in pixels of the level, one after the other.
    coarser
        Logit of what it takes of the next level; None at the coarsest.
    planes
        How many there are.
    """

    denoise: GaussianPlanes
    distances: tuple[int, ...]
    coarser: int | None
    planes: int


def _gaussian(start: int, options: FeatureFilters) -> GaussianPlanes:
    end = start + options.features
    return GaussianPlanes(slice(start, end), end)


def target_layout(levels: int, options: FeatureFilters) -> TargetLayout:
    """The layout of the picture's resolution, with so many resolutions in all."""
    light = _gaussian(0, options)
    guides = _gaussian(light.importance + 1, options)
    keep = slice(guides.importance + 1, guides.importance + 1 + ACCUMULATED)
    partition = slice(keep.stop, keep.stop + levels - 1)
    denoise = _gaussian(partition.stop, options)
    coarser = denoise.importance + 1
    compose = slice(coarser + 1, coarser + 4)
    return TargetLayout(
        light=light,
        guides=guides,
        keep=keep,
        partition=partition,
        denoise=denoise,
        coarser=coarser,
        compose=compose,
        output=compose.stop,
        planes=compose.stop + 1,
    )


def level_layout(level: int, levels: int, options: FeatureFilters) -> LevelLayout:
    """The layout of a coarser level, 1 being the next to the picture's."""
    denoise = _gaussian(0, options)
    if level == levels - 1:
        return LevelLayout(denoise, options.coarsest_filters, None, denoise.importance + 1)
    return LevelLayout(denoise, (1,), denoise.importance + 1, denoise.importance + 2)
