"""How errors go while a model learns, as a picture (Choi et al. 2024, figure 7)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from stillray.profiling.plot import new_figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

#: Scores by method, by the number of the frame, by metric.
Scores = Mapping[str, Mapping[int, Mapping[str, float]]]


def draw_curves(scores: Scores, title: str, path: Path) -> None:
    """Draw both errors of the paper, frame by frame: relative MSE and 1 - SSIM, lower is better.

    Parameters
    ----------
    scores
        With the metrics ``relmse`` and ``ssim``. Of frames without a reference there are none: a
        line goes straight from one that has one to the next.
    title
        Above both panels.
    path
        PNG to write.

    Raises
    ------
    InputError
        The package matplotlib is not there.
    """
    figure, (left, right) = new_figure(11, 4.2, 1, 2)
    for name, frames in scores.items():
        numbers = sorted(frames)
        ours = name.startswith("online")
        how = {"marker": "o" if ours else ".", "linewidth": 2.2 if ours else 1.0, "label": name}
        left.plot(numbers, [frames[number]["relmse"] for number in numbers], **how)
        right.plot(numbers, [1 - frames[number]["ssim"] for number in numbers], **how)
    left.set_yscale("log")
    for axes, label in ((left, "relative MSE"), (right, "1 - SSIM")):
        _finish(axes, label)
    left.legend(fontsize=7)
    figure.suptitle(title)
    save(figure, path)


def _finish(axes: Axes, label: str) -> None:
    axes.set_xlabel("frame")
    axes.set_ylabel(label)
    axes.grid(True, which="both", alpha=0.3)
