"""A renderer's buffers for one frame, validated once."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.pixel_filter import check_spread

_CHANNELS = {
    "color": 3,
    "albedo": 3,
    "normal": 3,
    "depth": 1,
    "motion": 2,
    "color_b": 3,
    "samples": 1,
    "roughness": 1,
    "specular_albedo": 3,
    "alpha": 1,
}
#: Buffers that guide what filters a single frame.
GUIDES = ("albedo", "normal")
#: Buffers that tell of the surfaces that are seen.
SURFACES = (*GUIDES, "depth")
#: Samples a pixel that a frame may have; more is taken for a mistake.
MOST_SAMPLES = 1e9


@dataclass(frozen=True, kw_only=True, eq=False)
class Frame:
    """One frame of a render: arrays of ``(height, width, channels)``, row 0 at the top.

    float16 or float32 arrays are taken as they are (other real types are converted);
    they are kept as C-order float32 and never changed.

    Parameters
    ----------
    color : (h, w, 3) or (h, w, 4)
        Noisy scene-linear radiance; may hold NaN, infinities and negatives. A fourth channel is
        taken for ``alpha``.
    albedo : (h, w, 3), optional
        Surface colour in [0, 1]; 0 where nothing was hit.
    normal : (h, w, 3), optional
        Unit shading normal in any fixed space; 0 where nothing was hit.
    depth : (h, w), optional
        Camera z or distance in any unit; 0 or infinity where nothing was hit.
    motion : (h, w, 2), optional
        Pixels, x right and y down: where this point was in the previous frame minus where it
        is now.
    color_b : (h, w, 3), optional
        A second, independent estimate of color.
    jitter : (2,), optional
        Where samples lie in their pixels, of which the camera's sub-pixel offset is the cause:
        pixels from the centre, x right and y down, in [-1, 1]. Models that enlarge look at it.
    roughness : (h, w), optional
        GGX alpha in [0, 1]: 0 smooth, 1 matte.
    specular_albedo : (h, w, 3), optional
        Part of the light that glossy and smooth lobes send on, in [0, 1].
    samples : number or (h, w), optional
        Samples a pixel that color is the mean of: one number above 0, or a map where they differ,
        as with adaptive sampling. A pixel of 0 samples carries nothing: its color is not looked
        at. NaN in a map counts as the mean of the others.
    filter_spread : number, optional
        Standard deviation of the renderer's pixel filter, in pixels, see
        `stillray.pixel_filter.filter_spread`: 0.29 of a box, 0.42 of Blender's usual one. It says
        how far a glint or a bright edge reaches. Where it is not given, models for stills look
        whether neighbouring pixels share their noise (`stillray.stages.shared_noise`).
    alpha : (h, w), optional
        What the picture covers, in [0, 1], handed over with the clean picture; may hold NaN and
        infinities. Color is filtered as it is, so that it should be multiplied by it, as renderers
        give it.
    clean_features
        Whether albedo has no noise, of many samples or denoised before: it is then taken as it is.

    Raises
    ------
    InputError
        An array has a wrong shape or type, ``samples`` holds what no count can be, or
        ``filter_spread`` what no filter has.
    """

    color: np.ndarray
    albedo: np.ndarray | None = None
    normal: np.ndarray | None = None
    depth: np.ndarray | None = None
    motion: np.ndarray | None = None
    color_b: np.ndarray | None = None
    jitter: np.ndarray | None = None
    samples: float | np.ndarray | None = None
    filter_spread: float | None = None
    roughness: np.ndarray | None = None
    specular_albedo: np.ndarray | None = None
    alpha: np.ndarray | None = None
    clean_features: bool = False

    def __post_init__(self) -> None:
        color = np.asarray(self.color)
        if color.ndim == 3 and color.shape[2] == 4 and self.alpha is None:
            object.__setattr__(self, "alpha", color[..., 3])
            color = color[..., :3]
        color = _as_float32("color", color)
        if color.ndim != 3 or color.shape[2] != 3 or 0 in color.shape:
            raise InputError(f"color must have shape (height, width, 3 or 4), got {color.shape}")
        object.__setattr__(self, "color", color)
        height, width = color.shape[:2]
        for name, channels in _CHANNELS.items():
            value = getattr(self, name)
            if name == "color" or value is None or (name == "samples" and np.ndim(value) == 0):
                continue
            array = _as_float32(name, value)
            expected = (height, width) if channels == 1 else (height, width, channels)
            if channels == 1 and array.shape == (height, width, 1):
                array = array[..., 0]
            if array.shape != expected:
                raise InputError(f"{name} must have shape {expected} like color, got {array.shape}")
            object.__setattr__(self, name, array)
        if self.samples is not None:
            check_samples(self.samples)
            if np.ndim(self.samples) == 0:
                object.__setattr__(self, "samples", float(self.samples))
        if not isinstance(self.clean_features, bool):
            raise InputError(f"clean_features must be True or False, got {self.clean_features!r}")
        if self.filter_spread is not None:
            object.__setattr__(self, "filter_spread", check_spread(self.filter_spread))
        if self.jitter is not None:
            jitter = _as_float32("jitter", self.jitter)
            if jitter.shape != (2,):
                raise InputError(f"jitter must have shape (2,), got {jitter.shape}")
            if not (np.abs(jitter) <= 1).all():  # NaN is not
                raise InputError(f"jitter must be -1 to 1 pixels, got {jitter.tolist()}")
            object.__setattr__(self, "jitter", jitter)

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width in pixels."""
        height, width = self.color.shape[:2]
        return height, width

    @property
    def given(self) -> frozenset[str]:
        """Names of the buffers that this frame holds."""
        names = {f.name for f in fields(self)} - {"clean_features"}
        return frozenset(name for name in names if getattr(self, name) is not None)

    @property
    def guided(self) -> bool:
        """Whether it has any of `GUIDES`."""
        return not self.given.isdisjoint(GUIDES)

    def without(self, names: Iterable[str]) -> Frame:
        """The same frame without some of its optional buffers."""
        left: dict[str, Any] = dict.fromkeys(self.given.intersection(names))
        return replace(self, **left) if left else self

    def for_inputs(self, names: Collection[str]) -> Frame:
        """The same without what tells of surfaces, but for the buffers that a model takes."""
        return self.without(name for name in SURFACES if name not in names)

    @property
    def channels(self) -> int:
        """Numbers a pixel of all buffers that this frame holds."""
        return sum(
            channels
            for name, channels in _CHANNELS.items()
            if np.ndim(getattr(self, name)) > 1  # not None, nor one count for all pixels
        )


def check_samples(samples: float | np.ndarray) -> None:
    """Raise `InputError` where a number or a map of samples a pixel cannot be that."""
    array = np.asarray(samples)
    if array.ndim == 0:
        if array.dtype.kind not in "fiu" or not 0 < array <= MOST_SAMPLES:
            raise InputError(
                f"samples must be a number above 0, {MOST_SAMPLES:g} at most, got {samples!r}"
            )
        return
    wrong = (array < 0) | (array > MOST_SAMPLES)  # NaN is neither
    if wrong.any():
        row, column = np.argwhere(wrong)[0][:2]
        raise InputError(
            f"samples must be 0 to {MOST_SAMPLES:g} in every pixel, got "
            f"{array[row, column]:g} at row {row}, column {column}"
        )


def _as_float32(name: str, value: object) -> np.ndarray:
    array = np.asarray(value)
    if array.dtype.kind not in "fiu":
        what = array.dtype if isinstance(value, np.ndarray | list | tuple) else type(value).__name__
        raise InputError(f"{name} must be an array of floats or integers, got {what}")
    with np.errstate(over="ignore"):  # a float64 beyond the range becomes Inf, which is repaired
        return np.ascontiguousarray(array, dtype=np.float32)
