"""The machine that figures were measured on: what it is, how fast it is at best, memory taken."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import packages_distributions, version
from pathlib import Path

from stillray.arrays.strips import available_threads

# Read once when a BLAS library is loaded: hence a process for each number of threads.
_BLAS_THREADS = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "OMP_NUM_THREADS",
)
#: Modules, whoever brings them: OpenCV and ONNX Runtime come in several distributions.
_LIBRARIES = ("numpy", "onnxruntime", "cv2", "OpenImageIO")
_SIDE = 2048  # of the matrices
_COPIED = 1 << 26  # float32 values, 256 MiB: beyond every cache
_TRIES = 5


@dataclass(frozen=True, kw_only=True)
class PeakRates:
    """The best rates of a machine, measured.

    Attributes
    ----------
    operations
        Float32 operations a second of NumPy's matrix product; a multiply-add is two.
    bandwidth
        Bytes a second of a copy from memory to memory, read and written.
    """

    operations: float
    bandwidth: float


def describe() -> dict[str, str]:
    """Processor, threads, system and versions: what figures depend on beside the program."""
    return {
        "processor": _processor(),
        "architecture": platform.machine(),
        "threads": str(available_threads()),
        "system": f"{platform.system()} {platform.release()}",
        "python": platform.python_version(),
        "stillray": version("stillray"),
        **_versions(),
    }


def measure_peak_rates(threads: int) -> PeakRates:
    """The machine's best rates with a number of threads, each the best of a few, in a process."""
    environment = {**os.environ, **{name: str(threads) for name in _BLAS_THREADS}}
    found = json.loads(output_of([sys.executable, "-m", __name__, str(threads)], environment))
    return PeakRates(operations=found["operations"], bandwidth=found["bandwidth"])


def output_of(command: Sequence[str], environment: dict[str, str] | None = None) -> str:
    """What a process prints: for what has to be measured alone, or in an environment of its own.

    Raises
    ------
    RuntimeError
        It failed: with the last line of its errors.
    """
    done = subprocess.run(command, env=environment, check=False, capture_output=True, text=True)
    if done.returncode:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}: {reason}")
    return done.stdout


def peak_resident() -> float:
    """Peak resident MiB of this process so far."""
    status = Path("/proc/self/status")
    if status.is_file():  # getrusage counts the parent's memory at the fork too
        return float(status.read_text().split("VmHWM:")[1].split()[0]) / 1024
    import resource

    unit = 1 << 20 if sys.platform == "darwin" else 1 << 10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit


def available_memory() -> float:
    """MiB that new work may take without swapping; infinite where the system does not say."""
    info = Path("/proc/meminfo")
    if not info.is_file():
        return float("inf")
    return float(info.read_text().split("MemAvailable:")[1].split()[0]) / 1024


def _versions() -> dict[str, str]:
    """Versions of the libraries by the distributions that bring them, or by the modules' names."""
    owners = packages_distributions()
    found = {}
    for module in _LIBRARIES:
        for name in sorted(set(owners.get(module, ()))):
            found[name] = version(name)
        if module not in owners:  # built from source, or a system's own
            found[module] = str(getattr(import_module(module), "__version__", "unknown"))
    return found


def _processor() -> str:
    info = Path("/proc/cpuinfo")
    if info.is_file():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _print_peak_rates(threads: int) -> None:
    import time

    import numpy as np

    matrix = np.ones((_SIDE, _SIDE), np.float32)
    source = np.ones(_COPIED, np.float32)
    target = np.ones_like(source)  # touched: the first write to fresh memory costs more
    parts = [slice(i * _COPIED // threads, (i + 1) * _COPIED // threads) for i in range(threads)]
    products, copies = [], []
    with ThreadPoolExecutor(threads) as pool:
        for _ in range(_TRIES):
            start = time.perf_counter()
            matrix @ matrix
            products.append(time.perf_counter() - start)
            start = time.perf_counter()
            list(pool.map(lambda part: np.copyto(target[part], source[part]), parts))
            copies.append(time.perf_counter() - start)
    print(
        json.dumps(
            {
                "operations": 2 * _SIDE**3 / min(products),
                "bandwidth": 2 * source.nbytes / min(copies),
            }
        )
    )


if __name__ == "__main__":
    _print_peak_rates(int(sys.argv[1]))
