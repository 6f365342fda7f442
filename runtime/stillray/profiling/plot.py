"""Pictures of a profile."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from stillray.errors import InputError
from stillray.io.atomic import atomic_path
from stillray.profiling.measure import ORDER, TOTAL
from stillray.profiling.report import title
from stillray.profiling.results import Result
from stillray.profiling.scaling import Curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FILES = ("read", "write")
_LEAST_LABELLED = 0.045  # share of the longest bar


def require_drawable(path: Path) -> None:
    """Raise `InputError` where no picture can be drawn there; called before measuring."""
    if find_spec("matplotlib") is None:
        raise InputError("a plot needs the package matplotlib: pip install 'stillray[compare]'")
    if not path.parent.is_dir():
        raise InputError(f"plot must be in a folder that exists, got {path}")


def new_figure(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Any, Any]:
    """A figure and its axes, drawn without a display: inches."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure, figure.subplots(rows, columns)


def save(figure: Any, path: Path) -> None:
    """Write a figure as PNG, complete or not at all."""
    with atomic_path(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def draw_profile(results: Sequence[Result], path: Path) -> None:
    """Stacked bars: the median of every stage, and under it the stage's roofline.

    Files are left out: reading and writing do not depend on the model.
    """
    figure, axes = new_figure(11, 1.6 + 0.95 * len(results))
    _draw_bars(axes, results)
    save(figure, path)


def _draw_bars(axes: Axes, results: Sequence[Result]) -> None:
    import matplotlib

    present = {name for result in results for name in result.run.stages()}
    names = [name for name in ORDER if name in present and name not in _FILES]
    maps = [matplotlib.colormaps[kind] for kind in ("tab20", "tab20b")]
    palette = [colour_of(index) for colour_of in maps for index in range(colour_of.N)]
    colours = dict(zip(ORDER, palette, strict=False))
    longest = max(result.run.stages()[TOTAL].median for result in results)
    for row, result in enumerate(results):
        stages = result.run.stages()
        left = roofline_left = 0.0
        for name in names:
            if name not in stages:
                continue
            width = stages[name].median
            label = name if row == 0 or name not in results[0].run.stages() else None
            axes.barh(row, width, 0.5, left, color=colours[name], label=label)
            if width > _LEAST_LABELLED * longest:
                axes.text(left + width / 2, row, f"{width:.0f}", ha="center", va="center")
            left += width
            roofline = result.roofline(name) or 0.0
            axes.barh(row + 0.34, roofline, 0.14, roofline_left, color=colours[name], alpha=0.75)
            roofline_left += roofline
        total = stages[TOTAL]
        axes.text(
            left + 0.01 * longest,
            row,
            f"{total.median:.0f} ms   p95 {total.p95:.0f}, worst {total.worst:.0f}",
            va="center",
        )
        if roofline_left:
            edge = roofline_left + 0.01 * longest
            axes.text(edge, row + 0.34, "roofline", va="center", fontsize=7)
    axes.set_yticks(
        range(len(results)), [title(result).replace(", ", "\n", 1) for result in results]
    )
    axes.set_xlim(0, longest * 1.28)
    axes.invert_yaxis()
    axes.set_xlabel("milliseconds a warm frame, median of each stage; files left out")
    handles, labels = axes.get_legend_handles_labels()
    first = dict(zip(labels, handles, strict=True))
    axes.legend(
        [first[name] for name in names if name in first],
        [name for name in names if name in first],
        ncols=6,
        loc="lower center",
        bbox_to_anchor=(0.45, 1.0),
        frameon=False,
    )
    axes.spines[["top", "right"]].set_visible(False)


def draw_curves(curves: Sequence[Curve], path: Path) -> None:
    """A panel a curve, both axes logarithmic, so that an exponent is a slope."""
    figure, panels = new_figure(11, 8, 2, 2)
    for axes, curve in zip(panels.flat, curves, strict=True):
        axes.loglog(curve.values, curve.milliseconds, "o-", color="C0", label="milliseconds")
        axes.set_title(curve.subject, fontsize=10)
        axes.set_xlabel(curve.name)
        axes.set_ylabel("milliseconds")
        if curve.exponent is not None:
            _draw_fit(axes, curve.values, curve.milliseconds, curve.exponent)
        if curve.memory:
            beside = axes.twinx()
            beside.loglog(curve.values, curve.memory, "s--", color="C1")
            beside.set_ylabel("net MiB (dashed)", color="C1")
            _plain_numbers(beside, curve.memory)
        _label_ticks(axes, curve)
    save(figure, path)


def _label_ticks(axes: Axes, curve: Curve) -> None:
    from matplotlib.ticker import FixedLocator, NullLocator

    axes.xaxis.set_major_locator(FixedLocator(curve.values))
    axes.xaxis.set_minor_locator(NullLocator())
    long = max(len(label) for label in curve.labels) > 4
    axes.set_xticklabels(curve.labels, rotation=30 if long else 0, fontsize=8)
    axes.grid(True, alpha=0.3)
    _plain_numbers(axes, curve.milliseconds)


def _plain_numbers(axes: Axes, costs: Sequence[float]) -> None:
    from matplotlib.ticker import LogLocator, NullFormatter, ScalarFormatter

    axes.set_ylim(min(costs) / 1.5, max(costs) * 1.5)
    axes.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.yaxis.set_major_formatter(ScalarFormatter())
    axes.yaxis.set_minor_formatter(NullFormatter())


def _draw_fit(axes: Axes, values: Sequence[float], costs: Sequence[float], exponent: float) -> None:
    middle = sum(math.log(c) - exponent * math.log(v) for v, c in zip(values, costs, strict=True))
    scale = math.exp(middle / len(values))
    ends = [min(values), max(values)]
    line = [scale * value**exponent for value in ends]
    axes.plot(ends, line, ":", color="0.4", label=f"fitted slope {exponent:.2f}")
    axes.legend(frameon=False, fontsize=8)
