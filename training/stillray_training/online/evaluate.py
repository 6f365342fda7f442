"""How well the model that learns while it denoises does, and how it learns.

``python -m stillray_training.online.evaluate SEQUENCE REFERENCES --report report.json``

Frames of two halves (``stillray-simulate --second-color``) go through it, through its parts alone
(Choi et al. 2024, figure 8), other models and peers, which are fed the mean of both halves, NFOR
both: its table 1. Every metric of every frame with a reference is printed, too: its figure 7.
Frames have the cameras of `stillray_training.online.to_and_fro`; those whose camera has a reference
are measured.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import mean
from types import MappingProxyType
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.compare.metrics import evaluate
from stillray.errors import InputError
from stillray.families.cross_bilateral import Estimates
from stillray.families.online import OnlineModel
from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.io.exr.read_write import read_exr, read_picture
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frame_paths
from stillray_training.online.to_and_fro import to_and_fro
from stillray_training.peers.registry import find_peer

METRICS = ("relmse", "ssim", "psnr", "bias")
_PILOTS, _NETWORK, _UNTAUGHT = "pilots alone", "network alone", "nothing learned"

Stream = Callable[[Frame], np.ndarray]
Scores = dict[str, dict[int, dict[str, float]]]


class NetworkAlone(OnlineModel):
    """The filter of the halves themselves, without regression."""

    def pilots(
        self, first: np.ndarray, second: np.ndarray, guides: np.ndarray, strips: Strips
    ) -> np.ndarray:
        """The halves."""
        return np.stack([first, second])


class PilotsAlone(OnlineModel):
    """The mean of both pilots: nothing is filtered, and the last picture is not looked at."""

    def filter(self, estimates: Estimates, theta: np.ndarray, strips: Strips) -> np.ndarray:
        """The mean of what would be filtered."""
        mean: np.ndarray = estimates.values.mean(0)
        return mean


class _NetworkAlone(Denoiser):
    families = MappingProxyType({**FAMILIES, "cross-regression": NetworkAlone})


class _PilotsAlone(Denoiser):
    families = MappingProxyType({**FAMILIES, "cross-regression": PilotsAlone})


def mean_of_halves(frame: Frame) -> Frame:
    """A frame for models that know one color: the mean of both, of twice the samples."""
    assert frame.color_b is not None
    color = (frame.color + frame.color_b) / 2
    return dataclasses.replace(frame, color=color, color_b=None)


def _as_it_is(frame: Frame) -> Frame:
    return frame


def streams(
    models: Sequence[str], peers: Sequence[str], opened: ExitStack, *, parts: bool
) -> Iterator[tuple[str, Stream]]:
    """Methods by name, each with a past of its own."""
    yield "noisy", lambda frame: mean_of_halves(frame).color
    yield "online", opened.enter_context(Denoiser("online")).denoise
    if parts:
        yield from _parts(opened)
    for name in models:
        model = opened.enter_context(Denoiser(name))
        yield name, lambda frame, model=model: model.denoise(mean_of_halves(frame))  # type: ignore[misc]
    for name in peers:
        peer = find_peer(name)
        made = peer.make()
        given = _as_it_is if peer.halves else mean_of_halves
        yield name, lambda frame, made=made, given=given: made.denoise(given(frame))  # type: ignore[misc]


def _parts(opened: ExitStack) -> Iterator[tuple[str, Stream]]:
    """Each of its parts without the others (figure 8)."""
    pilots = opened.enter_context(_PilotsAlone("online"))
    yield _PILOTS, lambda frame: _without_learning(pilots, frame)
    alone = opened.enter_context(_NetworkAlone("online"))
    yield _NETWORK, alone.denoise
    untaught = opened.enter_context(Denoiser("online"))
    yield _UNTAUGHT, lambda frame: _without_learning(untaught, frame)


def _without_learning(denoiser: Denoiser, frame: Frame) -> np.ndarray:
    """The past is kept, and what was learned is not."""
    if denoiser.state is not None:
        denoiser.state = dataclasses.replace(denoiser.state, learned=None)
    return denoiser.denoise(frame)


def measure(
    sequence: Path,
    references: Path,
    models: Sequence[str],
    peers: Sequence[str],
    *,
    last: int | None = None,
    parts: bool = True,
) -> Scores:
    """Scores of every method, by the number of the frame.

    Parameters
    ----------
    sequence
        Folder of ``frame_0000.exr`` and so on, each of two halves.
    references
        Folder of ``ref_0004.exr`` and so on, by camera; as large as the frames, or a multiple.
    models, peers
        Other models, and peers, by name.
    last
        How many of the last frames to run; None for all.
    parts
        Whether its parts run alone, too.
    """
    paths = frame_paths(sequence)[-last if last else None :]
    if not paths:
        raise InputError(f"sequence must hold frame_0000.exr and so on, got {sequence}")
    known = {int(path.stem[-4:]): path for path in sorted(references.glob("ref_*.exr"))}
    if not known:
        raise InputError(f"references must hold ref_0000.exr or the like, got {references}")
    cameras = to_and_fro(len(paths), max(known) + 1)
    scores: Scores = {}
    with ExitStack() as opened:
        methods = dict(streams(models, peers, opened, parts=parts))
        for number, path in enumerate(paths):
            frame = read_exr(path)
            reference = known.get(cameras[number])
            wanted = None if reference is None else read_reference(reference, frame.shape)
            for name, denoise in methods.items():
                image = denoise(frame)
                if wanted is not None:
                    found = evaluate([image], [wanted], names=METRICS)
                    scores.setdefault(name, {})[number] = {m: found[m] for m in METRICS}
    return scores


def read_reference(path: Path, shape: tuple[int, int]) -> np.ndarray:
    """A reference in the frames' size: pixels are means of boxes, as those of frames are."""
    image = read_picture(path)
    factor = image.shape[0] // shape[0]
    if image.shape[:2] != (factor * shape[0], factor * shape[1]):
        raise InputError(f"{path}: must be as large as the frames or a multiple, {shape}")
    return cv2.resize(image, shape[::-1], interpolation=cv2.INTER_AREA)


def table(scores: Scores) -> list[str]:
    """Means over the frames with references, a line a method."""
    lines = [f"{'method':16s}" + "".join(f"{name:>10s}" for name in METRICS)]
    for name, frames in scores.items():
        means = [mean(values[metric] for values in frames.values()) for metric in METRICS]
        lines.append(f"{name:16s}" + "".join(f"{value:10.4f}" for value in means))
    return lines


def curves(scores: Scores, metric: str) -> list[str]:
    """How a metric goes over the frames with references (figure 7), a line a method."""
    return [
        f"{name:16s}" + "".join(f"{number:5d}:{v[metric]:8.4f}" for number, v in frames.items())
        for name, frames in scores.items()
    ]


def main(
    sequence: Annotated[Path, typer.Argument(help="Folder of frames of two halves.")],
    references: Annotated[Path, typer.Argument(help="Folder of references by camera.")],
    model: Annotated[list[str] | None, typer.Option(help="Other models; repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="Peers; repeatable.")] = None,
    parts: Annotated[bool, typer.Option(help="Run its parts alone, too.")] = True,
    last: Annotated[int | None, typer.Option(help="Run so many of the last frames.")] = None,
    report: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
) -> None:
    """Measure the model that learns while it denoises."""
    scores = measure(
        sequence,
        references,
        model or ["kpyr-5", "nbg-2x3"],
        peer or ["svgf", "bmfr", "oidn-high"],
        last=last,
        parts=parts,
    )
    for line in table(scores):
        print(line)
    for metric in METRICS:
        print("", f"{metric} by the number of the frame", *curves(scores, metric), sep="\n")
    if report is not None:
        found: Mapping[str, object] = scores
        report.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    program.run(main)
