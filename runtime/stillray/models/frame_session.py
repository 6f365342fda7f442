"""A frame graph in ONNX Runtime: buffers go to the device, the picture comes back, the state stays.

On a CPU the device is main memory, and all else is the same.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.models.frame_graph import checked_bytes
from stillray.models.session import (
    CPU,
    Provider,
    first_line,
    provider_names,
    session_options,
    start_session,
)

#: What a frame graph is called where graphs are run by name.
GRAPH = "frame"
#: Before the name of an output that is an input of the next frame.
NEXT = "next_"
# Providers whose tensors ONNX Runtime keeps on their device, and what it calls that device.
_DEVICES = {
    "CUDAExecutionProvider": "cuda",
    "TensorrtExecutionProvider": "cuda",
    "NvTensorRTRTXExecutionProvider": "cuda",
    "ROCMExecutionProvider": "cuda",
    "MIGraphXExecutionProvider": "cuda",
    "DmlExecutionProvider": "dml",
}


def device_of(providers: Sequence[Provider] | None) -> tuple[str, int]:
    """Where the first of some providers keeps tensors, and which one of several it is.

    ``"cpu"``, main memory, for those that ONNX Runtime does not keep tensors on.
    """
    first = (providers or (CPU,))[0]
    options = {} if isinstance(first, str) else first[1]
    device = _DEVICES.get(provider_names([first])[0], "cpu")
    return device, int(options.get("device_id", 0)) if device != "cpu" else 0


class FrameSession:
    """A frame graph, run in a thread of its own as a `Network` is.

    Parameters
    ----------
    path
        The .onnx file.
    threads
        Threads of one operator on the CPU.
    providers
        Execution providers by name, or name and options; None for the CPU.

    Raises
    ------
    InputError
        The file cannot be loaded, holds what `stillray-export` does not write, or a provider is
        not installed.
    """

    def __init__(self, path: Path, *, threads: int, providers: tuple[Provider, ...] | None) -> None:
        self._path, self._device = path, device_of(providers)
        self._thread = ThreadPoolExecutor(1, "stillray-frame")
        try:
            data = checked_bytes(path)
            # the thread takes denormals for zero from then on
            options = session_options(threads, flush_denormals=True)
            self._session = self._thread.submit(
                start_session, data, path, options, providers
            ).result()
        except BaseException:
            self.close()
            raise

    def run(self, graph: str, inputs: Mapping[str, Any]) -> dict[str, Any]:
        """The picture as an array, and the next state where the graph runs.

        Parameters
        ----------
        graph
            ``"frame"``.
        inputs
            By name: float32 arrays, or what a run has given for a state.

        Raises
        ------
        InputError
            ONNX Runtime cannot run the graph on that.
        """
        if graph != GRAPH:
            raise ValueError(f"graph must be {GRAPH}, got {graph!r}")
        try:
            return self._thread.submit(self._run, inputs).result()
        except Exception as error:  # ONNX Runtime's own, without a common base
            raise InputError(f"{self._path}: cannot be run: {first_line(error)}") from None

    def _run(self, inputs: Mapping[str, Any]) -> dict[str, Any]:
        binding = self._session.io_binding()
        given = []  # what is bound is read from these arrays, so they must outlive the run
        for name, value in inputs.items():
            if isinstance(value, np.ndarray):
                given.append(np.ascontiguousarray(value, np.float32))
                binding.bind_cpu_input(name, given[-1])
            else:
                binding.bind_ortvalue_input(name, value)
        names = [output.name for output in self._session.get_outputs()]
        for name in names:
            # without a shape: ONNX Runtime allocates it, in each frame anew, so that a state that
            # somebody holds is never written to
            binding.bind_output(name, *(self._device if name.startswith(NEXT) else ("cpu", 0)))
        self._session.run_with_iobinding(binding)
        found = dict(zip(names, binding.get_outputs(), strict=True))
        return {
            name: value if name.startswith(NEXT) else value.numpy() for name, value in found.items()
        }

    def close(self) -> None:
        """Stop the thread."""
        self._thread.shutdown()
