"""How a picture is handed over: into arrays of the caller's, of any float type and any strides."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import DTypeLike

from stillray.arrays.strips import Strips
from stillray.errors import InputError


@dataclass(frozen=True, eq=False)
class Target:
    """Where a picture goes; made before a frame runs, so that what is wrong is told at once.

    Attributes
    ----------
    out
        The caller's; None for an array of its own.
    dtype
        Of that array.
    """

    out: np.ndarray | None
    dtype: np.dtype

    @classmethod
    def of(
        cls, out: np.ndarray | None, dtype: DTypeLike | None, shape: tuple[int, int, int]
    ) -> Target:
        """The target of pictures of a shape.

        Raises
        ------
        InputError
            ``out`` is no writable array of floats of that shape, the type is none of floats, or
            both are given.
        """
        if out is None:
            return cls(None, _float_type(np.float32 if dtype is None else dtype))
        if dtype is not None:
            raise InputError(f"dtype must not be given with out, got {dtype}")
        if not isinstance(out, np.ndarray) or out.dtype.kind != "f" or not out.flags.writeable:
            kind = getattr(out, "dtype", type(out))
            raise InputError(f"out must be a writable array of floats, got {kind}")
        if out.shape != shape:
            raise InputError(f"out must have shape {shape} like color, got {out.shape}")
        return cls(out, out.dtype)

    def put(self, image: np.ndarray, alpha: np.ndarray | None, strips: Strips) -> np.ndarray:
        """Hand over a picture ``(h, w, 3)`` float32, with alpha ``(h, w)`` behind it if given.

        A picture that fits as it is goes without a copy. Half precision never gets infinite.
        """
        if self.out is None and alpha is None and self.dtype == image.dtype:
            return image
        target = self.out
        if target is None:
            target = np.empty((*image.shape[:2], 3 if alpha is None else 4), self.dtype)
        out, halves = target, self.dtype == np.float16
        most = np.float32(np.finfo(np.float16).max)

        def work(rows: slice) -> None:
            part = image[rows]
            if halves:
                part = np.minimum(part, most)
            np.copyto(out[rows, :, :3], part, casting="same_kind")
            if alpha is not None:
                covers = np.clip(alpha[rows], -most, most) if halves else alpha[rows]
                np.copyto(out[rows, :, 3], covers, casting="same_kind")

        strips.run(work, *image.shape[:2])
        return out


def _float_type(dtype: DTypeLike) -> np.dtype:
    try:
        found = np.dtype(dtype)
    except TypeError:
        found = None
    if found is None or found.kind != "f":
        raise InputError(f"dtype must be a type of floats, got {dtype!r}")
    return found
