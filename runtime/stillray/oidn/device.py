"""A device of Open Image Denoise's interface: here always this process's processors."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.oidn import constants
from stillray.oidn.filtering import Parameters, filtered, model_for
from stillray.oidn.version import oidn_version
from stillray.pipeline.denoiser import Denoiser

_VERSION = tuple(int(part) for part in oidn_version.split("."))
_CPU_TYPES = (constants.OIDN_DEVICE_TYPE_DEFAULT, constants.OIDN_DEVICE_TYPE_CPU)


class Device:
    """Where filters run; it owns their models and threads.

    What goes wrong while a filter runs is kept, as Open Image Denoise does, until `get_error`
    asks for it. Wrong arguments raise at once.

    Parameters
    ----------
    device_type
        ``OIDN_DEVICE_TYPE_CPU`` or ``DEFAULT``; of any other, `get_error` says that there is none.
    """

    def __init__(self, device_type: int = constants.OIDN_DEVICE_TYPE_CPU) -> None:
        self._lock = threading.RLock()
        self._error: str | None = None
        self._denoisers: dict[str, Denoiser] = {}
        self._worker: ThreadPoolExecutor | None = None
        self._pending: list[Future[None]] = []
        self._process = os.getpid()
        self._state = "new"
        self._ints = {
            "type": constants.OIDN_DEVICE_TYPE_CPU,
            "version": _VERSION[0] * 10000 + _VERSION[1] * 100 + _VERSION[2],
            "versionMajor": _VERSION[0],
            "versionMinor": _VERSION[1],
            "versionPatch": _VERSION[2],
            "numThreads": 0,
            "verbose": 0,
        }
        self._bools = {
            "setAffinity": False,
            "systemMemorySupported": True,
            "managedMemorySupported": False,
        }
        if device_type not in _CPU_TYPES:
            self._fail(f"device type {device_type} is not supported: stillray runs on the CPU")
            self._state = "unsupported"

    @classmethod
    def from_torch(cls, device: Any = None, stream: Any = None) -> Device:
        """A device for tensors of torch, which must lie in the memory of the host.

        Raises
        ------
        ValueError
            The device is none of the host. `stillray.oidn.denoise` takes tensors of any device.
        """
        kind = str(getattr(device, "device", device) or "cpu").split(":")[0]
        if kind != "cpu":
            raise ValueError(f"device must be cpu: stillray runs on the CPU, got {kind}")
        return cls()

    @staticmethod
    def is_cpu_available() -> bool:
        """True."""
        return True

    @staticmethod
    def is_cuda_available(device_id: int = 0) -> bool:
        """False: filters run on the CPU."""
        return False

    def commit(self) -> None:
        """Take the parameters over; needed before filters run, and after a change."""
        with self._lock:
            if self._state in ("released", "unsupported"):
                return self._fail(f"the device is {self._state}")
            self._close_denoisers()
            self._state = "committed"

    def release(self) -> None:
        """Finish what runs, and stop the threads. May be called again."""
        self.wait()
        with self._lock:
            self._close_denoisers()
            if self._worker is not None:
                self._worker.shutdown()
                self._worker = None
            self._state = "released"

    def wait(self) -> None:
        """Wait until all that was begun with `execute_async` and the like is done."""
        with self._lock:
            pending, self._pending = self._pending, []
        for future in pending:
            future.result()

    def get_error(self) -> str | None:
        """The first error since the last call, in words, or None; asking forgets it."""
        with self._lock:
            error, self._error = self._error, None
            return error

    def get_int(self, name: str) -> int:
        """An integer parameter: type, version, versionMajor, numThreads, ... 0 if unknown."""
        return int(self._get(self._ints, name, 0))

    def get_uint(self, name: str) -> int:
        """As `get_int`."""
        return self.get_int(name)

    def get_bool(self, name: str) -> bool:
        """A boolean parameter. False if unknown."""
        return bool(self._get(self._bools, name, False))

    def set_int(self, name: str, value: int) -> None:
        """Set an integer parameter; ``numThreads`` counts from the next `commit`, 0 for all."""
        self._set(self._ints, ("numThreads", "verbose"), name, int(value))

    def set_uint(self, name: str, value: int) -> None:
        """As `set_int`.

        Raises
        ------
        InputError
            The value is negative.
        """
        if value < 0:
            raise InputError(f"value must be 0 or more, got {value}")
        self.set_int(name, value)

    def set_bool(self, name: str, value: bool) -> None:
        """Set a boolean parameter; ``setAffinity`` changes nothing here."""
        self._set(self._bools, ("setAffinity",), name, bool(value))

    def __enter__(self) -> Device:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    # what filters and buffers of this package call

    def _fail(self, message: str) -> None:
        with self._lock:
            self._error = self._error or message

    def _run(
        self,
        images: Mapping[str, np.ndarray],
        output: np.ndarray,
        parameters: Parameters,
        quality: str,
    ) -> None:
        """Filter into ``output``; what is wrong is kept for `get_error`."""
        with self._lock:
            if self._state != "committed":
                return self._fail(f"the device must be committed, it is {self._state}")
            if os.getpid() != self._process:
                return self._fail("the device must be made in the process that uses it")
            try:
                result = filtered(images, parameters, self._denoiser(model_for(images, quality)))
            except InputError as error:
                return self._fail(str(error))
            except MemoryError:
                return self._fail("out of memory")
            if result.shape != output.shape:
                return self._fail(f"output must have the shape {result.shape}, got {output.shape}")
            with np.errstate(over="ignore"):
                np.copyto(output, result, casting="same_kind")

    def _later(self, work: Callable[[], None]) -> None:
        """Do this after all that was begun before; `wait` waits for it."""
        with self._lock:
            if self._state == "released":
                return self._fail("the device is released")
            if self._worker is None:
                self._worker = ThreadPoolExecutor(1, "stillray-oidn")
            self._pending.append(self._worker.submit(work))

    def _denoiser(self, quality: str) -> Denoiser:
        if quality not in self._denoisers:
            threads = self._ints["numThreads"] or None
            self._denoisers[quality] = Denoiser(quality, threads=threads, temporal=False)
        return self._denoisers[quality]

    def _close_denoisers(self) -> None:
        for denoiser in self._denoisers.values():
            denoiser.close()
        self._denoisers.clear()

    def _get(self, known: Mapping[str, Any], name: str, otherwise: Any) -> Any:
        if name not in known:
            self._fail(f"unknown device parameter or type mismatch: '{name}'")
        return known.get(name, otherwise)

    def _set(self, known: dict[str, Any], settable: tuple[str, ...], name: str, value: Any) -> None:
        if name not in settable:
            return self._fail(f"unknown device parameter or type mismatch: '{name}'")
        known[name] = value
