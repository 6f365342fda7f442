"""A model's network and the graphs beside it, run in a thread of their own."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import numpy as np

from stillray.arrays.watch import INTERVAL, Watch
from stillray.arrays.workspace import Workspace
from stillray.errors import InputError
from stillray.models.renewed import RenewedNetwork
from stillray.models.session import (
    CPU,
    Provider,
    first_line,
    provider_names,
    read_checked,
    session_options,
    start_session,
)
from stillray.models.steps import InSteps, PixelLayout, in_steps


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
    feature_layout
        Of a network that takes pixels of integers, how each feature is part of one; else None.
    """

    feature_layout: PixelLayout | None

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
        self._renewed: RenewedNetwork | None = None
        try:
            file, interface = read_checked(path)
            self.feature_layout = interface.layout
            self._outputs = list(zip(file.graph.outputs, interface.outputs, strict=True))
            # elsewhere opening a network takes longer than running it
            if interface.weights and provider_names(providers) == [CPU]:
                weights = [name for name, _ in interface.weights]
                self._renewed = RenewedNetwork(file.data, weights, path, threads)
                self._thread.submit(self._renewed.open, {}).result()
            else:
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
            if opened is not None:
                session = opened.result()
                found = session.run(None, dict(inputs), options)
                names = [output.name for output in session.get_outputs()]
                return {name: array[0] for name, array in zip(names, found, strict=True)}
            runs = self._session if self._renewed is None else self._renewed
            found = runs.run(None, dict(inputs), options)
            return {
                name: array[0] if planes.steps is None else InSteps(array[0], planes.steps)
                for (name, planes), array in zip(self._outputs, found, strict=True)
            }

        return Running(self._thread.submit(run), options, self._path)

    def _taken(self, features: np.ndarray) -> np.ndarray:
        """Features as the network takes them: whoever wraps an engine may know planes alone."""
        layout = self.feature_layout
        if layout is None or features.dtype == np.uint8:
            return features
        planes = features[0]
        out = np.empty((*planes.shape[1:], layout.size), np.uint8)
        return in_steps(planes, layout, out, Workspace())[None]

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
        """Stop the thread, and free what it used. May be called again."""
        if self._renewed is not None:
            self._thread.submit(self._renewed.close).result()  # after all runs that were begun
            self._renewed = None
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
    def feature_layout(self) -> PixelLayout | None:
        """Of the engine, if it has any."""
        found: PixelLayout | None = getattr(self._engine, "feature_layout", None)
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
