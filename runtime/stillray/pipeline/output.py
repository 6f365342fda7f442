"""Pictures into arrays of the caller's, of any float type and any strides."""

from __future__ import annotations

import numpy as np

from stillray.errors import InputError


def check_output(out: np.ndarray, shape: tuple[int, int]) -> None:
    """Whether a picture of that height and width can be put there.

    Raises
    ------
    InputError
        It is no writable array of floats of ``(height, width, 3)``.
    """
    if not isinstance(out, np.ndarray) or out.dtype.kind != "f" or not out.flags.writeable:
        kind = getattr(out, "dtype", type(out))
        raise InputError(f"out must be a writable array of floats, got {kind}")
    if out.shape != (*shape, 3):
        raise InputError(f"out must have shape {(*shape, 3)} like color, got {out.shape}")


def put(image: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Copy a picture to where `check_output` said it fits; never infinite in half precision."""
    if out.dtype == np.float16:
        image = np.minimum(image, np.float32(np.finfo(np.float16).max))
    np.copyto(out, image, casting="same_kind")
    return out
