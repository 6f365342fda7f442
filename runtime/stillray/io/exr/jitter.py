"""Where a frame's samples lie in their pixels, as its file says."""

from __future__ import annotations

import struct

import numpy as np

from stillray.errors import InputError
from stillray.io.exr.file import ExrFile

#: The attribute that says it: a V2f, or text of two numbers, as `stillray.Frame` takes them.
JITTER_ATTRIBUTE = "stillray:jitter"


def find_jitter(file: ExrFile) -> np.ndarray | None:
    """The jitter of a frame, ``(2,)`` pixels, x right and y down; None where nothing is said.

    Raises
    ------
    InputError
        The attribute holds something else than two numbers.
    """
    for part in file.container.parts:
        for attribute in part.attributes:
            if attribute.name != JITTER_ATTRIBUTE:
                continue
            try:
                if attribute.kind == "v2f":
                    return np.array(struct.unpack("<2f", attribute.value), np.float32)
                x, y = attribute.value.decode().split()
                return np.array([float(x), float(y)], np.float32)
            except (ValueError, struct.error):
                value = attribute.value[:32].decode("utf-8", "replace")
                raise InputError(
                    f"{file.path}: {JITTER_ATTRIBUTE} must be two numbers, got {value!r}"
                ) from None
    return None


def jitter_text(jitter: np.ndarray) -> str:
    """A jitter as `JITTER_ATTRIBUTE` holds it."""
    x, y = (float(value) for value in jitter)
    return f"{x:.9g} {y:.9g}"
