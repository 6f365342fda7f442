"""OpenImageIO, imported on use, with its complaints as one-line errors.

Only it decodes and encodes EXR here: OpenCV's own reader is switched off in most builds.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.io.exr.container import Container, read_container


def openimageio() -> Any:
    """The module; imported on use, so that `import stillray` stays quick."""
    import OpenImageIO

    return OpenImageIO


def checked_container(path: Path, *, headers_only: bool = False) -> Container:
    """The container of a file that exists and has been checked, from end to end if not told else.

    Raises
    ------
    InputError
        There is no such file, or it is not a whole EXR file.
    """
    if path.is_dir():
        raise InputError(f"{path}: is a folder, not an EXR file")
    if not path.is_file():
        raise InputError(f"{path}: no such file")
    try:
        if path.stat().st_size == 0:
            raise InputError(f"{path}: not a readable EXR file: it is empty")
        return read_container(path, headers_only=headers_only)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An open EXR file; what goes wrong with it inside the block becomes an `InputError`.

    Its container must have been checked before: the library trusts more than it should.
    """
    oiio = openimageio()
    source = None
    try:
        source = oiio.ImageInput.open(str(path))
        if source is None:
            raise InputError(f"{path}: not a readable EXR file: {reason(oiio.geterror())}")
        if source.format_name() != "openexr":
            raise InputError(f"{path}: must be an EXR file, its content is {source.format_name()}")
        yield source
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    except UnicodeDecodeError:
        raise InputError(f"{path}: not a readable EXR file: its names are not UTF-8") from None
    finally:
        if source is not None:
            source.close()


def reason(message: str) -> str:
    """A complaint in one line, without the path that our own messages begin with."""
    return re.sub(r"^EXR Error \(.*?\): ", "", " ".join(message.split())) or "unknown reason"
