"""ONNX Runtime, kept to itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from stillray.arrays.watch import INTERVAL, Watch
from stillray.arrays.workspace import Workspace
from stillray.errors import InputError
from stillray.models.network_graph import GraphError, Interface, interface_of
from stillray.models.onnx_file import OnnxFile, parse_onnx, read_bytes
from stillray.models.protobuf import WireError
from stillray.models.steps import PLACES_KEY, Column, InSteps, columns_of, in_steps


def read_checked(path: Path) -> tuple[OnnxFile, Interface]:
    """A model file, and what its network takes and gives; no session is made.

    Raises
    ------
    InputError
        The file is missing, is not ONNX, or holds what `stillray-export` does not write.
    """
    return checked(read_bytes(path), path)


def checked(data: bytes, origin: Path | str) -> tuple[OnnxFile, Interface]:
    """As `read_checked`, of a file's bytes; ``origin`` is what messages call them."""
    try:
        file = parse_onnx(data)
        return file, interface_of(file.graph)
    except (WireError, GraphError) as error:
        raise InputError(f"{origin}: not a usable ONNX model: {error}") from None


def feature_columns(
    file: OnnxFile, interface: Interface, origin: Path | str
) -> tuple[Column, ...] | None:
    """How features are part of the pixels that a network takes; None where it takes planes.

    Raises
    ------
    InputError
        The file tells places that cannot be.
    """
    if interface.steps is None:
        return None
    try:
        return columns_of(interface.steps, file.metadata.get(PLACES_KEY))
    except ValueError as error:
        raise InputError(f"{origin}: not a usable ONNX model: {error}") from None


#: An execution provider of ONNX Runtime: its name, or its name and its options.
Provider = str | tuple[str, Mapping[str, Any]]
#: What runs unless others are asked for.
CPU = "CPUExecutionProvider"


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
    steps
        Name of a graph that comes with stillray, beside the network: where its file is. Opened
        when it is first run, in a thread of its own, and not read strictly, being stillray's own.

    Attributes
    ----------
    feature_columns
        Of a network that takes pixels of integers, how each feature is part of one; else None.
    """

    feature_columns: tuple[Column, ...] | None

    def __init__(
        self,
        path: Path,
        *,
        threads: int,
        providers: tuple[Provider, ...] | None,
        steps: Mapping[str, Path] | None = None,
    ) -> None:
        self._path = path
        self._threads, self._steps = threads, dict(steps or {})
        self._opened: dict[str, Future[Any]] = {}
        self._thread = ThreadPoolExecutor(1, "stillray-network")
        try:
            file, interface = read_checked(path)
            self.feature_columns = feature_columns(file, interface, path)
            self._output_steps = [planes.steps for planes in interface.outputs]
            options = session_options(threads, flush_denormals=True)
            self._session = self._thread.submit(
                start_session, file.data, path, options, providers
            ).result()
        except BaseException:
            self.close()
            raise

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """The outputs by name, without their batch axis: arrays, or `InSteps` of integers.

        Parameters
        ----------
        graph
            ``"network"``; ``"weights"``, which runs nothing and gives those of the file that may
            be given in their place; or the name of a step.
        inputs
            Of the network ``"features"``, as `Interface` has them or as planes of floats in any
            case, and weights by name.

        Raises
        ------
        InputError
            ONNX Runtime cannot run the graph on that.
        """
        return self.begin(graph, inputs).result()

    def begin(self, graph: str, inputs: Mapping[str, np.ndarray]) -> Running:
        """As `run`, without waiting for the end; runs that were begun follow each other."""
        import onnxruntime as ort

        options = ort.RunOptions()
        if graph == "weights":
            file, interface = read_checked(self._path)
            held = {name: file.graph.tensors[name] for name, _ in interface.weights}
            known: Future[Any] = Future()
            known.set_result(held)
            return Running(known, options, self._path)
        opened = None if graph == "network" else self._step(graph)
        if opened is None:
            inputs = {**inputs, "features": self._taken(inputs["features"])}

        def run() -> dict[str, Any]:
            session = self._session if opened is None else opened.result()
            names = [output.name for output in session.get_outputs()]
            found = [array[0] for array in session.run(None, dict(inputs), options)]
            if opened is None:
                found = [
                    array if steps is None else InSteps(array, steps)
                    for array, steps in zip(found, self._output_steps, strict=True)
                ]
            return dict(zip(names, found, strict=True))

        return Running(self._thread.submit(run), options, self._path)

    def _taken(self, features: np.ndarray) -> np.ndarray:
        """Features as the network takes them: whoever wraps an engine may know planes alone."""
        if self.feature_columns is None or features.dtype == np.uint8:
            return features
        planes = features[0]
        out = np.empty((*planes.shape[1:], len(planes)), np.uint8)
        return in_steps(planes, self.feature_columns, out, Workspace())[None]

    def _step(self, graph: str) -> Future[Any]:
        """The session of a step, which is being opened or was."""
        if graph not in self._steps:
            known = ", ".join(("network", "weights", *self._steps))
            raise ValueError(f"graph must be one of {known}, got {graph!r}")
        if graph not in self._opened:
            import onnxruntime as ort

            # Not in the network's thread, whose mode for denormals it would change; nor in this
            # one, which is to be asked meanwhile whether the frame is still wanted.
            opener = ThreadPoolExecutor(1, "stillray-opening")
            self._opened[graph] = opener.submit(
                ort.InferenceSession,
                str(self._steps[graph]),
                session_options(self._threads),
                providers=[CPU],
            )
            opener.shutdown(wait=False)
        return self._opened[graph]

    def close(self) -> None:
        """Stop the thread."""
        self._thread.shutdown()


class Running:
    """A run of a network that was begun."""

    def __init__(self, future: Future[Any], options: Any, path: Path) -> None:
        self._future, self._options, self._path = future, options, path

    def done(self, seconds: float) -> bool:
        """Whether it ends within a time."""
        return not wait([self._future], timeout=seconds).not_done

    def stop(self) -> None:
        """Ask it to end after the operator that it is at; nobody needs to wait for that."""
        self._options.terminate = True

    def result(self) -> dict[str, Any]:
        """Wait for the outputs, as `Network.run` gives them."""
        try:
            outputs: dict[str, Any] = self._future.result()
        except Exception as error:  # ONNX Runtime's own, without a common base
            raise InputError(f"{self._path}: cannot be run: {first_line(error)}") from None
        return outputs


class WatchedEngine:
    """An engine, looked at while it runs.

    Parameters
    ----------
    engine
        What runs; ended within a run if it is a `Network`, else before and after.
    watch
        Of the caller.
    """

    def __init__(self, engine: Any, watch: Watch) -> None:
        self._engine, self._watch = engine, watch

    @property
    def feature_columns(self) -> tuple[Column, ...] | None:
        """Of the engine, if it has any."""
        found: tuple[Column, ...] | None = getattr(self._engine, "feature_columns", None)
        return found

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """As the engine's own."""
        self._watch.look()
        if not isinstance(self._engine, Network):
            outputs: dict[str, Any] = self._engine.run(graph, inputs)
            self._watch.look()
            return outputs
        running = self._engine.begin(graph, inputs)
        try:
            while not running.done(INTERVAL):
                self._watch.look()
        except BaseException:
            running.stop()
            raise
        return running.result()

    def close(self) -> None:
        """As the engine's own."""
        self._engine.close()


def open_session(
    path: Path,
    *,
    threads: int,
    providers: tuple[Provider, ...] | None = None,
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
        Execution providers by name, or name and options; an unknown one is an error, never a
        silent fallback.
    flush_denormals
        Take denormals for zero; the calling thread does so too from then on.
    trace
        Beginning of the name of a file for ONNX Runtime's own profile, in which nodes appear as
        they are in the file: the graph is not optimised.

    Raises
    ------
    InputError
        The file cannot be loaded, holds what `stillray-export` does not write, or a provider is
        not installed.
    """
    # Imported on use: `import stillray` loads no inference engine.
    import onnxruntime as ort

    file, _ = read_checked(path)
    options = session_options(threads, flush_denormals=flush_denormals)
    if trace is not None:
        options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
        options.enable_profiling = True
        options.profile_file_prefix = str(trace)
    # the very bytes that were checked
    return start_session(file.data, path, options, providers)


def start_session(
    data: bytes, path: Path, options: Any, providers: tuple[Provider, ...] | None
) -> Any:
    """A session of a graph that was checked, on these providers or none.

    Parameters
    ----------
    data
        The graph.
    path
        What messages call it.
    options
        Of ONNX Runtime.
    providers
        As `open_session` takes them.

    Raises
    ------
    InputError
        ONNX Runtime refuses the graph, or a provider is not installed or does not start.
    """
    import onnxruntime as ort

    chosen = providers or (CPU,)
    wanted = provider_names(providers)
    available = ort.get_available_providers()
    if missing := [name for name in wanted if name not in available]:
        raise InputError(f"providers must be among {', '.join(available)}, got {missing[0]}")
    try:
        given = [item if isinstance(item, str) else (item[0], dict(item[1])) for item in chosen]
        session = ort.InferenceSession(data, options, providers=given)
    except Exception as error:  # ONNX Runtime's own, without a common base
        raise InputError(f"{path}: not a usable ONNX model: {first_line(error)}") from None
    if (got := session.get_providers()[: len(wanted)]) != wanted:
        raise InputError(f"providers must all start, asked for {wanted}, got {got}")
    return session


def provider_names(providers: Sequence[Provider] | None) -> list[str]:
    """The names of providers, without their options."""
    return [item if isinstance(item, str) else item[0] for item in providers or (CPU,)]


def session_options(threads: int, *, flush_denormals: bool = False) -> Any:
    """What all sessions have in common, and whether denormals are taken for zero."""
    import onnxruntime as ort

    options = ort.SessionOptions()
    options.intra_op_num_threads = threads
    options.inter_op_num_threads = 1
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_ENABLE_ALL
    options.log_severity_level = 4  # what goes wrong is raised, and told in one line
    # a plan of all tensors in one block is laid out for the worst of sizes, beside what the arena
    # holds by then: a sixth to a quarter more memory and no less time, see docs/decisions.md
    options.enable_mem_pattern = False
    # denoising is called between a host's own work: idle threads must not burn its cores
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    if flush_denormals:
        options.add_session_config_entry("session.set_denormal_as_zero", "1")
    return options


def first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
