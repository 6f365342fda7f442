"""In what numbers a network computes: 32-bit floats, or integers of 8 bits where that is faster.

Models may come with a second file of their network, ``NAME.int8.onnx``, whose convolutions are of
8-bit integers (`stillray_export.quantize`). It runs on processors that multiply them many at once:
four a sum with AVX-512 VNNI, two with AVX2, where its weights keep sums small enough
(`stillray.models.small_sums`), so that both compute the same; elsewhere it was not measured.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from pathlib import Path

import cv2

from stillray.errors import InputError
from stillray.models.onnx_file import metadata_of, read_bytes
from stillray.models.protobuf import WireError
from stillray.models.session import CPU, Provider, provider_names

INT8_SUFFIX = ".int8"
#: What may be asked for: `chosen` explains.
PRECISIONS = ("auto", "float32", "int8")
_FLOATS_KEY = "stillray.floats"
_DIGEST_BYTES = 16
_AVX2 = 11  # OpenCV's number of that instruction set, which AVX-512 has, too


def int8_path(model: Path) -> Path:
    """The file of a model's network in integers, which may not be there."""
    return model.with_name(f"{model.stem}{INT8_SUFFIX}.onnx")


def multiplies_int8() -> bool:
    """Whether this processor has AVX2 or more, with which such networks were measured."""
    return bool(cv2.checkHardwareSupport(_AVX2))


def floats_of(model: Path) -> dict[str, str]:
    """What a network of integers says of the file that it was made from."""
    digest = hashlib.blake2b(read_bytes(model), digest_size=_DIGEST_BYTES).hexdigest()
    return {_FLOATS_KEY: digest}


def chosen(model: Path, precision: str, providers: Sequence[Provider] | None) -> Path:
    """The file of the network that is to run.

    Parameters
    ----------
    model
        The model's file.
    precision
        ``"float32"``; ``"int8"``, wherever that is; ``"auto"``: integers if the model has them and
        nothing but a processor that multiplies them runs the network.
    providers
        Execution providers of ONNX Runtime, or None for the processor.

    Raises
    ------
    InputError
        Another precision, or integers of a model that has none; or they were made of another file
        than the one that they lie beside.
    """
    if precision not in PRECISIONS:
        raise InputError(f"precision must be one of {', '.join(PRECISIONS)}, got {precision}")
    path = int8_path(model)
    here = provider_names(providers) == [CPU] and multiplies_int8()
    if precision == "float32" or (precision == "auto" and not (here and path.is_file())):
        return model
    if not path.is_file():
        raise InputError(f"precision must be float32 of {model.stem}, which has no {path.name}")
    try:
        told = metadata_of(read_bytes(path))
    except WireError as error:
        raise InputError(f"{path}: not a usable ONNX model: {error}") from None
    if told.get(_FLOATS_KEY) != floats_of(model)[_FLOATS_KEY]:
        raise InputError(
            f"{path}: must be made of the file {model.name} beside it, is of another: make it "
            f"anew (python -m stillray_export.quantize), or take it away"
        )
    return path
