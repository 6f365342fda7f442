"""ONNX Runtime, kept to itself."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

from stillray.errors import InputError


class Network:
    """A model's network, which runs in a thread of its own.

    Black regions fill a network with denormals, which are ten times slower than other numbers, so
    ONNX Runtime is told to take them for zero. It does so by a mode of the thread that opens the
    session, for good: a host would lose its own denormals, and half-precision files their darkest
    values.

    Parameters
    ----------
    path, threads, providers
        As `open_session` takes them.
    """

    def __init__(self, path: Path, *, threads: int, providers: tuple[str, ...] | None) -> None:
        self._thread = ThreadPoolExecutor(1, "stillray-network")
        try:
            self._session = self._thread.submit(
                open_session, path, threads=threads, providers=providers, flush_denormals=True
            ).result()
        except BaseException:
            self.close()
            raise
        self._names = [output.name for output in self._session.get_outputs()]

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """The outputs by name, without their batch axis.

        Parameters
        ----------
        graph
            ``"network"``, the one there is.
        inputs
            ``"features"``: ``(1, features, h, w)`` float32.
        """
        if graph != "network":
            raise ValueError(f"graph must be 'network', got {graph!r}")
        outputs = self._thread.submit(self._session.run, None, dict(inputs)).result()
        return {name: output[0] for name, output in zip(self._names, outputs, strict=True)}

    def close(self) -> None:
        """Stop the thread."""
        self._thread.shutdown()


def open_session(
    path: Path,
    *,
    threads: int,
    providers: tuple[str, ...] | None = None,
    flush_denormals: bool = False,
    trace: Path | None = None,
) -> Any:
    """An ONNX Runtime session with set threads.

    Parameters
    ----------
    path
        The .onnx file.
    threads
        Threads of one operator.
    providers
        Execution providers by name; an unknown one is an error, never a silent fallback.
    flush_denormals
        Take denormals for zero; the calling thread does so too from then on.
    trace
        Beginning of the name of a file for ONNX Runtime's own profile, in which nodes appear as
        they are in the file: the graph is not optimised.

    Raises
    ------
    InputError
        The file cannot be loaded, or a provider is not installed.
    """
    # Imported on use: `import stillray` loads no inference engine.
    import onnxruntime as ort

    if not path.is_file():
        raise InputError(f"{path}: no such model file")
    wanted = list(providers or ("CPUExecutionProvider",))
    available = ort.get_available_providers()
    if missing := [name for name in wanted if name not in available]:
        raise InputError(f"providers must be among {', '.join(available)}, got {missing[0]}")
    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 3
    if trace is not None:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.enable_profiling = True
        options.profile_file_prefix = str(trace)
    # a plan of all tensors in one block is laid out for the worst of sizes, beside what the arena
    # holds by then: a sixth to a quarter more memory and no less time, see docs/decisions.md
    options.enable_mem_pattern = False
    # denoising is called between a host's own work: idle threads must not burn its cores
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if flush_denormals:
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
    try:
        session = ort.InferenceSession(str(path), options, providers=wanted)
    except Exception as error:  # ONNX Runtime raises a family of its own, without a common base
        first_line = str(error).splitlines()[0]
        raise InputError(f"{path}: not a usable ONNX model: {first_line}") from None
    if (got := session.get_providers()[: len(wanted)]) != wanted:
        raise InputError(f"providers must all start, asked for {wanted}, got {got}")
    return session
