"""States of models as files of plain arrays: NumPy's .npz, stored, never pickled.

Whoever opens a state that somebody else saved opens numbers alone: names, types and sizes of the
arrays are checked before any is read.
"""

from __future__ import annotations

import math
import os
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, cast

import numpy as np

from stillray.errors import InputError
from stillray.io.atomic import atomic_path

_MAX_BYTES = 8 * 2**30  # of a file: the past of a frame of 16384 x 8192 pixels
_MAX_ARRAYS = 64


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write arrays by name, complete or not at all.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    with atomic_path(Path(path)) as part, part.open("wb") as file:
        np.savez(file, **cast(dict[str, Any], dict(arrays)))


def read_arrays(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read what `write_arrays` wrote: finite float32 arrays.

    Raises
    ------
    InputError
        The file is missing, or holds anything else.
    """
    source = Path(path)
    try:
        with zipfile.ZipFile(source) as archive:
            entries = archive.infolist()
            size = sum(entry.file_size for entry in entries)
            if len(entries) > _MAX_ARRAYS or size > _MAX_BYTES:
                raise InputError(f"{source}: is too large for a saved state")
            if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
                raise InputError(f"{source}: not a saved state: it is compressed")
            found = {
                entry.filename.removesuffix(".npy"): _array(archive, entry) for entry in entries
            }
    except FileNotFoundError:
        raise InputError(f"{source}: no such file") from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise InputError(f"{source}: not a saved state: {error}") from None
    for name, array in found.items():
        if not np.isfinite(array).all():
            raise InputError(f"{source}: {name} must be finite")
    return found


def _array(archive: zipfile.ZipFile, entry: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(entry) as file:
        version = np.lib.format.read_magic(file)
        if version != (1, 0):
            raise ValueError(f"{entry.filename} is of an unknown version")
        shape, fortran, kind = np.lib.format.read_array_header_1_0(file)
        if kind != np.dtype("<f4") or fortran:
            raise ValueError(f"{entry.filename} must hold float32 in C order")
        data = file.read()
    if len(data) != 4 * math.prod(shape):
        raise ValueError(f"{entry.filename} has not the size that it claims")
    return np.frombuffer(data, "<f4").reshape(shape).copy()
