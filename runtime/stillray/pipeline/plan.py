"""What is asked of frames, checked and planned: for those that run and those that are told."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from dataclasses import dataclass

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families.contract import Context, Family, Request, State
from stillray.frame import Frame
from stillray.pipeline.tiles import MemoryUse, plan_tiles
from stillray.stages.plan import Plan

#: How a buffer that is missing comes about, where that is not plain.
_HOW = {"color_b": ": render the same frame again with another seed (--color-b)"}


@dataclass(frozen=True, kw_only=True)
class Asked:
    """What is asked of every frame of a stream.

    Attributes
    ----------
    model
        The model's name, for errors.
    temporal
        Whether frames are accumulated.
    layers
        Names of other layers that are to be filtered.
    max_memory
        Bytes that the process should stay below; None for whole frames.
    integers
        Whether the network computes in integers, which takes less.
    """

    model: str
    temporal: bool = True
    layers: Collection[str] = ()
    max_memory: int | None = None
    integers: bool = False

    def memory_use(self, frame: Frame) -> MemoryUse:
        """What decides how much memory a frame takes."""
        channels = frame.channels + 3 * len(self.layers)
        return MemoryUse(channels=channels, past=self.temporal, integers=self.integers)


def plan_frame(
    frame: Frame, before: State | Plan | None, family: Family, asked: Asked, context: Context
) -> Plan:
    """Decide what runs for a frame, and why.

    Parameters
    ----------
    frame
        The buffers.
    before, context
        As `Family.plan` takes them.
    family
        Of the model.
    asked
        What is wanted.

    Raises
    ------
    InputError
        The frame lacks a buffer that the model needs, does not fit into ``max_memory``, or other
        layers are asked for that the model or the memory does not allow.
    """
    traits, layers = family.traits, asked.layers
    # what a network has not learned from is not divided by either
    frame = frame.for_inputs(traits.required | traits.optional)
    if missing := sorted(traits.required - frame.given):
        how = _HOW.get(missing[0], "")
        raise InputError(f"{asked.model} needs the buffer {missing[0]}, which is not given{how}")
    use = asked.memory_use(frame)
    tiles = plan_tiles(frame.shape, use, traits, asked.max_memory, asked.model)
    if layers and not traits.linear:
        raise InputError(f"layers must be none with {asked.model}, got {', '.join(layers)}")
    if layers and len(tiles) > 1:
        raise InputError(
            f"max_memory must hold the whole frame where other layers are filtered too, got "
            f"{asked.max_memory} bytes for {frame.shape[1]} x {frame.shape[0]} pixels"
        )
    request = Request(
        temporal=asked.temporal, layers=frozenset(layers), tiles=tuple(tiles[1:] and tiles)
    )
    return family.plan(frame, before, request, context)


def plan_frames(frames: Iterable[Frame], family: Family, asked: Asked) -> list[Plan]:
    """What would run for frames in their order, the first of which begins anew.

    Raises
    ------
    InputError
        As `plan_frame`.
    """
    context = Context(strips=Strips(1))
    plans: list[Plan] = []
    for frame in frames:
        before = plans[-1] if plans else None
        plans.append(plan_frame(frame, before, family, asked, context))
    return plans


def require_memory(frame: Frame, family: Family, asked: Asked) -> None:
    """Raise `InputError` where not even tiles of a frame fit into what is asked, see `Asked`."""
    plan_tiles(frame.shape, asked.memory_use(frame), family.traits, asked.max_memory, asked.model)
