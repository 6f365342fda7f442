"""In what numbers a network computes: 32-bit floats, or integers of 8 bits where that is faster.

Models may come with another file of their network, ``NAME.int8.onnx``, whose convolutions are of
8-bit integers (`stillray_export.quantize`). It runs on processors that multiply them many at once:
four a sum with VNNI, two with AVX2 or AVX-512 alone, where its weights keep sums small enough
(`stillray.models.small_sums`), so that all compute the same; elsewhere it was not measured. With
AVX-512, whose products are of many columns, ``NAME.int8.pairs.onnx`` runs in its place if it was
made of it: the same network to the same integers, but pixels are taken by twos where there are few
planes.
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
_SOURCE_KEY = "stillray.floats"  # of pairs it tells the file by pixels
_DIGEST_BYTES = 16
# OpenCV's numbers of instruction sets; AVX2 is there wherever AVX-512 is
_AVX2, _AVX512_VNNI, _AVX512_SKX = 11, 23, 256


def int8_path(model: Path) -> Path:
    """The file of a model's network in integers, which may not be there."""
    return model.with_name(f"{model.stem}{INT8_SUFFIX}.onnx")


def pairs_path(model: Path) -> Path:
    """The file of the same network by pairs of pixels, which may not be there."""
    return model.with_name(f"{model.stem}{PAIRS_SUFFIX}.onnx")


def pairs_are_quicker() -> bool:
    """Whether this processor has AVX-512."""
    return bool(cv2.checkHardwareSupport(_AVX512_SKX))


def integers_a_float() -> int:
    """How many integers of 8 bits this processor multiplies in the time of a float."""
    return 4 if cv2.checkHardwareSupport(_AVX512_VNNI) else 2


def multiplies_int8() -> bool:
    """Whether this processor has AVX2 or more, with which such networks were measured."""
    return bool(cv2.checkHardwareSupport(_AVX2))


def made_of(source: bytes) -> dict[str, str]:
    """What a network of integers says of the file that it was made of.

    Parameters
    ----------
    source
        Of the network of floats; of pairs of pixels, that of integers by pixels.
    """
    return {_SOURCE_KEY: hashlib.blake2b(source, digest_size=_DIGEST_BYTES).hexdigest()}


def is_made_of(path: Path, source: Path) -> bool:
    """Whether a network of integers says that it was made of a file.

    Raises
    ------
    InputError
        It is no ONNX file.
    """
    try:
        told = metadata_of(read_bytes(path))
    except WireError as error:
        raise InputError(f"{path}: not a usable ONNX model: {error}") from None
    return made_of(read_bytes(source)).items() <= told.items()


def quickest(network: Path) -> Path:
    """The file that gives what the network of a file does and is quickest here.

    Parameters
    ----------
    network
        From `chosen`, which also names what pictures depend on: the same on every processor.
    """
    if not network.stem.endswith(INT8_SUFFIX) or not pairs_are_quicker():
        return network
    pairs = pairs_path(network.with_name(f"{network.stem.removesuffix(INT8_SUFFIX)}.onnx"))
    return pairs if pairs.is_file() and is_made_of(pairs, network) else network


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
    if not is_made_of(path, model):
        raise InputError(
            f"{path}: must be made of the file {model.name} beside it, is of another: make it "
            f"anew (python -m stillray_export.quantize {model.stem} --data SEQUENCES), or take it "
            f"away"
        )
    return path
