"""How well the model that learns while it denoises does, and how it learns.

``python -m stillray_training.online.evaluate SEQUENCE REFERENCES --report report.json``

Frames of two halves (``stillray-simulate --second-color``) go through it, through its parts alone
(Choi et al. 2024, figure 8), other models and peers, which are fed the mean of both halves, NFOR
both: its table 1. Every metric of every frame with a reference is printed, too, and drawn by
``--plot``: its figure 7. ``--pictures`` shows the last of them: its figures 1, 2, 4, 6 and 8; with
``--fireflies 1000`` neighbours share bright samples: its figure 9. Frames have the cameras of
`stillray_training.online.to_and_fro`; those whose camera has a reference are measured.

``... evaluate 'a/noisy/s000.####.exr' 'a/clean/s000.####.exr' --color-b 'b/noisy/s000.####.exr'``
does the same with anybody's renders of two seeds: a reference has the number of its frame.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import mean
from types import MappingProxyType
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.arrays.strips import Strips
from stillray.batch.file_layout import Layout
from stillray.cli import program
from stillray.compare.metrics import evaluate
from stillray.errors import InputError
from stillray.families.cross_bilateral import Estimates
from stillray.families.online import OnlineModel
from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.io.exr.read import read_exr, read_picture
from stillray.io.file_sequence import expand, map_companions
from stillray.pipeline.denoiser import Denoiser
from stillray.profiling.plot import require_drawable
from stillray_training.blocks import frame_paths
from stillray_training.evaluate.scores import write_shown
from stillray_training.online.curves import draw_curves
from stillray_training.online.to_and_fro import to_and_fro
from stillray_training.peers.registry import find_peer

METRICS = ("relmse", "ssim", "psnr", "bias")
_PILOTS, _NETWORK, _UNTAUGHT = "pilots alone", "network alone", "nothing learned"
_REFERENCE = "reference"
#: Frames that a shared sample stays for, pixels of its side, and pixels of a frame for each.
_STAYS, _SIDE, _APART = 8, 3, 4_800

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
    samples = None if frame.samples is None else 2 * frame.samples
    return dataclasses.replace(frame, color=color, color_b=None, samples=samples)


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
        halves = "color_b" in model.model.spec.inputs.required
        given = _as_it_is if halves else mean_of_halves
        yield name, lambda frame, made=model, given=given: made.denoise(given(frame))  # type: ignore[misc]
        if halves and parts:
            yield f"{name}, {_UNTAUGHT}", _without_learning(opened.enter_context(Denoiser(name)))
    for name in peers:
        peer = find_peer(name)
        made = peer.make()
        given = _as_it_is if peer.halves else mean_of_halves
        yield name, lambda frame, made=made, given=given: made.denoise(given(frame))  # type: ignore[misc]


def _parts(opened: ExitStack) -> Iterator[tuple[str, Stream]]:
    """Each of its parts without the others (figure 8)."""
    yield _PILOTS, _without_learning(opened.enter_context(_PilotsAlone("online")))
    alone = opened.enter_context(_NetworkAlone("online"))
    yield _NETWORK, alone.denoise
    yield _UNTAUGHT, _without_learning(opened.enter_context(Denoiser("online")))


def _without_learning(denoiser: Denoiser) -> Stream:
    return lambda frame: without_learning(denoiser, frame)


def without_learning(denoiser: Denoiser, frame: Frame) -> np.ndarray:
    """The past is kept, and what was learned is not."""
    if denoiser.state is not None:
        denoiser.state = dataclasses.replace(denoiser.state, learned=None)
    return denoiser.denoise(frame)


@dataclasses.dataclass(frozen=True, eq=False)
class Shown:
    """A frame of two halves.

    Attributes
    ----------
    number
        Of the frame.
    frame
        With ``color_b``.
    reference : (h, w, 3) float32 or None
        What it should be.
    """

    number: int
    frame: Frame
    reference: np.ndarray | None


def of_simulator(sequence: Path, references: Path, last: int | None = None) -> Iterator[Shown]:
    """Frames with the cameras of `to_and_fro`.

    Parameters
    ----------
    sequence
        Folder of ``frame_0000.exr`` and so on, each of two halves.
    references
        Folder of ``ref_0004.exr`` and so on, by camera; as large as the frames, or a multiple.
    last
        How many of the last frames; None for all.
    """
    paths = frame_paths(sequence)[-last if last else None :]
    if not paths:
        raise InputError(f"sequence must hold frame_0000.exr and so on, got {sequence}")
    known = {int(path.stem[-4:]): path for path in sorted(references.glob("ref_*.exr"))}
    if not known:
        raise InputError(f"references must hold ref_0000.exr or the like, got {references}")
    cameras = to_and_fro(len(paths), max(known) + 1)
    for number, path in enumerate(paths):
        frame = read_exr(path)
        reference = known.get(cameras[number])
        wanted = None if reference is None else read_reference(reference, frame.shape)
        yield Shown(number, frame, wanted)


def of_renders(frames: str, second: str, references: str, last: int | None) -> Iterator[Shown]:
    """Frames of any renderer, `stillray.io.file_sequence` patterns of either half's files.

    Parameters
    ----------
    frames
        With all buffers.
    second
        The same frames of another seed, of which color alone is taken.
    references
        Of some numbers of frames, or all.
    last
        As for `of_simulator`.
    """
    files = expand(frames)[-last if last else None :]
    halves = map_companions(second, files, name="color-b")
    known = {file.number: file.path for file in expand(references)}
    if not known.keys() & {file.number for file in files}:
        raise InputError(f"references must have numbers of frames, got {references}")
    before: Path | None = None
    layout = Layout.of([file.path for file in files])
    for index, (file, half) in enumerate(zip(files, halves, strict=True)):
        frame = layout.read(file.path, {"color_b": half}, before)[0].frame
        path = known.get(file.number)
        wanted = None if path is None else read_reference(path, frame.shape)
        yield Shown(index if file.number is None else file.number, frame, wanted)
        before = file.path


def with_fireflies(shot: Iterable[Shown], brightness: float, *, both: bool) -> Iterator[Shown]:
    """Frames in which 3x3 pixels here and there share one bright sample for eight frames.

    So do renders whose samples are reused by neighbours and by the frames that follow (Choi et al.
    2024, figure 9). Places are the same in every call; motion does not move them.

    Parameters
    ----------
    shot
        Frames in order.
    brightness
        Radiance of a sample, in medians of the frame's light where there is any.
    both
        Whether both halves reuse it; otherwise the first alone has it, as independent halves would.
    """
    for index, shown in enumerate(shot):
        frame = shown.frame
        assert frame.color_b is not None
        halves = [frame.color.copy(), frame.color_b.copy()]
        light = (halves[0] + halves[1]).mean(-1) / 2
        sample = brightness * float(np.median(light[light > 0])) if (light > 0).any() else 0.0
        count = max(1, light.size // _APART)
        # those of a run of frames are the same, whatever frames there are
        rng = np.random.default_rng(index // _STAYS)
        rows, columns = (rng.integers(0, max(1, side - _SIDE + 1), count) for side in light.shape)
        for row, column in zip(rows, columns, strict=True):
            for half in halves[: 2 if both else 1]:
                half[row : row + _SIDE, column : column + _SIDE] = sample
        changed = dataclasses.replace(frame, color=halves[0], color_b=halves[1])
        yield dataclasses.replace(shown, frame=changed)


def measure(
    shot: Iterable[Shown],
    models: Sequence[str],
    peers: Sequence[str],
    *,
    parts: bool = True,
    pictures: Path | None = None,
) -> Scores:
    """Scores of every method, by the number of the frame.

    Parameters
    ----------
    shot
        Frames in order.
    models, peers
        Other models, and peers, by name.
    parts
        Whether its parts run alone, too, and models that learn without learning.
    pictures
        Folder for tone-mapped PNGs of the last frame with a reference.
    """
    scores: Scores = {}
    seen: dict[str, np.ndarray] = {}
    with ExitStack() as opened:
        methods = dict(streams(models, peers, opened, parts=parts))
        for shown in shot:
            for name, denoise in methods.items():
                image = denoise(shown.frame)
                if shown.reference is not None:
                    found = evaluate([image], [shown.reference], names=METRICS)
                    scores.setdefault(name, {})[shown.number] = {m: found[m] for m in METRICS}
                    seen[name] = image
            if shown.reference is not None:
                seen[_REFERENCE] = shown.reference
    if pictures is not None and seen:
        for name, image in seen.items():
            write_shown(pictures, name, image, seen[_REFERENCE])
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
    lines = [f"{'method':30s}" + "".join(f"{name:>10s}" for name in METRICS)]
    for name, frames in scores.items():
        means = [mean(values[metric] for values in frames.values()) for metric in METRICS]
        lines.append(f"{name:30s}" + "".join(f"{value:10.4f}" for value in means))
    return lines


def curves(scores: Scores, metric: str) -> list[str]:
    """How a metric goes over the frames with references (figure 7), a line a method."""
    return [
        f"{name:30s}" + "".join(f"{number:5d}:{v[metric]:8.4f}" for number, v in frames.items())
        for name, frames in scores.items()
    ]


def main(
    sequence: Annotated[str, typer.Argument(help="Folder of frames of two halves, or files.")],
    references: Annotated[str, typer.Argument(help="Folder of references by camera, or files.")],
    color_b: Annotated[str | None, typer.Option(help="Files of the second halves.")] = None,
    model: Annotated[list[str] | None, typer.Option(help="Other models; repeatable.")] = None,
    peer: Annotated[list[str] | None, typer.Option(help="Peers; repeatable.")] = None,
    parts: Annotated[bool, typer.Option(help="Run its parts alone, too.")] = True,
    last: Annotated[int | None, typer.Option(help="Run so many of the last frames.")] = None,
    report: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
    plot: Annotated[Path | None, typer.Option(help="PNG of errors over frames.")] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for PNGs of the last frame that is measured.")
    ] = None,
    fireflies: Annotated[
        float | None,
        typer.Option(help="Let 3x3 pixels share samples this many times as bright as the frame."),
    ] = None,
    in_both: Annotated[bool, typer.Option(help="Both halves have these, not one alone.")] = False,
) -> None:
    """Measure the model that learns while it denoises."""
    if plot is not None:
        require_drawable(plot)
    shot = (
        of_simulator(Path(sequence), Path(references), last)
        if color_b is None
        else of_renders(sequence, color_b, references, last)
    )
    if fireflies is not None:
        shot = with_fireflies(shot, fireflies, both=in_both)
    models, peers = model or ["kpyr-5", "nbg-2x3"], peer or ["svgf", "bmfr", "oidn-high"]
    scores = measure(shot, models, peers, parts=parts, pictures=pictures)
    for line in table(scores):
        print(line)
    for metric in METRICS:
        print("", f"{metric} by the number of the frame", *curves(scores, metric), sep="\n")
    if report is not None:
        found: Mapping[str, object] = scores
        report.write_text(json.dumps(found, indent=1), encoding="utf-8")
    if plot is not None:
        # what the methods are fed would squeeze all others into a corner
        drawn = {name: frames for name, frames in scores.items() if name != "noisy"}
        draw_curves(drawn, Path(references).stem, plot)


if __name__ == "__main__":
    program.run(main)
