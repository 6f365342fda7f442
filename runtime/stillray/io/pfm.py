"""Portable float maps: PFM (32-bit) and PHM (16-bit), which render tools hand to denoisers.

A header of three words (kind, size, scale), then rows from the bottom up. The sign of the scale
gives the order of bytes, its size what values are multiplied by. OpenCV divides by it, and
OpenImageIO gives the rows upside down, so they are read here.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.io.atomic import atomic_path

#: Suffixes of the files that are read and written here.
SUFFIXES = (".pfm", ".phm")
# kind, width, height, scale, each after white space, and one white space before the pixels
_HEADER = re.compile(rb"P([FfHh])\s+(\d{1,9})\s+(\d{1,9})\s+([-+.\deE]{1,40})\s")
_HEADER_BYTES = 256  # more than any header takes


def read_pfm(path: str | os.PathLike[str]) -> np.ndarray:
    """Read a PFM or PHM file, of either order of bytes.

    Returns
    -------
    (h, w, 3) or, of grey files, (h, w, 1) float32
        Row 0 at the top; NaN and infinities as they are stored.

    Raises
    ------
    InputError
        There is no such file, it is no float map, or its size is not what its header says.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None
    header = _HEADER.match(data[:_HEADER_BYTES])
    if header is None:
        raise InputError(f"{path}: must be a float map, PF, Pf, PH or Ph, got {data[:16]!r}")
    kind = header[1]
    width, height = int(header[2]), int(header[3])
    try:
        scale = float(header[4])
    except ValueError:
        scale = 0.0
    if not np.isfinite(scale) or scale == 0:
        raise InputError(f"{path}: its scale must be a number other than 0, got {header[4]!r}")
    channels = 3 if kind.isupper() else 1
    stored = np.dtype("f4" if kind in b"Ff" else "f2").newbyteorder("<" if scale < 0 else ">")
    wanted = width * height * channels * stored.itemsize
    if wanted == 0 or len(data) - header.end() != wanted:
        raise InputError(
            f"{path}: {width} x {height} pixels must take {wanted} bytes, more than 0, got "
            f"{len(data) - header.end()}"
        )
    pixels = np.frombuffer(data, stored, offset=header.end()).reshape(height, width, channels)
    image = np.ascontiguousarray(pixels[::-1], np.float32)
    if abs(scale) != 1:
        image *= np.float32(abs(scale))
    return image


def write_pfm(path: str | os.PathLike[str], image: np.ndarray) -> None:
    """Write a float map, little-endian, complete or not at all.

    Parameters
    ----------
    path
        With ``.phm`` as its suffix, half precision is written: beyond 65504 values are clamped.
    image : (h, w, 3) or (h, w, 1) float
        Row 0 at the top.

    Raises
    ------
    InputError
        The picture has another shape, or the file cannot be written.
    """
    path = Path(path)
    image = np.asarray(image)
    if image.ndim != 3 or image.shape[2] not in (1, 3) or 0 in image.shape:
        raise InputError(f"image must have shape (height, width, 3 or 1), got {image.shape}")
    height, width, channels = image.shape
    half = path.suffix.lower() == ".phm"
    kind = ("H" if half else "F") if channels == 3 else ("h" if half else "f")
    if half:
        limit = float(np.finfo(np.float16).max)
        image = np.clip(image, -limit, limit)
    pixels = np.ascontiguousarray(image[::-1], "<f2" if half else "<f4")
    with atomic_path(path) as temporary:
        temporary.write_bytes(f"P{kind}\n{width} {height}\n-1.0\n".encode() + pixels.tobytes())
