"""Memory that callers hand over: arrays, tensors, addresses, and images that lie in them."""

from __future__ import annotations

import ctypes
import sys
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.oidn import constants

#: Type and number of channels of the formats of images.
FORMATS: dict[int, tuple[type[np.floating[Any]], int]] = {
    constants.OIDN_FORMAT_FLOAT: (np.float32, 1),
    constants.OIDN_FORMAT_FLOAT3: (np.float32, 3),
    constants.OIDN_FORMAT_HALF: (np.float16, 1),
    constants.OIDN_FORMAT_HALF3: (np.float16, 3),
}


def is_tensor(value: object) -> bool:
    """Whether a value is a tensor of torch, which is not imported for that."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(value, torch.Tensor)


def array_of(name: str, value: Any) -> np.ndarray:
    """A NumPy array, or a tensor of the host as one that shares its memory.

    Raises
    ------
    TypeError
        It is neither, or a tensor of another device.
    """
    if isinstance(value, np.ndarray):
        return value
    if not is_tensor(value):
        raise TypeError(f"{name} must be a NumPy array or a tensor of torch, got {type(value)}")
    if value.device.type != "cpu":
        raise TypeError(f"{name} must lie in the memory of the host, got {value.device}")
    array: np.ndarray = value.detach().numpy()
    return array


def bytes_of(name: str, array: np.ndarray) -> np.ndarray:
    """The bytes of a contiguous array, a view.

    Raises
    ------
    InputError
        The array is not contiguous.
    """
    if array.flags.f_contiguous and not array.flags.c_contiguous:
        array = array.T
    if not array.flags.c_contiguous:
        raise InputError(f"{name} must be contiguous, got strides {array.strides}")
    return array.reshape(-1).view(np.uint8)


def bytes_at(address: Any, size: int) -> np.ndarray:
    """So many bytes at an address, a view; the caller keeps them alive.

    Parameters
    ----------
    address
        An integer, a pointer of ctypes or one of cffi.
    size
        Bytes.
    """
    if size == 0:
        return np.empty(0, np.uint8)
    if not isinstance(address, int):
        if isinstance(address, ctypes.c_void_p):
            address = address.value
        elif "cffi" in sys.modules and type(address).__module__.startswith("_cffi"):
            address = int(sys.modules["cffi"].FFI().cast("uintptr_t", address))
        else:
            address = ctypes.cast(address, ctypes.c_void_p).value
    if not address:
        raise InputError("dev_ptr must be the address of memory, got a null pointer")
    return np.ctypeslib.as_array((ctypes.c_uint8 * size).from_address(address))


def image_in(
    memory: np.ndarray,
    image_format: int,
    size: tuple[int, int],
    *,
    offset: int = 0,
    pixel_stride: int = 0,
    row_stride: int = 0,
) -> np.ndarray:
    """The image that lies in some bytes, a view.

    Parameters
    ----------
    memory : (n,) uint8
    image_format
        ``OIDN_FORMAT_*`` of one or three channels.
    size
        Height and width, pixels.
    offset, pixel_stride, row_stride
        Bytes before the first pixel, and from pixel to pixel and row to row; 0 for packed.

    Returns
    -------
    (h, w, channels) float16 or float32

    Raises
    ------
    InputError
        The format is none that can be filtered, or the image does not lie in the memory.
    """
    if image_format not in FORMATS:
        raise InputError(
            f"data_format must be OIDN_FORMAT_FLOAT, FLOAT3, HALF or HALF3, got {image_format}"
        )
    kind, channels = FORMATS[image_format]
    item = np.dtype(kind).itemsize
    height, width = size
    if height < 1 or width < 1:
        raise InputError(f"width and height must be 1 or more, got {width} x {height}")
    pixel = pixel_stride or item * channels
    row = row_stride or pixel * width
    if offset < 0 or pixel < item * channels or row < pixel * width:
        raise InputError(
            "byte_offset must be 0 or more and strides must hold a pixel and a row, got "
            f"{offset}, {pixel_stride} and {row_stride}"
        )
    end = offset + (height - 1) * row + (width - 1) * pixel + item * channels
    if end > memory.size:
        raise InputError(f"the image must lie within its memory of {memory.size} bytes, ends {end}")
    return np.ndarray((height, width, channels), kind, memory, offset, (row, pixel, item))
