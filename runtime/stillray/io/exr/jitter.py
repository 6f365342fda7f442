"""Where a frame's samples lie in their pixels, as its file says."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np

from stillray.errors import InputError
from stillray.io.channels.roles import JITTER
from stillray.io.exr.container import Attribute
from stillray.io.exr.file import ExrFile

#: The attribute that says it: a V2f, or text of two numbers, as `stillray.Frame` takes them.
JITTER_ATTRIBUTE = "stillray:jitter"


def find_jitter(file: ExrFile, layers: Mapping[str, str] | None = None) -> np.ndarray | None:
    """The jitter of a frame, ``(2,)`` pixels, x right and y down; None where nothing is said.

    Parameters
    ----------
    file
        The file.
    layers
        As it is read with; ``"jitter"`` among them, which can be ``"none"`` alone, leaves the
        attribute out.

    Raises
    ------
    InputError
        The attribute holds something else than two numbers from -1 to 1.
    """
    if (layers or {}).get(JITTER) == "none":
        return None
    for part in file.container.parts:
        for attribute in part.attributes:
            if attribute.name != JITTER_ATTRIBUTE:
                continue
            jitter = _numbers(attribute)
            # as `stillray.Frame` has it; NaN is not
            if jitter is not None and (np.abs(jitter) <= 1).all():
                return jitter.astype(np.float32)
            value = attribute.value[:32].decode("utf-8", "replace")
            if jitter is not None:
                value = jitter_text(jitter)
            raise InputError(
                f"{file.path}: {JITTER_ATTRIBUTE} must be two numbers from -1 to 1, got {value!r}; "
                f"{JITTER}=none leaves it out"
            )
    return None


def _numbers(attribute: Attribute) -> np.ndarray | None:
    """The two numbers of an attribute; None where it holds anything else."""
    try:
        if attribute.kind == "v2f":
            return np.array(struct.unpack("<2f", attribute.value))
        x, y = attribute.value.decode().split()
        return np.array([float(x), float(y)])
    except (ValueError, struct.error):
        return None


def jitter_text(jitter: np.ndarray) -> str:
    """A jitter as `JITTER_ATTRIBUTE` holds it."""
    x, y = (float(value) for value in jitter)
    return f"{x:.9g} {y:.9g}"
