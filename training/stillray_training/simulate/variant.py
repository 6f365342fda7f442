"""Choosing the Mitsuba variant safely: CUDA where a device is there, else LLVM, else scalar.

``llvm_ad_rgb`` aborts the whole process on the ``aov`` integrator with LLVM 14 and 15 (measured
with Mitsuba 3.9.1), and an abort cannot be caught. So LLVM is used only where a library of a
version known to work is found; otherwise ``scalar_rgb`` renders, several times slower.
"""

from __future__ import annotations

import ctypes.util
import os
import re
from functools import cache
from pathlib import Path
from typing import Any

from stillray.errors import InputError

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


@cache
def bound_llvm() -> str | None:
    """`find_llvm`, once a process, and told to Dr.Jit and to processes that this one starts.

    Dr.Jit binds its library at first use, for good: one that is installed while a process runs
    must not make it render with another, which aborts.
    """
    library = find_llvm()
    if library:
        os.environ["DRJIT_LIBLLVM_PATH"] = library
    return library


def load_mitsuba(variant: str | None = None) -> tuple[Any, str]:
    """Import Mitsuba under the fastest variant that is safe here.

    Parameters
    ----------
    variant
        A Mitsuba variant by name; None chooses ``cuda_ad_rgb`` where a device is found, else
        ``llvm_ad_rgb`` where a working LLVM is, else ``scalar_rgb``.

    Returns
    -------
    module, str
        Mitsuba, and one sentence that says which variant runs and why.

    Raises
    ------
    InputError
        There is no such variant, or it cannot run here.
    """
    library = bound_llvm()
    import mitsuba as mi

    if variant is None:
        variant, reason = choose(library)
    elif variant not in mi.variants():
        raise InputError(f"variant must be of {', '.join(mi.variants())}, got {variant}")
    elif variant.startswith("llvm") and not library:
        raise InputError(
            f"variant {variant} needs LLVM {MIN_LLVM_MAJOR} or later (Debian: libllvm19), "
            "found none"
        )
    else:
        reason = "as asked"
    if mi.variant() != variant:
        mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    return mi, f"Mitsuba {mi.__version__} {variant}, {reason}"


def choose(library: str | None) -> tuple[str, str]:
    """The variant for this machine, and why; ``library`` is an LLVM that works, if there is one."""
    import drjit as dr

    if dr.has_backend(dr.JitBackend.CUDA):
        return "cuda_ad_rgb", "a CUDA device is there"
    if library:
        return "llvm_ad_rgb", f"with {library}"
    reason = f"no LLVM of version {MIN_LLVM_MAJOR} or later found: several times slower"
    return "scalar_rgb", reason


def _major(name: str) -> int:
    match = _LLVM_NAME.search(Path(name).resolve().name) or _LLVM_NAME.search(name)
    return int(match.group(1)) if match else 0
