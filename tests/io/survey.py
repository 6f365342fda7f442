"""What becomes of EXR files of others: ``python -m tests.io.survey FOLDER``.

Reads every .exr file in a folder and below as `stillray denoise` would, in all its views, writes it
back in its structure, and prints a line a file: ``read``, with what cannot be kept, or why not.
Counts of outcomes and of like messages come last. Nothing in the folder is changed. For collections
that cannot be part of this repository, such as the OpenEXR project's own images; and for anyone who
asks whether a renderer's files will do.
"""

from __future__ import annotations

import re
import sys
import tempfile
import traceback
from collections import Counter
from pathlib import Path

import numpy as np

from stillray.batch.file_layout import CleanPicture, Layout
from stillray.errors import InputError, printable

_ORDER = ("crashed", "refused", "read")


def outcome(path: Path, scratch: Path) -> tuple[str, str]:
    """``read``, ``refused`` or ``crashed``, and what there is to say."""
    try:
        layout = Layout.of([path], aovs=())
        views = layout.read(path, {}, None)
        clean = [
            CleanPicture(np.nan_to_num(view.frame.color, posinf=1, neginf=0), view.lights)
            for view in views
        ]
        layout.write(scratch, clean, like=path)
        layout.read(scratch, {}, None)
    except InputError as error:
        return "refused", str(error).removeprefix(f"{path}: ")
    except Exception:
        return "crashed", traceback.format_exc(limit=-2)
    found = sorted(frozenset[str]().union(*(view.frame.given for view in views)))
    told = [", ".join((*layout.views, *found)), *layout.changes(path, scratch)]
    return "read", "; ".join(told)


def main() -> int:
    """Go through a folder; 1 where a file ended in more than a line."""
    folder, counts, alike = Path(sys.argv[1]), Counter[str](), Counter[tuple[str, str]]()
    with tempfile.TemporaryDirectory() as scratch, np.errstate(all="ignore"):
        for path in sorted(folder.rglob("*.exr")):
            kind, message = outcome(path, Path(scratch) / "copy.exr")
            counts[kind] += 1
            # numbers and lists of channels differ from file to file
            alike[kind, re.sub(r"\d+|but holds .*;", "…", message)] += 1
            print(printable(f"{path.relative_to(folder)}: {kind} {message}"), flush=True)
    for (kind, message), count in sorted(
        alike.items(), key=lambda item: (_ORDER.index(item[0][0]), -item[1])
    ):
        print(printable(f"{count} {kind}: {message}"))
    print(", ".join(f"{counts[kind]} {kind}" for kind in _ORDER if counts[kind]) or "no files")
    return 1 if counts["crashed"] else 0


if __name__ == "__main__":
    sys.exit(main())
