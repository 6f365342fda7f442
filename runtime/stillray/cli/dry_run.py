"""``stillray denoise --dry-run``: which frames, layers and stages there will be, and why."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from stillray.cli.reports import frames

if TYPE_CHECKING:
    from stillray.batch.api import PlannedShot
    from stillray.batch.file_layout import Layout, ViewFrame
    from stillray.batch.shot import RunStep, ShotFrame


def collect(shot: PlannedShot) -> dict[str, Any]:
    """What a run would do; reads the first two frames that it would run, at most.

    Raises
    ------
    InputError
        The run would be refused.
    """
    steps, layout = shot.steps, shot.layout
    shot.check()
    planned = {id(step.job): step for step in steps}
    facts: dict[str, Any] = {
        "model": shot.model.name,
        "frames": [_frame(job, planned.get(id(job))) for job in shot.jobs],
        "layers": {},
        "stages_first": [],
        "stages_following": [],
    }
    if not steps:
        return facts
    facts["layers"] = _layers(steps[0].job, layout)
    first = layout.read(steps[0].job.source, steps[0].job.companions, None)
    facts["stages_first"] = _stages(shot, [first])
    following = next((step for step in steps if not step.starts_anew), None)
    if following is not None:
        before = steps[steps.index(following) - 1].job.source
        views = layout.read(following.job.source, following.job.companions, before)
        # what a frame leaves to the next depends on its buffers, not on their values
        facts["stages_following"] = _stages(shot, [first, views])
    return facts


def show(facts: dict[str, Any], *, as_json: bool) -> None:
    """Print what `collect` found."""
    if as_json:
        print(json.dumps(facts, indent=2))
        return
    from rich.table import Table

    from stillray.cli.output import console

    out = console()
    table = Table("frame", "input", "output", "what", box=None, pad_edge=False)
    for frame in facts["frames"]:
        number = "" if frame["number"] is None else str(frame["number"])
        table.add_row(number, frame["source"], frame["output"] or "", frame["action"])
    out.print(table)
    for role, layer in facts["layers"].items():
        out.print(f"{role}: {', '.join(layer['channels'])} of {layer['file']}")
    for which, title in (("stages_first", "a first frame"), ("stages_following", "the next ones")):
        if not facts[which]:
            continue
        stages = Table("stage", "runs", "why", box=None, pad_edge=False)
        for stage in facts[which]:
            stages.add_row(stage["name"], "yes" if stage["runs"] else "no", stage["reason"])
        out.print(f"\nstages with {facts['model']}, for {title}:")
        out.print(stages)
    count = sum(frame["writes"] for frame in facts["frames"])
    out.print(f"\n{frames(count)} would be written; nothing has been")


def _frame(job: ShotFrame, step: RunStep | None) -> dict[str, Any]:
    if step is None:
        action = "not needed" if job.output is None else "done already"
    else:
        action = "denoise" if step.writes else "warm-up, not written"
        if step.starts_anew:
            action += ", history starts anew"
    return {
        "number": job.number,
        "source": str(job.source),
        "output": None if job.output is None else str(job.output),
        "action": action,
        "writes": step is not None and step.writes,
        "starts_anew": step is not None and step.starts_anew,
    }


def _layers(job: ShotFrame, layout: Layout) -> dict[str, Any]:
    from stillray.io.channels.roles import find_alone, find_layers
    from stillray.io.exr.file import ExrFile
    from stillray.io.image_file import is_float_map

    proven = layout.detection is not None and layout.detection.convention is not None
    layers = layout.of_views[0]
    if is_float_map(job.source):
        found: dict[str, Any] = {"color": {"file": str(job.source), "channels": ["its own"]}}
    else:
        file = ExrFile.of_layers(job.source, layers, headers_only=True)
        found = {
            match.role: {"file": str(job.source), "channels": list(match.channels)}
            for match in find_layers(file.channels, layers)
            if match.used or (match.role == "motion" and proven)
        }
    for role, path in job.companions.items():
        found[role] = {"file": str(path), "channels": ["its own"]}
        if not is_float_map(path):
            channels = list(ExrFile.open(path, headers_only=True).channels)
            match = find_alone(role, channels, layers)
            found[role]["channels"] = list(match.channels) if match else []
    return found


def _stages(shot: PlannedShot, frames: Sequence[Sequence[ViewFrame]]) -> list[dict[str, Any]]:
    """Of the last of consecutive frames, in its first view; every view is checked."""
    from stillray.pipeline.opening import network_path
    from stillray.pipeline.plan import Asked, plan_frames
    from stillray.pipeline.prefilter import foretold

    told, work = [], shot.work
    network = network_path(shot.model, work.precision, work.providers)
    for views in zip(*frames, strict=True):
        asked = Asked(
            model=shot.model.name,
            temporal=shot.options.temporal and shot.model.spec.knows_past,
            layers=list(views[-1].lights),
            max_memory=work.memory_of_view,
            integers=network != shot.model.path,
        )
        before = [foretold(view.frame, shot.model.spec) for view in views]
        plans = plan_frames([frame for _, frame in before], shot.family, asked)
        told.append([*before[-1][0], *plans[-1].stages])
    return [{"name": s.name, "runs": s.runs, "reason": s.reason} for s in told[0]]
