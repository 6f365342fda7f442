"""What is remembered between frames, and a frame on its way to the network."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stillray.pixel_filter import filter_sharpness
from stillray.stages.history_rejection import Noise
from stillray.stages.sample_counts import SampleCounts


@dataclass(frozen=True, kw_only=True)
class Remembered:
    """What there is in a history, without its arrays: what the next frame is decided on.

    Attributes
    ----------
    shape
        Height and width of the frame, pixels.
    mean_albedo, output
        Whether the history has them.
    layers
        Names of the layers that have a past.
    """

    shape: tuple[int, int]
    mean_albedo: bool
    output: bool
    layers: frozenset[str]


@dataclass(frozen=True, kw_only=True, eq=False)
class LayerPast:
    """What is remembered of a layer that is filtered as the beauty is, see
    `stillray.pipeline.layers`.

    Attributes
    ----------
    mean : (h, w, 4) float32
        As the beauty's; the samples are the same.
    output : (h, w, 4) float32 or None
        As the beauty's.
    """

    mean: np.ndarray
    output: np.ndarray | None


@dataclass(frozen=True, kw_only=True, eq=False)
class History:
    """What is remembered of the past: a value that can be kept, dropped or copied.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance and, last, the samples that each pixel holds.
    surface_guides : (h, w, 4) float32 or None
        Geometry of the last frame, see `stillray.stages.reproject.pack`.
    exposure
        1 / irradiance, steadied over the sequence.
    noise
        See `stillray.stages.history_rejection`; None of a frame without a past.
    output : (h, w, 4) float32 or None
        The last output, see `stillray.stages.previous_output.keep`; None for models that take
        none.
    mean_albedo : (h, w, 4) float32 or None
        See `stillray.stages.albedo_history`; None for models that use this frame's alone.
    mean_albedo_frames
        Frames that the ``mean_albedo`` holds.
    layers
        By name, the past of layers that are filtered as the beauty is.
    frame_samples
        Samples a pixel of the frames that ``mean`` counts in; None if nobody said.
    """

    mean: np.ndarray
    surface_guides: np.ndarray | None
    exposure: float
    noise: Noise | None = None
    output: np.ndarray | None = None
    mean_albedo: np.ndarray | None = None
    mean_albedo_frames: float = 0.0
    layers: Mapping[str, LayerPast] = field(default_factory=dict)
    frame_samples: float | None = None

    @property
    def remembered(self) -> Remembered:
        """What there is, without the arrays."""
        height, width = self.mean.shape[:2]
        return Remembered(
            shape=(height, width),
            mean_albedo=self.mean_albedo is not None,
            output=self.output is not None,
            layers=frozenset(self.layers),
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Prepared:
    """A frame on its way, ready for the network: also what training learns from.

    Attributes
    ----------
    history
        The history after this frame; its ``mean`` is what the kernels filter, see ``believed``.
    sample : (4, h, w) float32 or None
        This frame's irradiance and, last, what its samples would weigh in new pixels; None where
        it was not asked for, or where there is no past: it is the ``mean`` then.
    sample_weight : (h, w) float32 or None
        What they weighed beside the past; None as ``sample``.
    luminance : (h, w) float32
        Luminance of this frame's irradiance.
    demodulation_albedo : (h, w, 3) float32 or None
        What radiance was divided by; None where there is no albedo.
    remodulation_albedo : (h, w, 3) float32 or None
        What the result is multiplied by: ``demodulation_albedo``, or its mean over frames.
    local : (h, w) float32
        Tone-mapped local luminance: of the accumulated irradiance, if the network asks for it.
    albedo, normal, depth
        The frame's, repaired.
    depth_unit
        Scale of the depth feature.
    motion : (h, w, 2) float32 or None
        The frame's, finite; in mirrors that of what they show, see
        `stillray.stages.specular_motion`.
    picture_positions : (h, w, 2) float32 or None
        Where the pixels' picture was in the last one: x and y by their motion, but at silhouettes
        by that of the nearer surface, see `stillray.stages.motion_dilation`. None where nothing
        moves, or without a past, or where nobody looks at past pictures.
    history_confidence : (h, w) float32 or None
        How far the past agrees with this frame, [0, 1], see `stillray.stages.history_rejection`;
        None where all of it does.
    disoccluded : (h, w) uint8 or None
        1 where a pixel holds this frame's sample alone; None without a past, or where nobody looks
        at past outputs.
    counts
        The frame's samples.
    filter_spread
        As in `stillray.Frame`.
    recalled : (h, w) float32 or None
        What the last output weighs in the picture, as a share of what the network says, see
        `stillray.stages.recall`; None: all of it.
    agreed : (h, w) float32 or None
        What the past counts, as a share, see `stillray.stages.recall`; None: all of it.
    believed : (h, w, 4) float32 or None
        What is left of the history's ``mean`` by that, which kernels filter in its place.
    """

    history: History
    sample: np.ndarray | None
    sample_weight: np.ndarray | None
    luminance: np.ndarray
    demodulation_albedo: np.ndarray | None
    remodulation_albedo: np.ndarray | None
    local: np.ndarray
    albedo: np.ndarray | None
    normal: np.ndarray | None
    depth: np.ndarray | None
    depth_unit: float
    motion: np.ndarray | None
    picture_positions: np.ndarray | None = None
    disoccluded: np.ndarray | None = None
    history_confidence: np.ndarray | None = None
    counts: SampleCounts = SampleCounts()  # noqa: RUF009  a value that nobody can change
    filter_spread: float | None = None
    recalled: np.ndarray | None = None
    agreed: np.ndarray | None = None
    believed: np.ndarray | None = None

    @property
    def mean(self) -> np.ndarray:
        """What the kernels filter, ``(h, w, 4)``: light and samples."""
        return self.history.mean if self.believed is None else self.believed


@dataclass(frozen=True, kw_only=True, eq=False)
class Filterable:
    """What kernels filter, of a frame or of another layer of it.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated irradiance, finite, and the samples that each pixel holds.
    sample : (4, h, w) float32 or None
        This frame's irradiance and what its samples weigh; None for that of ``mean``.
    remodulation_albedo : (h, w, 3) float32 or None
        What the result is multiplied by.
    previous : (h, w, 4) float32 or None
        Radiance of the previous output at these pixels, and how much of it is valid, [0, 1].
    exposure
        1 / irradiance.
    filter_sharpness
        See `stillray.pixel_filter.filter_sharpness`.
    recalled : (h, w) float32 or None
        As of the frame.
    """

    mean: np.ndarray
    sample: np.ndarray | None = None
    remodulation_albedo: np.ndarray | None = None
    previous: np.ndarray | None = None
    exposure: float = 1.0
    filter_sharpness: float = 1.0
    recalled: np.ndarray | None = None


def filterable(prepared: Prepared, previous: np.ndarray | None) -> Filterable:
    """What kernels look at of a prepared frame."""
    return Filterable(
        mean=prepared.mean,
        sample=prepared.sample,
        remodulation_albedo=prepared.remodulation_albedo,
        previous=previous,
        exposure=prepared.history.exposure,
        filter_sharpness=filter_sharpness(prepared.filter_spread),
        recalled=prepared.recalled,
    )
