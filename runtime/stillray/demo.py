"""``python -m stillray.demo``: denoise a sequence that has a reference and show the result."""

from __future__ import annotations

import statistics
import time
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer

from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map, write_png
from stillray.errors import InputError
from stillray.io.exr.read import read_exr
from stillray.io.exr.write import write_exr
from stillray.pipeline.denoiser import Denoiser


def run(sequence: Path, out: Path, model: str) -> None:
    """Denoise ``frame_*.exr`` of a folder; compare the last with ``ref_*.exr``.

    Writes ``clean_*.exr`` and ``side_by_side.png`` (noisy, clean, reference) into ``out``.

    Raises
    ------
    InputError
        The folder holds no frames, or no reference of one.
    """
    references = sorted(sequence.glob("ref_*.exr"))
    if not references:
        raise InputError(f"sequence must hold frame_*.exr and ref_*.exr, got {sequence}")
    last = sequence / references[-1].name.replace("ref", "frame")
    out.mkdir(parents=True, exist_ok=True)
    times = []
    with Denoiser(model) as denoiser:
        for path in sorted(sequence.glob("frame_*.exr")):
            frame = read_exr(path)
            start = time.perf_counter()
            clean = denoiser.denoise(frame)
            times.append(1e3 * (time.perf_counter() - start))
            target = out / path.name.replace("frame", "clean")
            write_exr(target, clean, like=path)
            print(f"{path.name} -> {target}  {times[-1]:.1f} ms")
            if path == last:
                break
    reference = read_exr(references[-1]).color
    exposure = display_exposure(reference)
    shown = [tone_map(image, exposure) for image in (frame.color, clean, reference)]
    picture = out / "side_by_side.png"
    write_png(picture, np.hstack(shown))
    before, after = (
        cv2.PSNR(image.astype(np.float64), shown[2].astype(np.float64), 1.0) for image in shown[:2]
    )
    height, width = frame.shape
    print(
        f"{denoiser.model.name}: {width}x{height}, "
        f"median {statistics.median(times):.1f} ms a frame; "
        f"PSNR of the last frame {before:.2f} dB before, {after:.2f} dB after"
    )
    print(f"noisy, clean, reference: {picture}")


def main(
    sequence: Annotated[Path, typer.Argument(help="Folder with frame_*.exr and ref_*.exr.")],
    out: Annotated[Path, typer.Argument(help="Where the results go.")],
    model: Annotated[str, typer.Option(help="Quality, model name or .onnx.")] = "high",
) -> None:
    """Denoise a sequence that has a reference, and show what came of it."""
    run(sequence, out, model)


if __name__ == "__main__":
    program.run(main)
