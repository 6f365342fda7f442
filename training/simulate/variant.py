"""Choosing the Mitsuba variant safely.

``llvm_ad_rgb`` aborts the whole process on the ``aov`` integrator with LLVM 14 and 15 (measured
with Mitsuba 3.9.1), and an abort cannot be caught. So LLVM is used only where a library of a
version known to work is found; otherwise ``scalar_rgb`` renders, several times slower.
"""

from __future__ import annotations

import ctypes.util
import os
import re
from pathlib import Path
from typing import Any

MIN_LLVM_MAJOR = 16
_LLVM_NAME = re.compile(r"libLLVM(?:-|\.so\.)(\d+)")
_LIBRARY_FOLDERS = ("/usr/lib/x86_64-linux-gnu", "/usr/lib/aarch64-linux-gnu", "/usr/lib64")


def find_llvm() -> str | None:
    """Path of the newest LLVM library that renders AOVs without aborting, or None."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        return named if _major(named) >= MIN_LLVM_MAJOR else None
    found = [
        str(path)
        for folder in _LIBRARY_FOLDERS
        for path in Path(folder).glob("libLLVM*")
        if path.is_file()
    ]
    if found_by_name := ctypes.util.find_library("LLVM"):
        found.append(found_by_name)
    usable = [name for name in found if _major(name) >= MIN_LLVM_MAJOR]
    return max(usable, key=_major, default=None)


def load_mitsuba(variant: str | None = None) -> tuple[Any, str]:
    """Import Mitsuba under the fastest variant that is safe here.

    Parameters
    ----------
    variant
        A Mitsuba variant by name; None chooses ``llvm_ad_rgb`` where a working LLVM is found,
        else ``scalar_rgb``.

    Returns
    -------
    module, str
        Mitsuba, and one sentence that says which variant runs and why.
    """
    library = find_llvm()
    if library:
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    import mitsuba as mi

    if variant is None:
        variant = "llvm_ad_rgb" if library else "scalar_rgb"
    reason = f"with {library}" if library else f"no LLVM of version {MIN_LLVM_MAJOR} or later found"
    if mi.variant() != variant:
        mi.set_variant(variant)
    return mi, f"Mitsuba {mi.__version__} {variant}, {reason}"


def _major(name: str) -> int:
    match = _LLVM_NAME.search(Path(name).resolve().name) or _LLVM_NAME.search(name)
    return int(match.group(1)) if match else 0
