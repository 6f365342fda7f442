"""The plan in words: what will be simulated and which effect asked for it."""

from __future__ import annotations

from rich.console import Group, RenderableType
from rich.table import Table

from stillray_training.simulate.effects import EFFECTS
from stillray_training.simulate.plan import OPTION, Plan


def explain(plan: Plan) -> RenderableType:
    """Tables of effects, plugins, sample dimensions and buffers."""
    parts: list[RenderableType] = [
        f"{plan.world.label}: effects {', '.join(plan.effects) or 'none'}"
    ]
    left_out = [name for name in EFFECTS if name not in plan.effects]
    parts.append(f"not simulated: {', '.join(left_out) or 'nothing'}")
    depth = " + ".join(f"{bounces} ({who})" for bounces, who in plan.depth)
    parts.append(f"integrator {plan.integrator.plugin}, depth {depth}")
    parts.append(
        f"shutter open for {plan.shutter:g} of the frame time (motion_blur)"
        if plan.shutter
        else "one shutter time a frame"
    )
    if plan.motions:
        parts.append(f"moves: {', '.join(plan.motions)}")
    plugins = _table("plugin", "count", "asked by")
    for (plugin, who), count in sorted(plan.plugins().items(), key=lambda item: item[0][::-1]):
        plugins.add_row(plugin, str(count), who)
    dimensions = _table("sample dimension", "numbers", "asked by")
    for d in plan.dimensions:
        dimensions.add_row(d.name, f"{d.size} a {d.per}", d.asked_by)
    buffers = _table("buffer", "channels", "asked by")
    for b in plan.buffers:
        buffers.add_row(b.name, str(b.channels), b.asked_by)
    if plan.wants.jitter:
        buffers.add_row("jitter", "2 a frame", OPTION)
    return Group(*parts, plugins, dimensions, buffers)


def _table(*columns: str) -> Table:
    table = Table(box=None, padding=(0, 2, 0, 0), header_style="bold")
    for column in columns:
        table.add_column(column)
    return table
