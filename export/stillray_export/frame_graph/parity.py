"""A frame graph beside the runtime's stages, frame by frame: what differs, and how much.

``stillray-export NAME --frame-graph`` looks before it keeps the file. ``python -m
stillray_export.frame_graph.parity NAME.frame.onnx`` prints the table, and draws the differences.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.families.frame_graph import Remembered
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.io.file_sequence import expand
from stillray.models.registry import ModelInfo, find_frame_model, find_model
from stillray.pipeline.denoiser import Denoiser
from stillray.stages.state import History
from stillray_export.frame_graph.moving import CUT, sequence
from stillray_export.parity import ParityError

#: dB between tone-mapped pictures that an export must reach.
LEAST = 80.0
#: Of what is compared: the picture, its last row, and what each stage leaves to the next frame.
COLUMNS = (
    "picture", "last row", "light", "samples", "geometry", "noise", "exposure", "albedo",
)  # fmt: skip
#: Height and width of made-up frames, pixels: no multiples of what networks take.
SIZE = (61, 90)
_FRAMES = 8
_MOST = 200.0  # dB, of what is the same
_DRAWN = -180.0, -40.0  # dB of differences that are drawn black and white

Pair = tuple[np.ndarray, np.ndarray, dict[str, float]]


def decibels(got: np.ndarray, wanted: np.ndarray) -> float:
    """Between two pictures, tone-mapped."""
    apart = np.square(tone_mapped(got) - tone_mapped(wanted)).mean(dtype=np.float64)
    return float(min(-10 * np.log10(apart + 1e-30), _MOST))


def tone_mapped(picture: np.ndarray) -> np.ndarray:
    """Radiance, or irradiance times exposure, to [0, 1)."""
    mapped: np.ndarray = picture / (1 + picture)
    return mapped


def check(graph: Path, info: ModelInfo, size: tuple[int, int] = SIZE) -> None:
    """Refuse a frame graph whose pictures are not those of its model's stages.

    Over eight frames with a lamp that is switched on, a mirror, a cut, NaN, infinities, and what
    comes into view.

    Raises
    ------
    stillray_export.parity.ParityError
        A picture, or its last row, is less than `LEAST` dB from the runtime's.
    """
    for index, (_, _, found) in enumerate(compared(graph, info, moving(*size), cuts={CUT})):
        for name in ("picture", "last row"):
            if not found[name] > LEAST:
                raise ParityError(
                    f"{info.name}: the {name} of frame {index} of {size} is {found[name]:.1f} dB "
                    f"from the runtime's, which must be {LEAST:g}"
                )


def moving(height: int, width: int) -> list[Frame]:
    """The frames that an export is tested on."""
    return sequence(_FRAMES, height, width)


def compared(
    graph: Path, info: ModelInfo, frames: Iterable[Frame], cuts: Iterable[int] = ()
) -> Iterator[Pair]:
    """Frames through a graph and through its model's stages.

    Parameters
    ----------
    graph
        NAME.frame.onnx, run on the CPU.
    info
        The model that it was made of.
    frames
        In order.
    cuts
        Indices of frames that begin anew.

    Yields
    ------
    tuple
        The graph's picture, the runtime's, and dB by `COLUMNS`: between pictures and accumulated
        light as `decibels` has it, of the rest the signal over the error. What a frame does not
        leave is absent.
    """
    with (
        Denoiser(graph, threads=1) as whole,
        Denoiser(info, threads=1, precision="float32") as stages,
    ):
        for index, frame in enumerate(frames):
            if index in cuts:
                whole.reset()
                stages.reset()
            got, wanted = whole.denoise(frame), stages.denoise(frame)
            found = {
                "picture": decibels(got, wanted),
                "last row": decibels(got[-1:], wanted[-1:]),
                **_of_states(whole, stages),
            }
            yield got, wanted, found


def _of_states(whole: Denoiser, stages: Denoiser) -> dict[str, float]:
    remembered, history = (each.state and each.state.temporal for each in (whole, stages))
    assert isinstance(remembered, Remembered)
    assert isinstance(history, History)
    left = {name: value.numpy() for name, value in remembered.tensors.items()}
    found = {
        "light": decibels(
            *(mean[..., :3] * history.exposure for mean in (left["past_mean"], history.mean))
        ),
        "samples": _signal(left["past_mean"][..., 3], history.mean[..., 3]),
        "exposure": _signal(left["past_numbers"][0], np.array(history.exposure)),
    }
    if history.surface_guides is not None:
        found["geometry"] = _signal(left["past_guides"], history.surface_guides)
    if history.noise is not None:
        found["noise"] = _signal(left["past_noise"], history.noise.variance)
    if history.mean_albedo is not None and "past_albedo" in left:
        found["albedo"] = _signal(left["past_albedo"], history.mean_albedo[..., :3])
    return found


def _signal(got: np.ndarray, wanted: np.ndarray) -> float:
    """dB of what is wanted over the error."""
    error = np.square(got - wanted, dtype=np.float64).mean()
    signal = np.square(wanted, dtype=np.float64).mean()
    return float(min(10 * np.log10((signal + 1e-30) / (error + 1e-30)), _MOST))


def main(
    graph: Annotated[Path, typer.Argument(help="NAME.frame.onnx.")],
    source: Annotated[
        str | None,
        typer.Argument(metavar="[INPUT]", help="A sequence as 'shot.####.exr'; made up without."),
    ] = None,
    model: Annotated[
        str | None, typer.Option("--model", "-m", help="Of which it was made, if not by its name.")
    ] = None,
    pictures: Annotated[
        Path | None, typer.Option(help="Folder for pictures of the differences.")
    ] = None,
) -> None:
    """Compare a frame graph with the runtime's stages, frame by frame."""
    info = find_model(model or find_frame_model(graph).spec.name)
    if pictures is not None and not pictures.is_dir():
        raise InputError(f"pictures must be a folder that exists, got {pictures}")
    frames = moving(*SIZE) if source is None else [read_exr(f.path) for f in expand(source)]
    cuts = {CUT} if source is None else set()
    print(f"| frame | {' | '.join(COLUMNS)} |")
    print("|---" * (1 + len(COLUMNS)) + "|")
    for index, (got, wanted, found) in enumerate(compared(graph, info, frames, cuts)):
        cells = [f"{found[name]:.0f}" if name in found else "" for name in COLUMNS]
        print(f"| {index} | {' | '.join(cells)} |", flush=True)
        if pictures is not None:
            cv2.imwrite(str(pictures / f"{info.name}.{index}.png"), _drawn(got, wanted))


def _drawn(got: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """The runtime's picture, the graph's, and by the logarithm what they differ by, as bytes."""
    pair = tone_mapped(wanted), tone_mapped(got)
    black, white = _DRAWN
    apart = 20 * np.log10(np.abs(pair[1] - pair[0]) + 1e-12)
    panels = [*(part ** (1 / 2.2) for part in pair), (apart - black) / (white - black)]
    shown = np.concatenate(panels, 1).clip(0, 1)
    return np.ascontiguousarray((255 * shown[..., ::-1]).round().astype(np.uint8))


if __name__ == "__main__":
    program.run(main)
