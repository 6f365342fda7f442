"""One image in a file: PFM, PHM, or EXR."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.io.channels.roles import find_alone, gather
from stillray.io.exr.file import ExrFile
from stillray.io.exr.read import read_exr
from stillray.io.exr.write import write_color
from stillray.io.pfm import SUFFIXES as FLOAT_MAPS
from stillray.io.pfm import read_pfm, write_pfm

SUFFIXES = (*FLOAT_MAPS, ".exr")


def is_float_map(path: str | os.PathLike[str]) -> bool:
    """Whether a file is named as a PFM or PHM is."""
    return Path(path).suffix.lower() in FLOAT_MAPS


def kind_of_map(path: str | os.PathLike[str]) -> str:
    """The numbers of a float map, as EXR calls them: ``"half"`` of a PHM, ``"float"`` of a PFM."""
    return "half" if Path(path).suffix.lower() == ".phm" else "float"


def check_suffix(path: Path) -> Path:
    """The path, if its suffix is that of a file that can be read and written.

    Raises
    ------
    InputError
        It is another.
    """
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: must be a {', '.join(SUFFIXES)} file")
    return path


def read_image(path: Path, role: str) -> np.ndarray:
    """Read one buffer from a file: ``(h, w, 3 or 1)`` float32, ``(h, w)`` depth of EXR.

    Parameters
    ----------
    path
        A float map, or an EXR file that holds the buffer under a known name or as plain R, G, B.
    role
        ``"color"``, ``"albedo"``, ``"normal"``, ``"depth"`` or ``"motion"``; a float map holds
        whatever it is taken for.

    Raises
    ------
    InputError
        The file cannot be read, or holds no such image.
    """
    if is_float_map(check_suffix(path)):
        return read_pfm(path)
    if role == "color":
        return read_exr(path).color
    file = ExrFile.open(path)
    match = find_alone(role, list(file.channels), None)
    if match is None:
        raise InputError(f"{path}: must hold {role} channels, got {', '.join(file.channels)}")
    return gather(match, file.read(match.channels))


def write_image(path: Path, image: np.ndarray, *, like: Path | None = None) -> None:
    """Write a picture, complete or not at all.

    EXR has the windows, the tags and the type of ``like``, of which a float map has the type alone;
    half without.

    Raises
    ------
    InputError
        The file cannot be written.
    """
    if is_float_map(check_suffix(path)):
        write_pfm(path, image)
        return
    image = np.broadcast_to(image, (*image.shape[:2], 3))
    if like is not None and is_float_map(like):
        write_color(path, image, kind=kind_of_map(like))
    else:
        write_color(path, image, like=like)
