"""``python -m stillray_training.noise FOLDER ...``: what the noise of rendered sequences is like.

A network learns the noise that it is shown. Where its tail is heavier than people's frames have,
references of a few hundred samples are far from the truth, and robust accumulation, which takes
light from the brightest samples, teaches the network to put light back that is not missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError
from stillray.io.exr.read import read_exr

_BRIGHTEST = 1e-3  # share of the pixels
_CAP = 16.0  # times the median: radiance above it is outlier to robust accumulation
_COLUMNS = (("tail", ".3f"), ("reference_tail", ".3f"), ("capped", ".2f"), ("psnr", ".1f"))
_QUANTILES = (0.1, 0.5, 0.9)


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Statistics of one noisy frame beside its reference."""

    tail: float  # share of the frame's energy in its brightest 0.1 % of pixels
    reference_tail: float  # the same of the reference: lamps and windows, not noise
    capped: float  # share of the energy that is left where radiance is capped at 16 medians
    psnr: float  # dB of the tone-mapped frame


def measure(noisy: np.ndarray, reference: np.ndarray) -> Noise:
    """Statistics of a frame.

    Parameters
    ----------
    noisy, reference : (h, w, 3) float32
        Radiance; what is not finite counts as 0.
    """
    light, truth = (
        np.nan_to_num(image).mean(axis=-1, dtype=np.float64) for image in (noisy, reference)
    )
    exposure = display_exposure(reference)
    error = tone_map(np.nan_to_num(noisy), exposure) - tone_map(reference, exposure)
    cap = _CAP * float(np.median(truth))
    energy = max(float(light.sum()), 1e-30)
    return Noise(
        tail=_tail(light),
        reference_tail=_tail(truth),
        capped=float(np.minimum(light, cap).sum()) / energy,
        psnr=float(-10 * np.log10(max(float(np.mean(np.square(error))), 1e-10))),
    )


def _tail(light: np.ndarray) -> float:
    count = max(1, round(_BRIGHTEST * light.size))
    brightest = np.partition(light.ravel(), -count)[-count:]
    return float(brightest.sum() / max(float(light.sum()), 1e-30))


def measure_folder(folder: Path) -> list[Noise]:
    """Statistics of the last referenced frame of every sequence in a folder.

    Raises
    ------
    InputError
        The folder holds no sequence with a reference.
    """
    found = []
    for sequence in sorted(path for path in folder.iterdir() if path.is_dir()):
        references = sorted(sequence.glob("ref_*.exr"))
        if references:
            frame = sequence / references[-1].name.replace("ref", "frame")
            found.append(measure(read_exr(frame).color, read_exr(references[-1]).color))
    if not found:
        raise InputError(f"folder must hold sequences with references, got {folder}")
    return found


def table(rows: dict[str, Sequence[Noise]]) -> str:
    """Markdown: a folder a row, the 10th, 50th and 90th percentile of each statistic."""
    head = "frames | tail | tail of references | energy under 16 medians | PSNR, dB"
    lines = [f"| sequences | {head} |", "|---" * 6 + "|"]
    for name, found in rows.items():
        cells = [str(len(found))]
        for key, form in (
            ("tail", ".3f"),
            ("reference_tail", ".3f"),
            ("capped", ".2f"),
            ("psnr", ".1f"),
        ):
            low, middle, high = np.quantile([getattr(one, key) for one in found], _QUANTILES)
            cells.append(f"{middle:{form}} ({low:{form}} to {high:{form}})")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def main(
    folders: Annotated[list[Path], typer.Argument(help="Folders of sequences; repeatable.")],
) -> None:
    """Print how heavy the noise's tail is: medians, and 10th to 90th percentiles."""
    print(table({folder.name: measure_folder(folder) for folder in folders}))


if __name__ == "__main__":
    program.run(main)
