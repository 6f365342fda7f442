"""What made a clean frame, written into its file, so that a finished frame is known by content.

What is claimed: a file whose digest and picture match was made by this version of stillray, with
this model file and these options, from files with these very bytes: those of the frame itself and
of up to so many frames before it as its history is taken to go back. Its color has been read back
and is, to half precision, what was written, unless its source's compression is a lossy one. Not
claimed: that it is equal to the bit to what this machine would make, since a history that began
earlier, and another processor, round differently.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.version import __version__

_DIGEST = "stillray:digest"
_PICTURE = "stillray:picture"
_DIGEST_BYTES = 16
# Compressions that do not give back the picture that they were given.
_LOSSY = ("pxr24", "b44", "b44a", "dwaa", "dwab")


@dataclass(frozen=True, kw_only=True)
class Recipe:
    """What makes a picture, apart from the frames.

    Attributes
    ----------
    model
        Its name.
    model_digest
        Of the file that its network is read from, see `file_digest`.
    options
        All that changes pixels, by name.
    """

    model: str
    model_digest: str
    options: Mapping[str, str | int | float | bool | None] = field(default_factory=dict)
    version: str = __version__

    def digest(self, inputs: Sequence[Mapping[str, str]]) -> str:
        """Digest of a clean frame.

        Parameters
        ----------
        inputs
            Digests of its files by role, last; and of those of the frames before it that its
            history holds, in order.
        """
        whole = {
            "version": self.version,
            "model": self.model_digest,
            "options": dict(self.options),
            "inputs": [dict(files) for files in inputs],
        }
        text = json.dumps(whole, sort_keys=True)
        return hashlib.blake2b(text.encode(), digest_size=_DIGEST_BYTES).hexdigest()

    def attributes(self, digest: str, *pictures: np.ndarray) -> dict[str, str]:
        """What is written into the file of a clean frame.

        Parameters
        ----------
        digest
            From `digest`.
        pictures : (h, w, 3) float32
            The clean frame, in each of its views.
        """
        return {
            "stillray:version": self.version,
            "stillray:model": self.model,
            "stillray:options": json.dumps(dict(self.options), sort_keys=True),
            _DIGEST: digest,
            _PICTURE: picture_digest(*pictures),
        }


def file_digest(path: Path) -> str:
    """BLAKE2b of a file's bytes.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        with path.open("rb") as file:
            return hashlib.file_digest(
                file, lambda: hashlib.blake2b(digest_size=_DIGEST_BYTES)
            ).hexdigest()
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def picture_digest(*pictures: np.ndarray) -> str:
    """Digest of pictures ``(h, w, 3)`` in half precision, clamped as they are when written."""
    half = np.finfo(np.float16)
    digest = hashlib.blake2b(digest_size=_DIGEST_BYTES)
    for picture in pictures:
        stored = np.clip(picture, half.min, half.max).astype(np.float16)
        digest.update(np.ascontiguousarray(stored).data)
    return digest.hexdigest()


def is_finished(output: Path, digest: str, layers: Sequence[Mapping[str, str]] = ({},)) -> bool:
    """Whether a file is a complete clean frame with that digest; any other answer is no.

    Parameters
    ----------
    output
        The file.
    digest
        What it must hold, see `Recipe.digest`.
    layers
        As each view of its source was read with, see `stillray.io.exr.read.read_exr`.
    """
    from stillray.io.exr.read import read_metadata, read_picture

    try:
        written: Any = read_metadata(output)
        if written.getattribute(_DIGEST) != digest:
            return False
        picture = picture_digest(*(read_picture(output, layers=view) for view in layers))
        if str(written.getattribute("compression")).split(":")[0] in _LOSSY:
            return True  # complete: it has been read
        return picture == written.getattribute(_PICTURE)
    except (InputError, OSError):
        return False
