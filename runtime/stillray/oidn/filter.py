"""A filter of Open Image Denoise's interface: images and parameters by name, then `execute`."""

from __future__ import annotations

import warnings
from types import TracebackType
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.oidn import constants
from stillray.oidn.buffer import Buffer
from stillray.oidn.device import Device
from stillray.oidn.filtering import FILTER_TYPES, Parameters
from stillray.oidn.memory import FORMATS, array_of, bytes_of, image_in

IMAGES = (
    constants.OIDN_IMAGE_COLOR,
    constants.OIDN_IMAGE_ALBEDO,
    constants.OIDN_IMAGE_NORMAL,
    constants.OIDN_IMAGE_OUTPUT,
)


class Filter:
    """Denoises one image, as often as it is told to.

    Parameters
    ----------
    device
        Where it runs.
    filter_type
        ``"RT"``, or ``"RTLightmap"``, whose color is HDR.

    Raises
    ------
    InputError
        There is no such type.
    """

    def __init__(self, device: Device, filter_type: str = constants.OIDN_FILTER_TYPE_RT) -> None:
        if filter_type not in FILTER_TYPES:
            raise InputError(f"filter_type must be {' or '.join(FILTER_TYPES)}, got {filter_type}")
        self._device = device
        self._type = filter_type
        self._images: dict[str, np.ndarray] = {}
        self._values: dict[str, bool | int | float] = {
            "hdr": False,
            "srgb": False,
            "directional": False,
            "cleanAux": False,
            "inputScale": float("nan"),
            "quality": constants.OIDN_QUALITY_DEFAULT,
            "maxMemoryMB": -1,
        }
        self._committed: Parameters | None = None
        self._released = False

    def set_image(
        self,
        name: str,
        data: Any,
        data_format: int,
        width: int = -1,
        height: int = -1,
        byte_offset: int = 0,
        pixel_byte_stride: int = 0,
        row_byte_stride: int = 0,
    ) -> None:
        """Say where an image lies: it is read, or written, when the filter runs.

        Parameters
        ----------
        name
            ``OIDN_IMAGE_COLOR``, ``ALBEDO``, ``NORMAL`` or ``OUTPUT``.
        data
            A contiguous NumPy array, a tensor of the host, or a `Buffer`.
        data_format
            ``OIDN_FORMAT_FLOAT3``, ``HALF3``, or ``FLOAT``, ``HALF`` of one channel.
        width, height
            Pixels; of an array, its own where negative.
        byte_offset, pixel_byte_stride, row_byte_stride
            Bytes before the first pixel, from pixel to pixel and row to row; 0 for packed.

        Raises
        ------
        InputError
            No such image or format, or it does not lie in the memory.
        TypeError
            The data are none of these.
        """
        if name not in IMAGES:
            raise InputError(f"name must be one of {', '.join(IMAGES)}, got {name}")
        if isinstance(data, Buffer):
            memory = data._bytes
        else:
            array = array_of(name, data)
            kind, _ = FORMATS.get(data_format, (array.dtype, 0))
            if array.dtype.kind == "f" and array.dtype != kind:
                raise InputError(
                    f"{name} must be {np.dtype(kind)} for its format, got {array.dtype}"
                )
            if array.ndim >= 2:
                width = array.shape[1] if width < 0 else width
                height = array.shape[0] if height < 0 else height
            memory = bytes_of(name, array)
        image = image_in(
            memory,
            data_format,
            (height, width),
            offset=byte_offset,
            pixel_stride=pixel_byte_stride,
            row_stride=row_byte_stride,
        )
        if name == constants.OIDN_IMAGE_OUTPUT and not image.flags.writeable:
            raise InputError("output must be writable")
        self._images[name] = image
        self._committed = None

    def unset_image(self, name: str) -> None:
        """Forget an image."""
        self._images.pop(name, None)
        self._committed = None

    def get_bool(self, name: str) -> bool:
        """A boolean parameter: hdr, srgb, directional, cleanAux."""
        return bool(self._get(name))

    def get_int(self, name: str) -> int:
        """An integer parameter: quality, maxMemoryMB."""
        return int(self._get(name))

    def get_float(self, name: str) -> float:
        """A float parameter: inputScale."""
        return float(self._get(name))

    def set_bool(self, name: str, value: bool) -> None:
        """Set a boolean parameter."""
        self._set(name, bool(value))

    def set_int(self, name: str, value: int) -> None:
        """Set an integer parameter."""
        self._set(name, int(value))

    def set_float(self, name: str, value: float) -> None:
        """Set a float parameter; ``inputScale`` changes nothing here, exposure is found."""
        self._set(name, float(value))

    def set_value(self, k: str, value: bool | int | float) -> None:
        """Set a parameter of whatever type it has.

        Raises
        ------
        TypeError
            The value is no number.
        """
        if not isinstance(value, bool | int | float):
            raise TypeError(f"value must be a bool, an int or a float, got {type(value)}")
        self._set(k, value)

    def set_quality(self, quality: int) -> None:
        """Set ``OIDN_QUALITY_*``: which model is used.

        Raises
        ------
        InputError
            There is no such quality.
        """
        if quality not in constants.QUALITY_NAMES:
            raise InputError(f"quality must be an OIDN_QUALITY_* value, got {quality}")
        self._set("quality", quality)

    def commit(self) -> None:
        """Take images and parameters over; needed before the filter runs, and after a change."""
        self._committed = Parameters(
            filter_type=self._type,
            hdr=bool(self._values["hdr"]),
            srgb=bool(self._values["srgb"]),
            directional=bool(self._values["directional"]),
            clean_aux=bool(self._values["cleanAux"]),
            max_memory_mb=int(self._values["maxMemoryMB"]),
        )

    def execute(self) -> None:
        """Denoise, and return when the output is there; errors go to `Device.get_error`."""
        self._device.wait()
        self._run()

    def execute_async(self) -> None:
        """Begin to denoise; the output is there when `Device.wait` returns."""
        self._device._later(self._run)

    def release(self) -> None:
        """Let the images go. May be called again."""
        self._images.clear()
        self._released = True

    def __enter__(self) -> Filter:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    def _run(self) -> None:
        inputs = dict(self._images)
        output = inputs.pop(constants.OIDN_IMAGE_OUTPUT, None)
        if self._released:
            self._device._fail("the filter is released")
        elif self._committed is None:
            self._device._fail("changes to the filter are not committed")
        elif output is None:
            self._device._fail("output must be set")
        else:
            quality = constants.QUALITY_NAMES[int(self._values["quality"])]
            self._device._run(inputs, output, self._committed, quality)

    def _get(self, name: str) -> bool | int | float:
        if name not in self._values:
            self._device._fail(f"unknown filter parameter or type mismatch: '{name}'")
            return 0
        return self._values[name]

    def _set(self, name: str, value: bool | int | float) -> None:
        self._committed = None
        if name in self._values:
            self._values[name] = value
        else:
            warnings.warn(f"filter parameter '{name}' is ignored: unknown here", stacklevel=3)
