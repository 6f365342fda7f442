"""In what numbers a network computes: 32-bit floats, or integers of 8 bits where that is faster.

Models may come with a second file of their network, ``NAME.int8.onnx``, whose convolutions are of
8-bit integers (`stillray_export.quantize`). It runs on processors that multiply them many at once:
four a sum with AVX-512 VNNI, two with AVX2, where its weights keep sums small enough
(`stillray.models.small_sums`), so that both compute the same; elsewhere it was not measured. With
AVX-512, whose sums are of many columns, ``NAME.int8.pairs.onnx`` is taken where it is there: the
same network to the same integers, but pixels are taken by twos where there are few planes.
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

#: Of the files of a model's network in integers: by pixels, and by pairs of pixels.
INT8_SUFFIX, PAIRS_SUFFIX = ".int8", ".int8.pairs"
#: What may be asked for: `chosen` explains.
PRECISIONS = ("auto", "float32", "int8")
_FLOATS_KEY = "stillray.floats"
_DIGEST_BYTES = 16
# OpenCV's numbers of instruction sets; AVX2 is there wherever AVX-512 is
_AVX2, _AVX512_SKX = 11, 256


def int8_path(model: Path) -> Path:
    """The file of a model's network in integers, which may not be there."""
    return model.with_name(f"{model.stem}{INT8_SUFFIX}.onnx")


def pairs_path(model: Path) -> Path:
    """The file of a model's network in integers by pairs of pixels, which may not be there."""
    return model.with_name(f"{model.stem}{PAIRS_SUFFIX}.onnx")


def sums_are_wide() -> bool:
    """Whether this processor has AVX-512, with which pairs of pixels are quicker."""
    return bool(cv2.checkHardwareSupport(_AVX512_SKX))


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
    if sums_are_wide() and pairs_path(model).is_file():
        path = pairs_path(model)
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
