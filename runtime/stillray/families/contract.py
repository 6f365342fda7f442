"""All that the rest of stillray knows of a family of models.

A stream of frames asks the family for a plan of each frame, then for a step: the plan says what
will run and why, the step does that, and gives the picture and what to remember. What a family
remembers is its own: everybody else keeps a `State`, drops it or hands it back.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, runtime_checkable

import numpy as np

from stillray.arrays.strips import Strips
from stillray.arrays.tiles import Tile
from stillray.arrays.workspace import Workspace
from stillray.frame import Frame
from stillray.stages.plan import Plan


@dataclass(frozen=True, kw_only=True)
class Traits:
    """What callers must know of a model before a frame runs.

    Attributes
    ----------
    required, optional
        Names of the buffers of `Frame` that are looked at; those required are checked by callers.
    scale
        Pixels of the picture for one of the frame, along each axis.
    tile_alignment
        What tiles begin at multiples of, pixels.
    tile_overlap
        Pixels to each side that a tile must see, a multiple of the alignment; None if frames must
        be whole.
    memory
        Frames back that change a picture noticeably; None for all.
    linear
        Whether other layers of a frame can be filtered by the weights of its color.
    integers
        Whether what the network gives may come as integers, see `stillray.models.steps.InSteps`.
    views
        Pictures of a frame that are averaged; a second one takes memory beside the first.
    """

    required: frozenset[str]
    memory: int | None
    optional: frozenset[str] = frozenset()
    scale: int = 1
    tile_alignment: int = 1
    tile_overlap: int | None = None
    linear: bool = True
    integers: bool = False
    views: int = 1


@dataclass(frozen=True, kw_only=True, eq=False)
class State:
    """What is remembered between frames: a value, which only its family opens.

    Attributes
    ----------
    shape
        Height and width of the input frame that made it, pixels.
    temporal
        What holds until the next cut: accumulated light, geometry, the previous output.
    learned
        What outlives cuts: weights that are learned from frame to frame.
    """

    shape: tuple[int, int]
    temporal: object | None
    learned: object | None = None

    def after_cut(self) -> State | None:
        """What is left at a cut, if anything."""
        return None if self.learned is None else replace(self, temporal=None)


@dataclass(frozen=True, kw_only=True)
class Request:
    """What is asked of a frame.

    Attributes
    ----------
    temporal
        Whether the past is used, and this frame remembered.
    layers
        Names of other layers that will be filtered, see `Step.filter_layer`.
    tiles
        In which the picture is made; none for the whole frame at once.
    """

    temporal: bool = True
    layers: frozenset[str] = frozenset()
    tiles: tuple[Tile, ...] = ()


class Engine(Protocol):
    """Where the graphs of a model run."""

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, Any]:
        """The outputs of a graph by name, without their batch axis: arrays, or `InSteps`.

        Parameters
        ----------
        graph
            ``"network"``; families that learn have others.
        inputs
            By name, as the graph takes them.
        """
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Context:
    """The means of a call, not its data.

    Attributes
    ----------
    strips
        Where work on pixels runs.
    engine
        Where graphs run; None for a plan alone.
    workspace
        Arrays that are kept from frame to frame.
    timings
        Stage name to milliseconds, filled in.
    back_buffer
        A state that nobody needs any more: its arrays may be overwritten.
    """

    strips: Strips
    engine: Engine | None = None
    workspace: Workspace = field(default_factory=Workspace)
    timings: dict[str, float] = field(default_factory=dict)
    back_buffer: State | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Layer:
    """Another layer of a frame.

    Attributes
    ----------
    radiance : (h, w, 3) float32
        Of any sign; not finite counts as 0.
    irradiance
        Whether it is without the colour of surfaces: it is not divided by it.
    is_light
        Whether outliers darken it, edges of the picture sharpen it and relief shades it, as they do
        the color; alpha is none.
    """

    radiance: np.ndarray
    irradiance: bool = False
    is_light: bool = True


class LayerFilter(Protocol):
    """Filters another layer of a frame exactly as its color was."""

    def __call__(self, name: str, layer: Layer) -> np.ndarray:
        """The layer, ``(h, w, 3)`` float32, filtered; its past is remembered by its name.

        The name is one of the request's.
        """
        ...


@dataclass(frozen=True, kw_only=True, eq=False)
class Step:
    """What a frame gave.

    Attributes
    ----------
    image : (h * scale, w * scale, 3) float32
        Scene-linear radiance.
    filter_layer
        For the layers of the request; None without any, or where the family is not linear.
    finish
        Work after the picture, such as the past of layers or a training step; called once, last.
        Gives what to remember.
    """

    image: np.ndarray
    finish: Callable[[], State]
    filter_layer: LayerFilter | None = None


class Family(Protocol):
    """One model of a family: its specification, read."""

    traits: Traits

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> Plan:
        """Decide what runs for a frame, and why.

        Parameters
        ----------
        frame
            The buffers.
        before
            What is remembered; or the plan of the frame before, for a plan that is only told.
        request
            What is asked for.
        context
            Where a look at the buffers runs.
        """
        ...

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned."""
        ...


@runtime_checkable
class Keeps(Protocol):
    """A family whose states can be written to files."""

    def pack(self, state: State) -> dict[str, np.ndarray]:
        """A state as float32 arrays by name."""
        ...

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> State:
        """`pack` undone; `InputError` where the arrays are not those of a state."""
        ...
