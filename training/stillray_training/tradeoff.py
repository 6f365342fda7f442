"""Quality against time: every model and option of the runtime, and the peers, on sequences.

Methods take turns, scene by scene, in one process. The last frames of a sequence are scored, and
all but the first two, which allocate, are timed.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from stillray.arrays.strips import available_threads
from stillray.compare import metrics
from stillray.compare.metrics import METRICS, Metric
from stillray.io.exr.read import read_exr
from stillray.models.registry import ModelInfo, find_model, with_overrides
from stillray.pipeline.denoiser import Denoiser
from stillray_training.evaluate.cases import find_scenes, last_referenced
from stillray_training.evaluate.methods import run_stream
from stillray_training.pareto import Priced, pareto_front
from stillray_training.peers import PeerDenoiser, find_peer

_WARM_FROM = 2  # frames
NOISY = "noisy"  # the input as it is
_KERNEL_SHARES = (1 / 3, 2 / 3)  # of a model's fused kernels
_ENSEMBLES = (2, 4)  # of models that can
_HISTORY_FACTORS = (1 / 4, 4)  # of the samples that a model's history is worth


@dataclass(frozen=True, kw_only=True)
class Option:
    """One way to denoise.

    Attributes
    ----------
    label
        As tables show it.
    make
        A new stream.
    remembers
        Whether earlier frames change its result.
    is_peer
        Whether it is somebody else's.
    same_picture_as
        Label of an earlier option that gives the same pictures, and so the same scores.
    """

    label: str
    make: Callable[[], PeerDenoiser]
    remembers: bool
    is_peer: bool = False
    same_picture_as: str | None = None


def model_options(name: str) -> list[Option]:
    """A model as it comes, and each option of the runtime changed alone.

    Raises
    ------
    InputError
        There is no such model.
    """
    info = find_model(name)

    def option(words: str = "", *, same: bool = False, **arguments: object) -> Option:
        given = {"model": info, **arguments}
        return Option(
            label=f"{info.name}, {words}" if words else info.name,
            make=lambda: Denoiser(**given),  # type: ignore[arg-type]
            remembers=bool(given.get("temporal", True)),
            same_picture_as=info.name if same else None,
        )

    options = [option(), option("one frame", temporal=False)]
    if available_threads() > 1:
        options.append(option("1 thread", same=True, threads=1))
    options += [option(words, model=changed) for words, changed in _tuned(info)]
    return options


def _tuned(info: ModelInfo) -> list[tuple[str, ModelInfo]]:
    found = []
    most = len(info.spec.decoder.fused_sizes)
    for count in dict.fromkeys(round(share * most) for share in _KERNEL_SHARES):
        if 1 <= count < most:
            found.append((f"{count} of {most} kernels", with_overrides(info, kernels=count)))
    for ensemble in _ENSEMBLES:
        if ensemble <= info.spec.decoder.most_ensemble:
            found.append((f"ensemble of {ensemble}", with_overrides(info, ensemble=ensemble)))
    for factor in _HISTORY_FACTORS:
        samples = max(info.spec.temporal.max_samples * factor, 1.0)
        found.append((f"history of {samples:g}", with_overrides(info, max_samples=samples)))
    return found


def peer_options(names: Sequence[str]) -> list[Option]:
    """Peers by name."""
    peers = [find_peer(name) for name in names]
    return [
        Option(label=peer.label, make=peer.make, remembers=peer.remembers, is_peer=True)
        for peer in peers
    ]


@dataclass(frozen=True, kw_only=True)
class Tradeoff:
    """What was measured.

    Attributes
    ----------
    methods
        Ours and the peers, each with means over the scenes.
    peers
        Labels of those that are peers.
    noisy
        Scores of the input as it is.
    size
        Height and width of the frames, pixels; of the last scene.
    scenes
        How many sequences were denoised.
    """

    methods: list[Priced]
    peers: frozenset[str]
    noisy: dict[str, float]
    size: tuple[int, int]
    scenes: int

    def measured(self) -> list[Metric]:
        """The metrics that every method has."""
        return [m for m in METRICS if all(m.name in p.scores for p in self.methods)]

    def to_json(self) -> str:
        """Everything, and the label of each method on each metric's front."""
        return json.dumps(
            {
                "height": self.size[0],
                "width": self.size[1],
                "scenes": self.scenes,
                "noisy": self.noisy,
                "methods": [
                    {**asdict(method), "peer": method.label in self.peers}
                    for method in self.methods
                ],
                "fronts": {
                    metric.name: [p.label for p in pareto_front(self.methods, metric)]
                    for metric in self.measured()
                },
            },
            indent=2,
        )


def measure(
    folder: Path,
    options: Sequence[Option],
    progress: Callable[[list[Path]], Iterable[Path]] = iter,
) -> Tradeoff:
    """Denoise the sequences of a folder in every way: quality and time of their last frames.

    Parameters
    ----------
    folder
        Sequences ``<scene>/frame_*.exr`` with references ``ref_*.exr``.
    options
        The ways, with labels of their own.
    progress
        Wraps the scenes.

    Raises
    ------
    InputError
        The folder holds no sequences with references.
    """
    scores: dict[str, list[dict[str, float]]] = {NOISY: []}
    times: dict[str, list[float]] = {}
    size = (0, 0)
    for scene in progress(find_scenes(folder)):
        paths, references = last_referenced(scene)
        frames = [read_exr(path) for path in paths]
        count, size = len(references), frames[-1].shape
        noisy = [frame.color for frame in frames[-count:]]
        scores[NOISY].append(metrics.evaluate(noisy, references))
        for option in options:
            # a method that forgets sees some frames before too, to be warm
            seen = frames if option.remembers else frames[-count - _WARM_FROM :]
            stream = option.make()
            images, milliseconds = run_stream(stream, seen, count)
            if isinstance(stream, Denoiser):
                stream.close()
            times.setdefault(option.label, []).extend(milliseconds[_WARM_FROM:] or milliseconds)
            found = (
                scores[option.same_picture_as][-1]
                if option.same_picture_as in scores
                else metrics.evaluate(images, references)
            )
            scores.setdefault(option.label, []).append(found)
    return Tradeoff(
        methods=[
            Priced(
                label=label,
                milliseconds=float(np.median(values)),
                scores=_mean(scores[label]),
            )
            for label, values in times.items()
        ],
        peers=frozenset(option.label for option in options if option.is_peer),
        noisy=_mean(scores[NOISY]),
        size=size,
        scenes=len(scores[NOISY]),
    )


def _mean(rows: Sequence[dict[str, float]]) -> dict[str, float]:
    """Mean over scenes of the metrics that all of them have."""
    shared = [metric.name for metric in METRICS if all(metric.name in row for row in rows)]
    return {name: float(np.mean([row[name] for row in rows])) for name in shared}
