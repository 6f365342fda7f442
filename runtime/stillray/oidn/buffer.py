"""Memory with a handle, as Open Image Denoise's buffers: here plain memory of the host."""

from __future__ import annotations

from types import TracebackType
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.oidn import constants
from stillray.oidn.device import Device
from stillray.oidn.memory import array_of, bytes_at, bytes_of


class Buffer:
    """Bytes that images of filters can lie in.

    Parameters
    ----------
    device
        Whose filters use it.
    byte_size
        Bytes, 0 or more; they begin as 0.
    storage
        ``OIDN_STORAGE_*``; all of them are memory of the host here.

    Raises
    ------
    InputError
        The size is negative.
    """

    def __init__(self, device: Device, byte_size: int, storage: int | None = None) -> None:
        self._begin(device, np.zeros(_at_least_0("byte_size", byte_size), np.uint8), storage)

    @classmethod
    def shared(cls, device: Device, dev_ptr: Any, byte_size: int) -> Buffer:
        """A buffer over memory of the caller's, who keeps it alive.

        Parameters
        ----------
        device, byte_size
            As of the constructor.
        dev_ptr
            An address of the host: an integer, or a pointer of ctypes or cffi.
        """
        return cls._over(device, bytes_at(dev_ptr, _at_least_0("byte_size", byte_size)))

    @classmethod
    def shared_from_numpy(cls, device: Device, array: np.ndarray) -> Buffer:
        """A buffer over the memory of an array, which must be contiguous."""
        return cls._over(device, bytes_of("array", array))

    @classmethod
    def shared_from_torch(cls, device: Device, tensor: Any) -> Buffer:
        """A buffer over the memory of a tensor of the host, which must be contiguous."""
        return cls._over(device, bytes_of("tensor", array_of("tensor", tensor)))

    @property
    def size(self) -> int:
        """Bytes."""
        return int(self._bytes.size)

    @property
    def storage(self) -> int:
        """``OIDN_STORAGE_*`` that it was made with; ``HOST`` unless given."""
        return self._storage

    def get_data(self) -> int:
        """The address of its memory."""
        return int(self._bytes.ctypes.data)

    def read(self, byte_offset: int, byte_size: int, dst: Any) -> None:
        """Copy bytes from here into a writable object with a buffer, from its beginning."""
        source = self._part(byte_offset, byte_size)
        target = np.frombuffer(memoryview(dst).cast("B"), np.uint8)
        if not target.flags.writeable:
            raise InputError("dst must be writable")
        _first("dst", target, byte_size)[:] = source

    def write(self, byte_offset: int, byte_size: int, src: Any) -> None:
        """Copy bytes from an object with a buffer, from its beginning, to here."""
        target = self._part(byte_offset, byte_size)
        target[:] = _first("src", np.frombuffer(memoryview(src).cast("B"), np.uint8), byte_size)

    def read_async(self, byte_offset: int, byte_size: int, dst: Any) -> None:
        """`read`, after what was begun before; done when `Device.wait` returns."""
        self._part(byte_offset, byte_size)
        self._device._later(lambda: self.read(byte_offset, byte_size, dst))

    def write_async(self, byte_offset: int, byte_size: int, src: Any) -> None:
        """`write`, after what was begun before; done when `Device.wait` returns."""
        self._part(byte_offset, byte_size)
        self._device._later(lambda: self.write(byte_offset, byte_size, src))

    def release(self) -> None:
        """Let the memory go. May be called again."""
        self._bytes = np.empty(0, np.uint8)

    def __enter__(self) -> Buffer:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.release()

    @classmethod
    def _over(cls, device: Device, memory: np.ndarray) -> Buffer:
        made = cls.__new__(cls)
        made._begin(device, memory, None)
        return made

    def _begin(self, device: Device, memory: np.ndarray, storage: int | None) -> None:
        self._device = device
        self._bytes = memory
        self._storage = constants.OIDN_STORAGE_HOST if storage is None else int(storage)

    def _part(self, offset: int, size: int) -> np.ndarray:
        _at_least_0("byte_offset", offset)
        _at_least_0("byte_size", size)
        if offset + size > self.size:
            raise InputError(
                f"byte_offset and byte_size must lie within {self.size} bytes, got {offset}, {size}"
            )
        return self._bytes[offset : offset + size]


def _at_least_0(name: str, value: int) -> int:
    if value < 0:
        raise InputError(f"{name} must be 0 or more, got {value}")
    return int(value)


def _first(name: str, memory: np.ndarray, size: int) -> np.ndarray:
    if memory.size < size:
        raise InputError(f"{name} must hold {size} bytes, got {memory.size}")
    return memory[:size]
