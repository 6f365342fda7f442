"""Plans of a sequence's frames that are told, not run."""

from __future__ import annotations

from collections.abc import Iterable

from stillray.arrays.strips import Strips
from stillray.families.contract import Context, Family, Request
from stillray.frame import Frame
from stillray.stages.plan import Plan


def plan_frames(frames: Iterable[Frame], family: Family, *, temporal: bool) -> list[Plan]:
    """What would run for frames in their order, the first of which begins anew."""
    request, strips = Request(temporal=temporal), Strips(1)
    plans: list[Plan] = []
    for frame in frames:
        before = plans[-1] if plans else None
        plans.append(family.plan(frame, before, request, Context(strips=strips)))
    return plans
