"""A profile as a table and as JSON."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from stillray.models.frame_graph import describe_graph
from stillray.models.precision import integers_a_float
from stillray.profiling.measure import REST, TOTAL
from stillray.profiling.results import Result
from stillray.profiling.scaling import Curve

if TYPE_CHECKING:
    from rich.table import Table


def title(result: Result) -> str:
    """What was measured, in a line."""
    setting = result.run.setting
    options = "" if setting.temporal else ", each frame alone"
    provider = f", {setting.provider}" if setting.provider else ""
    return (
        f"{result.run.label}, {setting.width} x {setting.height}, "
        f"{setting.threads} thread{'s' if setting.threads > 1 else ''}{provider}{options}"
    )


def as_dict(results: Sequence[Result], machine: dict[str, str], frames: str) -> dict[str, Any]:
    """The profile as it is written to JSON: milliseconds, MiB, operations and bytes."""
    return {"machine": machine, "frames": frames, "runs": [_run(result) for result in results]}


def _run(result: Result) -> dict[str, Any]:
    run = result.run
    return {
        **asdict(run.setting),
        "model": run.info.name,
        "precision": run.precision,
        "buffers": list(run.buffers),
        "peaks": asdict(result.peaks),
        "memory_mib": None if result.memory is None else asdict(result.memory),
        "load_ms": run.load,
        "load_processor_ms": run.load_busy,
        "size_bytes": run.info.size_bytes,
        "operators": dict(run.info.operators),
        "first_frame_ms": run.first,
        "warm_frames": len(run.warm),
        "stages": {
            name: {
                **asdict(summary),
                **(asdict(result.work[name]) if name in result.work else {}),
                **_against_roofline(summary.median, result.roofline(name)),
            }
            for name, summary in run.stages().items()
        },
    }


def _against_roofline(median: float, roofline: float | None) -> dict[str, float]:
    return {} if not roofline else {"roofline": roofline, "ratio": median / roofline}


def table(result: Result) -> Table:
    """A row a stage: milliseconds, work, roofline and the ratio to it."""
    from rich.table import Table

    rows = Table(title=title(result), title_justify="left", box=None, pad_edge=False)
    rows.add_column("stage")
    times = ("median ms", "p95", "p99", "worst", "first")
    for heading in (*times, "GFLOP", "MB", "roofline", "ratio"):
        rows.add_column(heading, justify="right")
    for name, summary in result.run.stages().items():
        work, roofline = result.work.get(name), result.roofline(name)
        first = result.run.first.get(name)
        rows.add_row(
            name,
            *(f"{value:.1f}" for value in asdict(summary).values()),
            "" if first is None else f"{first:.1f}",
            "" if work is None else f"{work.operations / 1e9:.2f}",
            "" if work is None else f"{work.bytes / 1e6:.0f}",
            "" if not roofline else f"{roofline:.1f}",
            "" if not roofline else f"{summary.median / roofline:.1f}",
            style="bold" if name == TOTAL else None,
        )
    return rows


def remarks(result: Result) -> list[str]:
    """What the table does not hold."""
    run, peaks = result.run, result.peaks
    lines = [
        f"{len(run.warm)} warm frames; opening the model {run.load:.0f} ms "
        f"({run.load_busy:.0f} ms of processor time), first frame {run.first[TOTAL]:.0f} ms; "
        f"{TOTAL} is a frame without its files"
    ]
    if result.memory is not None:
        lines.append(
            f"peak memory {result.memory.peak:.0f} MiB, of which {result.memory.net:.0f} MiB "
            "over the frames and the libraries"
        )
    if run.info.ports is not None:
        lines.append(describe_graph(run.info.operators, run.info.size_bytes))
        return lines  # of a graph whose stages are not told apart there is no roofline
    if run.precision == "int8":
        lanes = integers_a_float()
        lines.append(f"the network computes in integers of 8 bits, {lanes} in the time of a float")
    lines.append(
        f"roofline: the slower of operations at {peaks.operations / 1e9:.0f} GFLOP/s (matrix "
        f"product) and bytes at {peaks.bandwidth / 1e9:.1f} GB/s (copy), measured here; {REST} is "
        "what no stage accounts for"
    )
    return lines


def curve_table(curve: Curve) -> Table:
    """A row a value: milliseconds, and memory where it was measured."""
    from rich.table import Table

    rows = Table(box=None, pad_edge=False)
    for heading in (curve.name, "median ms", *(["net MiB"] if curve.memory else [])):
        rows.add_column(heading, justify="right")
    memory = [[f"{net:.0f}"] for net in curve.memory] or [[] for _ in curve.values]
    for label, milliseconds, net in zip(curve.labels, curve.milliseconds, memory, strict=True):
        rows.add_row(label, f"{milliseconds:.1f}", *net)
    return rows


def curves_as_dict(curves: Sequence[Curve], machine: dict[str, str]) -> dict[str, Any]:
    """Curves as they are written to JSON."""
    return {
        "machine": machine,
        "curves": [
            {
                **asdict(curve),
                "exponent": curve.exponent,
                "memory_exponent": curve.memory_exponent,
            }
            for curve in curves
        ],
    }
