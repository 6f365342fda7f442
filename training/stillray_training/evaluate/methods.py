"""Models and peers as methods that a case runs through, one after the other."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack

import numpy as np

from stillray.arrays.strips import Strips
from stillray.compare.metrics import METRICS
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.models.registry import ModelInfo
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.opening import model_of
from stillray.stages.prepare import History, prepare
from stillray_training.evaluate.cases import WITHOUT_PAST, Case
from stillray_training.peers import PEERS, Peer, PeerDenoiser, find_peer

#: Label to model, as `stillray.Denoiser` takes it.
Models = Mapping[str, str | ModelInfo]
NOISY, ACCUMULATED = "noisy", "accumulated"


def one_frame(label: str) -> str:
    """Name of a model's row without its past."""
    return f"{label}, one frame"


class Methods:
    """Models, opened once, and peers.

    Parameters
    ----------
    models
        Label to model, as `stillray.Denoiser` takes it.
    peers
        Names of peers to run too, see `stillray_training.peers.PEERS`.
    """

    def __init__(self, models: Models, peers: Sequence[str]) -> None:
        self.models = dict(models)
        self.peers = [find_peer(name) for name in peers]
        self._open = ExitStack()
        self._streams: dict[tuple[str, bool], Denoiser] = {}

    def __enter__(self) -> Methods:
        return self

    def __exit__(self, *exception: object) -> None:
        self._open.close()

    def run(
        self, case: Case, frames: Sequence[Frame], count: int
    ) -> Iterator[tuple[str, list[np.ndarray]]]:
        """Name of each method and its pictures of the last ``count`` frames.

        Parameters
        ----------
        case
            Its kind decides which methods make sense.
        frames
            As the case reads them.
        count
            How many have references.
        """
        has_past = case.kind not in WITHOUT_PAST
        if case.kind != "fed":
            yield NOISY, [frame.color for frame in frames[-count:]]
        accumulated: list[np.ndarray] = []
        if case.kind == "sequences" and self.models:
            accumulated = accumulate_frames(frames, next(iter(self.models.values())))[-count:]
            yield ACCUMULATED, accumulated
        for label in self.models:
            yield label, self._denoise(label, frames, count, temporal=has_past)
            if self._streams[label, has_past].temporal:
                single = self._denoise(label, frames[-count:], count, temporal=False)
                yield one_frame(label), single
        for peer in self.peers:
            if has_past or not peer.remembers:
                seen = frames if peer.remembers else frames[-count:]
                yield peer.label, run_stream(peer.make(), seen, count)[0]
        for peer in self.peers if accumulated else ():
            if not peer.remembers:
                yield f"{peer.label}, accumulated", _fed(peer, frames[-count:], accumulated)

    def of_references(
        self, case: Case, frames: Sequence[Frame], references: Sequence[np.ndarray]
    ) -> Iterator[tuple[str, list[np.ndarray]]]:
        """References of a sequence through Open Image Denoise high, if it is among the peers.

        What differs from them is mostly their own noise, below which no figure can come.
        """
        for peer in self.peers if case.kind == "sequences" else ():
            if peer.name == "oidn-high":
                yield (
                    f"{peer.label}, the references",
                    _fed(peer, frames[-len(references) :], references),
                )

    def _denoise(
        self, label: str, frames: Sequence[Frame], count: int, *, temporal: bool
    ) -> list[np.ndarray]:
        key = label, temporal
        if key not in self._streams:
            stream = Denoiser(self.models[label], temporal=temporal)
            self._streams[key] = self._open.enter_context(stream)
        self._streams[key].reset()
        return run_stream(self._streams[key], frames, count)[0]


def _fed(peer: Peer, frames: Sequence[Frame], colors: Sequence[np.ndarray]) -> list[np.ndarray]:
    ready = [
        dataclasses.replace(frame, color=color) for frame, color in zip(frames, colors, strict=True)
    ]
    return run_stream(peer.make(), ready, len(ready))[0]


def run_stream(
    stream: PeerDenoiser, frames: Sequence[Frame], count: int
) -> tuple[list[np.ndarray], list[float]]:
    """Denoise frames in order: the last images, and the milliseconds of every frame."""
    images, milliseconds = [], []
    for frame in frames:
        start = time.perf_counter()
        images.append(stream.denoise(frame))
        milliseconds.append(1e3 * (time.perf_counter() - start))
    return images[-count:], milliseconds


def accumulate_frames(frames: Sequence[Frame], model: str | ModelInfo) -> list[np.ndarray]:
    """Radiance of each frame as a model's kernels get it: accumulated, not filtered."""
    spec = model_of(model).spec
    history: History | None = None
    images = []
    for frame in frames:
        prepared = prepare(frame, spec, history, Strips(1))
        history = prepared.history
        mean = history.mean[..., :3]
        images.append(
            mean if prepared.demodulation_albedo is None else mean * prepared.demodulation_albedo
        )
    return images


def choose_peers(names: Sequence[str] | None) -> list[str]:
    """The peers to run: those named, or all that are installed and take frames of one color.

    Raises
    ------
    InputError
        A named peer does not exist or cannot run here, or takes frames of two halves.
    """
    if names is None:
        return [peer.name for peer in PEERS if peer.is_installed and not peer.halves]
    peers = [find_peer(name) for name in dict.fromkeys(names)]
    for peer in peers:
        if peer.halves:
            raise InputError(
                f"peer must be one for frames of one color, got {peer.name}, which takes two "
                "halves: see stillray_training.online.evaluate"
            )
    return [peer.name for peer in peers]


def left_out(peers: Sequence[str] | None) -> str:
    """One line that says which metrics, and peers if none were named, lack their package."""
    absent = [(metric.name, metric.package) for metric in METRICS if not metric.is_installed]
    if peers is None:
        absent += [(peer.name, peer.package) for peer in PEERS if not peer.is_installed]
    if not absent:
        return ""
    packages = " ".join(dict.fromkeys(package for _, package in absent))
    names = ", ".join(name for name, _ in absent)
    return f"left out for want of a package: {names} (pip install {packages})"
