"""What is wrong with an installation, found by looking and by trying, in lines to act on."""

from __future__ import annotations

import os
import platform
import sys
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib import import_module, metadata
from pathlib import Path

import numpy as np

from stillray.arrays.strips import available_threads
from stillray.errors import InputError
from stillray.version import __version__

OK, NOTE, PROBLEM = "ok", "note", "problem"
#: Modules that must be there, and what to install for each.
_NEEDED = {
    "numpy": "numpy",
    "cv2": "opencv-contrib-python-headless",
    "onnxruntime": "onnxruntime",
    "OpenImageIO": "OpenImageIO",
}
_CGROUPS = Path("/sys/fs/cgroup")


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes
    ----------
    kind
        ``"ok"``; ``"note"``, which may stay; ``"problem"``, which should not.
    text
        What was found and, but for ``"ok"``, what to do.
    """

    kind: str
    text: str


def examine(*, model: str = "high") -> Iterator[Finding]:
    """Look at the installation: versions, libraries twice there, threads, precision; denoise.

    Parameters
    ----------
    model
        What is tried at the end, as `stillray.Denoiser` takes it.
    """
    yield Finding(
        OK,
        f"stillray {__version__}, Python {platform.python_version()}, {platform.system()} "
        f"{platform.machine()}, {sys.executable}",
    )
    owners = metadata.packages_distributions()
    broken = False
    for module, install in _NEEDED.items():
        for finding in look_at_module(module, install, owners):
            broken = broken or (finding.kind == PROBLEM and "cannot be imported" in finding.text)
            yield finding
    yield look_at_threads(available_threads(), cpu_quota())
    if broken:
        return  # what follows needs them all
    yield look_at_providers()
    yield look_at_remap()
    yield try_model(model)


def look_at_module(module: str, install: str, owners: Mapping[str, list[str]]) -> list[Finding]:
    """Whether one distribution, and no other, brings a module, and whether it can be imported.

    Parameters
    ----------
    module
        Its name in an import.
    install
        The distribution that should bring it.
    owners
        Module to the distributions that bring it, as `importlib.metadata` tells.
    """
    found = []
    names = sorted(set(owners.get(module, ())))
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in names)
    if len(names) > 1:
        found.append(
            Finding(
                PROBLEM,
                f"{module} comes from {len(names)} packages, which overwrite each other's files: "
                f"{versions}. Keep one: pip uninstall {' '.join(names)}, then pip install "
                + install,
            )
        )
    try:
        import_module(module)
    except Exception as error:  # whatever a half-overwritten library does when it is loaded
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        action = f"pip install --force-reinstall {names[0] if names else install}"
        return [*found, Finding(PROBLEM, f"{module} cannot be imported ({reason}): {action}")]
    if not found:
        found = [Finding(OK, f"{module}: {versions or 'not installed as a package'}")]
    return found


def cpu_quota(cgroups: Path = _CGROUPS) -> float | None:
    """Processors' worth of time that a container grants, or None without a bound."""
    try:
        if (cgroups / "cpu.max").is_file():
            quota, period = (cgroups / "cpu.max").read_text().split()
        else:
            quota = (cgroups / "cpu" / "cpu.cfs_quota_us").read_text().strip()
            period = (cgroups / "cpu" / "cpu.cfs_period_us").read_text().strip()
        return None if quota in ("max", "-1") else int(quota) / int(period)
    except (OSError, ValueError, ZeroDivisionError):
        return None


def look_at_threads(threads: int, quota: float | None) -> Finding:
    """Whether as many threads as are taken unless told otherwise have a processor each."""
    total = os.cpu_count() or threads
    seen = f"threads: {threads} of {total} processors may be used"
    if quota is not None and quota < threads:
        return Finding(
            NOTE,
            f"{seen}, but the container's time is that of {quota:g}: more threads than that wait "
            f"for each other, give threads={max(int(quota), 1)} or --threads",
        )
    return Finding(OK, seen)


def look_at_providers() -> Finding:
    """Which execution providers ONNX Runtime has."""
    import onnxruntime

    available = onnxruntime.get_available_providers()
    if "CPUExecutionProvider" not in available:
        return Finding(
            PROBLEM,
            f"ONNX Runtime has {', '.join(available) or 'no provider'}, not CPUExecutionProvider: "
            "pip install --force-reinstall onnxruntime",
        )
    rest = [name for name in available if name != "CPUExecutionProvider"]
    more = f"; on request: providers={rest}" if rest else ""
    return Finding(OK, f"ONNX Runtime runs on CPUExecutionProvider{more}")


def look_at_remap() -> Finding:
    """Whether OpenCV looks pictures up at exact places, or at multiples of 1/32 pixel."""
    import cv2

    row = np.arange(8, dtype=np.float32)[None]
    at = np.array([[3 + 1 / 64]], np.float32)
    got = cv2.remap(row, at, np.zeros_like(at), cv2.INTER_LINEAR)[0, 0]
    if abs(got - at[0, 0]) < 1e-3:
        return Finding(OK, f"OpenCV {cv2.__version__} interpolates at exact places")
    return Finding(
        NOTE,
        f"OpenCV {cv2.__version__} rounds places to 1/32 pixel, as all do before 5.0: moving "
        "pictures differ slightly (67 dB) from those of other machines; "
        "pip install 'opencv-contrib-python-headless>=5'",
    )


def try_model(model: str) -> Finding:
    """Whether a frame can be denoised."""
    from stillray.frame import Frame
    from stillray.pipeline.denoiser import Denoiser

    try:
        with Denoiser(model) as denoiser:
            clean = denoiser.denoise(Frame(color=np.full((16, 16, 3), 0.5)))
            name, precision = denoiser.model.name, denoiser.precision
    except InputError as error:
        return Finding(PROBLEM, f"{model} cannot be used: {error}")
    if not np.allclose(clean, 0.5, rtol=1e-3):
        return Finding(
            PROBLEM,
            f"{name} gives {clean.min():g} to {clean.max():g} for a frame of 0.5: reinstall "
            "onnxruntime, numpy and OpenCV",
        )
    numbers = "integers of 8 bits" if precision == "int8" else "32-bit floats"
    return Finding(OK, f"{name} denoises a frame, its network in {numbers}")
