"""The smallest family, to be read: what a family of models must have, and nothing else.

Frames come with two independent halves of their samples. The picture is their mean at twice the
size, mixed with the last picture; how much the halves differ is learned from frame to frame and
outlives cuts. No network runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.families.contract import Context, Request, State, Step, Traits
from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray.stages.plan import Plan, Stage
from stillray.timing import timed


@dataclass(frozen=True, kw_only=True, eq=False)
class SmallestPlan(Plan):
    """The decisions on a frame, with what they were taken on."""

    frame: Frame
    before: State | None


class Smallest:
    """A model of this family."""

    def __init__(self, spec: ModelSpec) -> None:
        self.traits = Traits(
            required=frozenset({"color", "color_b"}), scale=2, memory=None, linear=False
        )

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> SmallestPlan:
        """Decide by what there is: the same decisions are told, run and timed."""
        state = before if isinstance(before, State) and request.temporal else None
        past = state is not None and state.temporal is not None and state.shape == frame.shape
        why = "the last picture has this size" if past else "there is no last picture of this size"
        stages = (
            Stage("enlarge", True, "pictures are twice as large"),
            Stage("mix", past, why),
            Stage("learn", request.temporal, "the halves tell their noise"),
        )
        return SmallestPlan(stages=stages, frame=frame, before=state)

    def step(self, plan: Plan, context: Context) -> Step:
        """Run what was decided."""
        assert isinstance(plan, SmallestPlan)
        frame, before = plan.frame, plan.before
        assert frame.color_b is not None
        halves = (frame.color, frame.color_b)
        with timed(context.timings, "enlarge"):
            image = np.kron((halves[0] + halves[1]) / 2, np.ones((2, 2, 1), np.float32))
        if plan.runs("mix") and before is not None and isinstance(before.temporal, np.ndarray):
            with timed(context.timings, "mix"):
                image = (image + before.temporal) / 2

        def finish() -> State:  # after the picture: what takes time and nobody waits for
            learned = before.learned if before is not None else None
            if plan.runs("learn"):
                with timed(context.timings, "learn"):
                    noise = float(np.abs(halves[0] - halves[1]).mean())
                    learned = noise if not isinstance(learned, float) else (learned + noise) / 2
            return State(shape=frame.shape, temporal=image, learned=learned)

        return Step(image=image, finish=finish)
