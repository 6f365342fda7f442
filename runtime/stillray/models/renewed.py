"""A network whose weights change from run to run, at the speed of one whose weights stay."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from stillray.models.onnx_file import with_constants
from stillray.models.session import session_options, start_session

_SMALL = 64  # pixels: a size that every network takes
_SAME_AS_REQUESTED = 1  # of onnxruntime's arena: no more than what is asked for


class RenewedNetwork:
    """Gives a network other weights by opening it anew, on the processor.

    Constants are laid out for the processor, inputs are not: with them a network of 32 thousand
    weights takes two thirds of the time. Opening it takes milliseconds; new memory would take all
    that is won, so sessions share an arena of the process, which `close` empties.

    All of this runs on one thread, whose modes sessions set.

    Parameters
    ----------
    data
        The model file, whose weights are inputs, too.
    weights
        Their names.
    path
        What messages call the file.
    threads
        Of one operator.
    """

    def __init__(self, data: bytes, weights: Sequence[str], path: Path, threads: int) -> None:
        self._data, self._names = data, weights
        self._path, self._threads = path, threads
        self._weights: dict[str, np.ndarray] = {}
        self._session: Any = None

    def open(self, weights: Mapping[str, np.ndarray]) -> None:
        """Take weights by name; those that are left out are the file's.

        Raises
        ------
        InputError
            ONNX Runtime refuses the graph.
        """
        _share_memory()
        options = session_options(self._threads, flush_denormals=True)
        options.add_session_config_entry("session.use_env_allocators", "1")
        data = with_constants(self._data, self._names, weights)
        self._session = start_session(data, self._path, options, None)
        self._weights = {name: value.copy() for name, value in weights.items()}

    def run(self, names: None, inputs: dict[str, np.ndarray], options: Any) -> list[np.ndarray]:
        """As a session's own, of which weights are inputs; ``names`` are those of all outputs."""
        weights = {name: value for name, value in inputs.items() if name != "features"}
        if not self._holds(weights):
            self.open(weights)
        features = {"features": inputs["features"]}
        found: list[np.ndarray] = self._session.run(names, features, options)
        return found

    def _holds(self, weights: Mapping[str, np.ndarray]) -> bool:
        return weights.keys() == self._weights.keys() and all(
            np.array_equal(value, self._weights[name]) for name, value in weights.items()
        )

    def close(self) -> None:
        """Give the memory of runs back."""
        if self._session is None:
            return
        import onnxruntime as ort

        options = ort.RunOptions()
        options.add_run_config_entry("memory.enable_memory_arena_shrinkage", "cpu:0")
        planes = self._session.get_inputs()[0].shape[1]
        features = np.zeros((1, planes, _SMALL, _SMALL), np.float32)
        self._session.run(None, {"features": features}, options)
        self._session, self._weights = None, {}


@cache
def _share_memory() -> None:
    """Have an arena of the process, which those sessions use that ask for it."""
    import onnxruntime as ort

    arena = ort.OrtAllocatorType.ORT_ARENA_ALLOCATOR
    memory = ort.OrtMemoryInfo("Cpu", arena, 0, ort.OrtMemType.DEFAULT)
    how = ort.OrtArenaCfg(
        {
            "max_mem": 0,
            "arena_extend_strategy": _SAME_AS_REQUESTED,
            "initial_chunk_size_bytes": -1,
            "max_dead_bytes_per_chunk": -1,
        }
    )
    ort.create_and_register_allocator(memory, how)
