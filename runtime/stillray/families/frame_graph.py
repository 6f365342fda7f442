"""A model whose stages are all in one graph, which runs where it is told to.

Nothing is computed here: buffers are handed over, the picture is handed back, and the state is the
graph's own, kept where it was made.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.families.contract import Context, Request, State, Step, Traits
from stillray.frame import Frame
from stillray.models.frame_graph import Port, Ports
from stillray.stages.plan import Plan, Stage
from stillray.timing import timed

#: Frames that a frame's history is taken to go back, as of the same models in stages.
MEMORY_FRAMES = 32
#: The one stage, and the name of the graph.
FRAME = "frame"
_PICTURE = "denoised"
_NUMBER = re.compile(r"-?\d{1,3}(e\d{1,2})?", re.ASCII)
_MOST_CHANNELS = 64
# Buffers that the past must agree in: with others, what it holds of surfaces means nothing.
_GEOMETRY = frozenset({"normal", "depth"})


@dataclass(frozen=True, eq=False)
class Remembered:
    """What the next frame takes.

    Attributes
    ----------
    tensors
        The graph's state by the names of its inputs, where the graph runs.
    geometry
        Which of normal and depth the frame had.
    """

    tensors: Mapping[str, Any]
    geometry: frozenset[str]


@dataclass(frozen=True, kw_only=True, eq=False)
class FramePlan(Plan):
    """The decisions on one frame.

    Attributes
    ----------
    shape
        Height and width, pixels.
    frame
        What is handed over.
    past
        None where the frame begins anew.
    """

    shape: tuple[int, int]
    frame: Frame
    past: Remembered | None


class FrameGraphModel:
    """A model as a frame graph.

    Parameters
    ----------
    ports
        What the graph takes and gives.
    where
        Which provider runs it, and where its state is kept, in words.

    Raises
    ------
    InputError
        The graph takes what no frame holds, or does not give a picture and its next state.
    """

    def __init__(self, ports: Ports, where: str) -> None:
        _require_frames(ports)
        self._buffers = [port for port in ports.inputs if not port.next]
        self._states = [port for port in ports.inputs if port.next]
        self._where = where
        self.traits = Traits(
            required=frozenset(port.name for port in self._buffers if not port.neutral),
            optional=frozenset(port.name for port in self._buffers if port.neutral),
            memory=MEMORY_FRAMES,
            linear=False,
        )

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> FramePlan:
        """Decide what runs for a frame, and why; see `Family`."""
        past = before.temporal if isinstance(before, State) else None
        past = past if isinstance(past, Remembered) else None
        geometry, shape = frame.given & _GEOMETRY, None if before is None else _shape(before)
        if isinstance(before, FramePlan):  # only told: it leaves what is not there yet
            past = Remembered({}, before.frame.given & _GEOMETRY)
        why = ""
        if not request.temporal:
            why = "temporal accumulation is switched off"
        elif past is None or shape != frame.shape:
            why = "first frame, or the first after a reset or a new size"
        elif past.geometry != geometry:
            why = "normal or depth were given in one of this frame and the last"
        told = f"begins anew: {why}" if why else "goes on from the last frame's"
        stage = Stage(FRAME, True, f"all stages in one graph on {self._where}; the state {told}")
        return FramePlan(
            stages=(stage,), shape=frame.shape, frame=frame, past=None if why else past
        )

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned; see `Family`."""
        assert isinstance(plan, FramePlan)
        assert context.engine is not None
        inputs = {port.name: _buffer(port, plan.frame) for port in self._buffers}
        for port in self._states:
            inputs[port.name] = plan.past.tensors[port.name] if plan.past else _neutral(port)
        with timed(context.timings, FRAME):
            left = context.engine.run(FRAME, inputs)
        remembered = Remembered(
            {port.name: left[port.next] for port in self._states}, plan.frame.given & _GEOMETRY
        )

        def finish() -> State:
            return State(shape=plan.shape, temporal=remembered)

        return Step(image=left[_PICTURE], finish=finish)


def _require_frames(ports: Ports) -> None:
    buffers = {port.name for port in ports.inputs if not port.next}
    if others := sorted(buffers - {buffer.name for buffer in fields(Frame)}):
        raise InputError(f"frame graph must take buffers of a frame, takes {others[0]}")
    given = {port.name for port in ports.outputs}
    wanted = {_PICTURE} | {port.next for port in ports.inputs if port.next}
    if missing := sorted(wanted - given):
        raise InputError(f"frame graph must give {missing[0]}, which it does not")
    for port in ports.inputs:
        if port.neutral and not _NUMBER.fullmatch(port.neutral):
            raise InputError(
                f"frame graph's {port.name} must have a neutral number, got {port.neutral}"
            )
        if any(part.isdigit() and int(part) > _MOST_CHANNELS for part in port.shape.split(", ")):
            raise InputError(
                f"frame graph's {port.name} must have {_MOST_CHANNELS} channels at most, "
                f"got {port.shape}"
            )


def _shape(before: State | Plan) -> tuple[int, int] | None:
    return before.shape if isinstance(before, State | FramePlan) else None


def _buffer(port: Port, frame: Frame) -> np.ndarray:
    """A buffer as the graph takes it; its neutral value where it is not given."""
    value = getattr(frame, port.name)
    if value is None:
        return _neutral(port)
    if np.ndim(value) == 0:  # one number for all pixels
        return np.full(_shape_of_one(port), value, np.float32)
    return np.asarray(value, np.float32)


def _neutral(port: Port) -> np.ndarray:
    return np.full(_shape_of_one(port), float(port.neutral), np.float32)


def _shape_of_one(port: Port) -> tuple[int, ...]:
    """A port's shape with 1 in the place of every size."""
    return tuple(int(part) if part.isdigit() else 1 for part in port.shape.split(", "))
