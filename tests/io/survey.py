"""What becomes of EXR files of others: ``python -m tests.io.survey FOLDER``.

Reads every .exr file in a folder and below as `stillray denoise` would, view by view, writes each
back in its structure, and prints a line a file: ``read``, or why not. Counts come last. Nothing
in the folder is changed. For collections that cannot be part of this repository, such as the
OpenEXR project's own images; and for anyone who asks whether a renderer's files will do.
"""

from __future__ import annotations

import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from stillray.errors import InputError, printable
from stillray.io.exr.file import ExrFile
from stillray.io.exr.read_write import read_exr, read_picture, write_exr


def outcome(path: Path, scratch: Path) -> tuple[str, str]:
    """``read``, ``refused`` or ``crashed``, and what there is to say."""
    try:
        views = ExrFile.open(path).views
        for view in views or (None,):
            layers = {} if view is None else {"view": view}
            color = np.nan_to_num(read_exr(path, layers=layers).color, posinf=1, neginf=0)
            write_exr(scratch, color, like=path, layers=layers)
            read_picture(scratch, layers=layers)
    except InputError as error:
        return "refused", str(error).removeprefix(f"{path}: ")
    except Exception:
        return "crashed", traceback.format_exc(limit=-2)
    return "read", ", ".join(views)


def main() -> int:
    """Go through a folder; 1 where a file ended in more than a line."""
    folder, counts = Path(sys.argv[1]), Counter[str]()
    with tempfile.TemporaryDirectory() as scratch, np.errstate(all="ignore"):
        for path in sorted(folder.rglob("*.exr")):
            kind, message = outcome(path, Path(scratch) / "copy.exr")
            counts[kind] += 1
            print(printable(f"{path.relative_to(folder)}: {kind} {message}"), flush=True)
    print(", ".join(f"{count} {kind}" for kind, count in sorted(counts.items())) or "no files")
    return 1 if counts["crashed"] else 0


if __name__ == "__main__":
    sys.exit(main())
