"""A denoiser in the shape of Mitsuba's `OptixDenoiser`, which exists on CUDA only, for any machine.

Mitsuba is not imported: results are made of the types of what is given.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from types import TracebackType
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.models.registry import ModelInfo
from stillray.pipeline.denoiser import Denoiser as _Stream
from stillray.pixel_filter import check_spread

#: Flow of points that were behind the camera: pixels, beyond every picture.
FAR = 1e6
_ROWS = 16  # compared at once


class Denoiser:
    """Denoises what Mitsuba renders, by the arguments of its `OptixDenoiser`.

    Parameters
    ----------
    input_size
        Width and height, pixels.
    albedo, normals
        Whether these will be given; what is given without having been announced is not used.
    temporal
        Whether pictures are frames of a sequence, and ``flow`` will be given. The past is kept
        here; see ``previous_denoised`` for a new sequence.
    denoise_alpha
        Whether a fourth channel is filtered as the colors are, or kept as it is.
    filter_spread
        Standard deviation of the film's reconstruction filter, in pixels: Mitsuba's Gaussian has
        0.5 unless told otherwise, its box 0.29. None: not known.
    model, threads
        As `stillray.Denoiser` takes them.

    Attributes
    ----------
    stream
        The `stillray.Denoiser` that does the work: the times of its stages, its state.

    Raises
    ------
    InputError
        An argument cannot be used.

    Examples
    --------
    >>> denoiser = stillray.mitsuba.Denoiser(film.size(), albedo=True)  # doctest: +SKIP
    >>> clean = denoiser(noisy, albedo=albedo)  # doctest: +SKIP
    """

    def __init__(
        self,
        input_size: Sequence[int],
        albedo: bool = False,
        normals: bool = False,
        temporal: bool = False,
        denoise_alpha: bool = False,
        *,
        filter_spread: float | None = None,
        model: str | os.PathLike[str] | ModelInfo = "high",
        threads: int | None = None,
    ) -> None:
        width, height = (int(extent) for extent in input_size)
        if width < 1 or height < 1:
            raise InputError(f"input_size must be a width and a height, got {width}, {height}")
        self._shape = (height, width)
        self._filter_spread = None if filter_spread is None else check_spread(filter_spread)
        self._albedo, self._normals = albedo, normals
        self._temporal, self._denoise_alpha = temporal, denoise_alpha
        self._motion = np.empty((height, width, 2 if temporal else 0), np.float32)
        self.stream = _Stream(model, threads=threads, temporal=temporal)

    def __call__(
        self,
        noisy: Any,
        albedo: Any = None,
        normals: Any = None,
        to_sensor: Any = None,
        flow: Any = None,
        previous_denoised: Any = None,
        **channels: str,
    ) -> Any:
        """Denoise a picture: tensors, or a multichannel Bitmap and the names of its layers.

        Parameters
        ----------
        noisy : (h, w, 3) or (h, w, 4)
            A tensor or array of radiance; or a Bitmap.
        albedo : (h, w, 3)
            In [0, 1].
        normals : (h, w, 3)
            Unit vectors in a space that does not move with the camera, as `sh_normal` has them.
        to_sensor
            Taken and not applied: normals of any space do, and in the camera's own the past
            could not be compared with the present.
        flow : (h, w, 2)
            Pixels, x right and y down: where a point is now minus where it was, see `flow`.
        previous_denoised : (h, w, 3) or (h, w, 4)
            If it is ``noisy``, as is usual for a first frame, a new sequence begins. Else it is
            not used: the past is kept here.
        channels
            Of a Bitmap, the names of its layers: ``albedo_ch``, ``normals_ch``, ``flow_ch``,
            ``previous_denoised_ch`` and ``noisy_ch``; the fifth is ``"<root>"`` unless given, the
            others may also stand where the tensors would.

        Returns
        -------
        (h, w, 3) or (h, w, 4)
            As many channels as ``noisy``, of its type.

        Raises
        ------
        InputError
            Something is missing, or has another size.
        """
        given = {
            "albedo": albedo, "normals": normals, "flow": flow,
            "previous_denoised": previous_denoised,
        }  # fmt: skip
        if not hasattr(noisy, "split"):
            if channels:
                raise InputError(f"{next(iter(channels))} must be given with a Bitmap only")
            picture = _array(noisy)
            arrays = {n: _array(v) for n, v in given.items() if v is not None}
        else:
            picture, arrays = _layers_of(noisy, given, channels)
        clean = self._denoise(picture, arrays)
        return clean if isinstance(noisy, np.ndarray) else type(noisy)(clean)

    def reset(self) -> None:
        """Begin a new sequence."""
        self.stream.reset()

    def close(self) -> None:
        """Stop the threads."""
        self.stream.close()

    def __enter__(self) -> Denoiser:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _denoise(self, picture: np.ndarray, arrays: dict[str, np.ndarray]) -> np.ndarray:
        if picture.shape not in ((*self._shape, 3), (*self._shape, 4)):
            raise InputError(
                f"noisy must have shape {(*self._shape, 3)} or 4 channels, got {picture.shape}"
            )
        buffers: dict[str, Any] = {}
        for name, buffer, wanted in (
            ("albedo", "albedo", self._albedo),
            ("normals", "normal", self._normals),
            ("flow", "motion", self._temporal),
        ):
            if wanted and name not in arrays:
                raise InputError(f"{name} must be given: the denoiser was made for it")
            if wanted:
                buffers[buffer] = arrays[name] if name != "flow" else self._motion_of(arrays[name])
        before = arrays.get("previous_denoised")
        if before is not None and _equal(before, picture):
            self.stream.reset()
        denoise_alpha = self._denoise_alpha and picture.shape[2] == 4
        frame = Frame(color=picture, filter_spread=self._filter_spread, **buffers)
        return self.stream.denoise(frame, denoise_alpha=denoise_alpha)

    def _motion_of(self, flow: np.ndarray) -> np.ndarray:
        """The negative of it, in memory that is used frame after frame."""
        if flow.shape != self._motion.shape:
            raise InputError(f"flow must have shape {self._motion.shape}, got {flow.shape}")
        return np.negative(flow, out=self._motion, casting="same_kind")


def flow(position: Any, camera_before: Any, camera_now: Any) -> np.ndarray:
    """Flow of things that stand still, from where they are and how the camera moved.

    Parameters
    ----------
    position : (h, w, 3)
        World space, as the integrator `aov` gives ``position``; exactly 0 where nothing was hit,
        which is taken for infinitely far away.
    camera_before, camera_now
        Perspective sensors; or matrices (4, 4) from world space to the picture, whose x and y,
        divided by w, are 0 to 1 from left to right and from top to bottom.

    Returns
    -------
    (h, w, 2) float32
        Pixels, x right and y down: now minus before; `FAR` where a point was behind the camera.
        For `stillray.Frame`, motion is the negative of it.

    Raises
    ------
    InputError
        The position has another shape, or a camera is none.
    """
    points = _array(position).astype(np.float64)
    if points.ndim != 3 or points.shape[2] != 3:
        raise InputError(f"position must have shape (height, width, 3), got {points.shape}")
    height, width = points.shape[:2]
    before, now = (_world_to_picture(camera) for camera in (camera_before, camera_now))
    homogeneous = np.concatenate([points, np.ones((height, width, 1))], axis=2)
    nothing = ~points.any(axis=2)
    if nothing.any():
        # what lies behind a pixel's middle: a direction is a point with w = 0
        y, x = np.nonzero(nothing)
        seen = np.stack([(x + 0.5) / width, (y + 0.5) / height, np.ones(len(x))], axis=1)
        # x, y and w of directions alone, where depth and the camera's place play no part
        homogeneous[nothing, :3] = seen @ np.linalg.inv(now[np.ix_([0, 1, 3], [0, 1, 2])]).T
        homogeneous[nothing, 3] = 0
    size = np.array([width, height])
    pixels = []
    for matrix in (now, before):
        placed = homogeneous @ matrix.T
        ahead = placed[..., 3:] > 0
        at = placed[..., :2] / np.where(ahead, placed[..., 3:], 1) * size
        pixels.append(np.where(ahead, at, np.nan))
    moved = pixels[0] - pixels[1]
    return np.where(np.isfinite(moved), moved, FAR).astype(np.float32)


def _world_to_picture(camera: Any) -> np.ndarray:
    if not hasattr(camera, "projection_transform"):
        matrix = _array(camera).astype(np.float64)
        if matrix.shape != (4, 4):
            raise InputError(f"a camera must be a sensor or a (4, 4) matrix, got {matrix.shape}")
        return matrix
    to_picture = _matrix(camera.projection_transform()) @ np.linalg.inv(
        _matrix(camera.world_transform())
    )
    return _principal_point(camera) @ to_picture


def _principal_point(camera: Any) -> np.ndarray:
    """The shift of the picture that a sensor's projection leaves out."""
    parameters = sys.modules["mitsuba"].traverse(camera)
    film = (
        np.array(parameters["film.size"]).ravel() / np.array(parameters["film.crop_size"]).ravel()
    )
    shift = np.eye(4)
    for axis, name in enumerate("xy"):
        key = f"principal_point_offset_{name}"
        if key in parameters:
            shift[axis, 3] = -float(np.ravel(parameters[key])[0]) * film[axis]
    return shift


def _matrix(transform: Any) -> np.ndarray:
    # vectorised variants give (4, 4, 1)
    return np.asarray(transform.matrix, np.float64).reshape(4, 4)


def _array(value: Any) -> np.ndarray:
    array = np.asarray(value)
    return array if array.dtype.kind == "f" else array.astype(np.float32)


def _equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two pictures are, NaN too: rows by rows, as the first one mostly tells them apart."""
    return one.shape == other.shape and all(
        np.array_equal(one[rows], other[rows], equal_nan=True)
        for rows in (slice(1), *(slice(y, y + _ROWS) for y in range(1, len(one), _ROWS)))
    )


def _layers_of(
    bitmap: Any, given: dict[str, Any], channels: dict[str, str]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The noisy picture and the other layers of a Bitmap, by name."""
    names = {name: value for name, value in given.items() if value}
    names["noisy"] = "<root>"
    for key, layer in channels.items():
        if key.removesuffix("_ch") not in (*given, "noisy") or not key.endswith("_ch"):
            raise InputError(f"{key} is no argument of a denoiser")
        if layer:
            names[key.removesuffix("_ch")] = layer
    layers = dict(bitmap.split())
    for name, layer in names.items():
        if not isinstance(layer, str):
            raise InputError(f"{name} must be the name of a layer of the Bitmap, got {type(layer)}")
        if layer not in layers:
            raise InputError(f"{name} must be a layer of the Bitmap: {layer} is not in {[*layers]}")
    arrays = {name: _array(layers[layer]) for name, layer in names.items()}
    if "flow" in arrays:
        arrays["flow"] = arrays["flow"][..., :2]
    return arrays.pop("noisy"), arrays
