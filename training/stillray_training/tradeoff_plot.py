"""Quality against time as a picture: one panel a metric."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from stillray.compare.metrics import Metric
from stillray.profiling.plot import new_figure, save
from stillray_training.pareto import Priced, pareto_front
from stillray_training.tradeoff import Tradeoff

if TYPE_CHECKING:
    from matplotlib.axes import Axes


_COLOURS = ("C0", "C2", "C4", "C1", "C5", "C6")


def draw_tradeoff(found: Tradeoff, path: Path) -> None:
    """Scatter of quality against milliseconds with the Pareto front; better is up."""
    measured = found.measured()
    columns = min(len(measured), 2)
    rows = -(-len(measured) // columns)
    figure, panels = new_figure(7 * columns, 4.6 * rows, rows, columns)
    flat = list(panels.flat) if len(measured) > 1 else [panels]
    for axes, metric in zip(flat, measured, strict=False):
        _draw(axes, found, metric)
    for axes in flat[len(measured) :]:
        axes.set_visible(False)
    height, width = found.size
    figure.suptitle(
        f"Quality against time, {width} x {height}, mean of {found.scenes} sequences; "
        "squares: peers, small: options changed, line: what no other beats in both"
    )
    save(figure, path)


def _draw(axes: Axes, found: Tradeoff, metric: Metric) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    front = pareto_front(found.methods, metric)
    axes.step(
        [point.milliseconds for point in front],
        [point.scores[metric.name] for point in front],
        where="post",
        color="0.5",
        zorder=1,
    )
    families = list(dict.fromkeys(_family(point) for point in found.methods))
    for point in found.methods:
        peer, changed = point.label in found.peers, _family(point) != point.label
        axes.scatter(
            point.milliseconds,
            point.scores[metric.name],
            color="C3" if peer else _COLOURS[families.index(_family(point)) % len(_COLOURS)],
            marker="s" if peer else "o",
            s=14 if changed else 45,
            zorder=2,
        )
        if peer or not changed or point in front:
            _name(axes, point, metric, bold=point in front)
    axes.set_xscale("log")
    times = [point.milliseconds for point in found.methods]
    axes.set_xlim(min(times) / 1.15, max(times) * 1.6)
    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(ScalarFormatter())
    axes.xaxis.set_minor_formatter(NullFormatter())
    if not metric.higher_is_better:
        axes.invert_yaxis()
    axes.set_xlabel("milliseconds a frame")
    axes.set_ylabel(metric.title)
    axes.grid(True, alpha=0.3)


def _family(point: Priced) -> str:
    """The model of an option."""
    return point.label.split(", ")[0]


def _name(axes: Axes, point: Priced, metric: Metric, *, bold: bool) -> None:
    axes.annotate(
        point.label,
        (point.milliseconds, point.scores[metric.name]),
        xytext=(4, 3),
        textcoords="offset points",
        fontsize=7,
        fontweight="bold" if bold else "normal",
        color="black" if bold else "0.45",
    )
