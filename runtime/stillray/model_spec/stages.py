"""Tables of a specification for what runs before and after a network."""

from __future__ import annotations

from dataclasses import dataclass


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
class Texture:
    """What albedo tells of what was filtered away, put back, see `stillray.stages.texture`."""

    # standard deviation of the window in which what was filtered away is explained, pixels; 0: it
    # is left away
    window: float = 0.0


@dataclass(frozen=True, kw_only=True)
class Lamps:
    """Light of small lamps that is put back, see `stillray.stages.lamps`."""

    restored: bool = False


@dataclass(frozen=True, kw_only=True)
class RareLight:
    """Light of rare samples that is put back, see `stillray.stages.rare_light`."""

    restored: bool = False


@dataclass(frozen=True, kw_only=True)
class ToldSamples:
    """How many samples a pixel a network is told of, where the frame says how many there are."""

    # Of those there are, (0, 1], though no fewer than one: a network that is told of many expects
    # little noise, and keeps that of caustics and glass, which have more.
    share: float = 1.0


@dataclass(frozen=True, kw_only=True)
class Prefilter:
    """What is denoised before a frame is, see `stillray.pipeline.prefilter`."""

    albedo: str = ""  # name of the model that denoises it; none: it is taken as it is


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
    # 0: by this frame's alone; fewer where a frame tells more than 2 samples, in proportion
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
