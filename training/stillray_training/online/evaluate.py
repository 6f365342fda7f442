"""How well the model that learns while it denoises does, and how it learns.

``python -m stillray_training.online.evaluate SEQUENCE REFERENCES --report report.json``

Frames of two halves (``stillray-simulate --second-color``) go through it, through its parts alone
(Choi et al. 2024, figure 8), other models and Open Image Denoise, which are fed the mean of both
halves. Frames have the cameras of `stillray_training.online.to_and_fro`; those whose camera has a
reference are measured.
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
from stillray.families.online import OnlineModel
from stillray.families.online_past import Past
from stillray.families.registry import FAMILIES
from stillray.frame import Frame
from stillray.io.exr.read_write import read_exr, read_picture
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frame_paths
from stillray_training.online.to_and_fro import to_and_fro
from stillray_training.peers.oidn import OpenImageDenoise

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


class _NetworkAlone(Denoiser):
    families = MappingProxyType({**FAMILIES, "cross-regression": NetworkAlone})


def mean_of_halves(frame: Frame) -> Frame:
    """A frame for models that know one color: the mean of both, of twice the samples."""
    assert frame.color_b is not None
    color = (frame.color + frame.color_b) / 2
    return dataclasses.replace(frame, color=color, color_b=None)


def streams(models: Sequence[str], opened: ExitStack) -> Iterator[tuple[str, Stream]]:
    """Methods by name, each with a past of its own."""
    yield "noisy", lambda frame: mean_of_halves(frame).color
    online = opened.enter_context(Denoiser("online"))
    yield "online", online.denoise
    # the pilots of the frame that was just denoised
    yield _PILOTS, lambda frame: _pilots_of(online)
    alone = opened.enter_context(_NetworkAlone("online"))
    yield _NETWORK, alone.denoise
    untaught = opened.enter_context(Denoiser("online"))
    yield _UNTAUGHT, lambda frame: _without_learning(untaught, frame)
    for name in models:
        model = opened.enter_context(Denoiser(name))
        yield name, lambda frame, model=model: model.denoise(mean_of_halves(frame))  # type: ignore[misc]
    peer = OpenImageDenoise("high")
    yield "oidn-high", lambda frame: peer.denoise(mean_of_halves(frame))


def _pilots_of(denoiser: Denoiser) -> np.ndarray:
    past = denoiser.state.temporal if denoiser.state is not None else None
    assert isinstance(past, Past)
    return ((past.pilot_a + past.pilot_b) / 2)[..., :3]


def _without_learning(denoiser: Denoiser, frame: Frame) -> np.ndarray:
    """The past is kept, and what was learned is not."""
    if denoiser.state is not None:
        denoiser.state = dataclasses.replace(denoiser.state, learned=None)
    return denoiser.denoise(frame)


def measure(
    sequence: Path, references: Path, models: Sequence[str], *, last: int | None = None
) -> Scores:
    """Scores of every method, by the number of the frame.

    Parameters
    ----------
    sequence
        Folder of ``frame_0000.exr`` and so on, each of two halves.
    references
        Folder of ``ref_0004.exr`` and so on, by camera; as large as the frames, or a multiple.
    models
        Other models by name.
    last
        How many of the last frames to run; None for all.
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
        methods = dict(streams(models, opened))
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


def curve(scores: Scores, metric: str, methods: Sequence[str]) -> list[str]:
    """How a metric goes over the frames (figure 7), a line a method."""
    return [
        f"{name:16s}" + "".join(f"{number:5d}:{v[metric]:8.4f}" for number, v in frames.items())
        for name, frames in scores.items()
        if name in methods
    ]


def main(
    sequence: Annotated[Path, typer.Argument(help="Folder of frames of two halves.")],
    references: Annotated[Path, typer.Argument(help="Folder of references by camera.")],
    model: Annotated[list[str] | None, typer.Option(help="Other models; repeatable.")] = None,
    last: Annotated[int | None, typer.Option(help="Run so many of the last frames.")] = None,
    report: Annotated[Path | None, typer.Option(help="JSON to write.")] = None,
) -> None:
    """Measure the model that learns while it denoises."""
    scores = measure(sequence, references, model or ["kpyr-5"], last=last)
    for line in (*table(scores), "", *curve(scores, "psnr", ("online", _UNTAUGHT))):
        print(line)
    if report is not None:
        found: Mapping[str, object] = scores
        report.write_text(json.dumps(found, indent=1), encoding="utf-8")


if __name__ == "__main__":
    program.run(main)
