"""Online denoising with cross-regression (Choi et al. 2024): what it knows, it learns from a shot.

Two halves of a frame's samples make two pilot estimates, each by regression on the other half; a
small network sets a filter over both and the past; and one step of learning a frame, which takes
the halves for each other's reference, moves the network's weights.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips, planes_of, without_fourth
from stillray.errors import InputError
from stillray.families import filter_network
from stillray.families.contract import Context, Engine, Request, State, Step, Traits
from stillray.families.cross_bilateral import Estimates, cross_bilateral
from stillray.families.cross_regression import pilots
from stillray.families.online_learning import Learned, Learner, Lesson
from stillray.families.online_past import (
    Past,
    guides_of,
    logarithm,
    nothing,
    radiance_of,
    warp,
)
from stillray.frame import Frame
from stillray.model_spec.loader import CrossBilateral, FilterNetwork, ModelSpec
from stillray.model_spec.network_weights import network_weights
from stillray.stages import features
from stillray.stages.plan import Plan, Stage
from stillray.stages.repair import MAX_RADIANCE, Buffers, all_within, repair_radiance
from stillray.timing import timed

_log = logging.getLogger("stillray")
_COLORS = 3
_VECTORS = ("weights", "first", "second", "kept")
_PLANES = ("output", "pilot_a", "pilot_b")
_MOST_PIXELS = 2**16  # of a side
#: Chessboard of a window's neighbours, see `cross_bilateral.taps`; the graph of a step has it too.
CHECKERED = True


@dataclass(frozen=True, kw_only=True, eq=False)
class OnlinePlan(Plan):
    """The decisions on a frame, with what they were taken on.

    Attributes
    ----------
    buffers
        The frame's, repaired.
    second : (h, w, 3) float32
        The other half of its samples, repaired.
    past, learned
        What is remembered; None where the frame begins anew, or nothing was learned.
    """

    buffers: Buffers
    second: np.ndarray
    past: Past | None
    learned: Learned | None


class OnlineModel:
    """A model that learns while it denoises.

    Parameters
    ----------
    spec
        The model's specification.
    """

    def __init__(self, spec: ModelSpec) -> None:
        if not isinstance(spec.network, FilterNetwork) or not isinstance(
            spec.decoder, CrossBilateral
        ):
            raise TypeError(f"{spec.name} is of another family: {spec.family}")
        self.spec, self._options = spec, spec.decoder
        self._shapes = network_weights(spec)
        self._multiple = 2 ** (len(spec.network.widths) - 1)
        self.traits = Traits(
            required=frozenset(spec.inputs.required),
            optional=frozenset(spec.inputs.optional),
            memory=None,
            linear=False,
        )

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> OnlinePlan:
        """Decide what runs for a frame, and why; see `Family`."""
        assert frame.color_b is not None
        buffers, second = Buffers.of(frame), frame.color_b
        with timed(context.timings, "inspect"):
            whole = all(context.strips.run(buffers.in_range, *frame.shape))
            whole = whole and all_within(second, 0, MAX_RADIANCE, context.strips)
        if not whole:
            with timed(context.timings, "repair"):
                empty = frame.samples == 0 if isinstance(frame.samples, np.ndarray) else None
                buffers = buffers.repaired(context.strips)
                second = repair_radiance(second, empty, context.strips)[0]
        past, learned, why = _remembered(frame.shape, before, request)
        moves = past and frame.motion is not None
        if past and not moves:
            why = "no motion given: where the past went is not known"
        stages = (
            Stage("inspect", True, "values tell what a frame calls for"),
            Stage("repair", not whole, "a value is NaN, infinite or out of its range"
                  if not whole else "every value is finite and in its range"),
            Stage("expose", True, "logarithms are of exposed radiance"),
            Stage("regress", True, "each half of the samples explains the other"),
            Stage("warp", bool(moves), why or "history and motion are there"),
            Stage("encode", True, f"{len(self.spec.network.features)} planes for the network"),
            Stage("network", True, self.spec.name),
            Stage("filter", True, "a cross-bilateral window around each pixel"),
            Stage("learn", request.temporal, "one step a frame" if request.temporal
                  else "temporal accumulation is switched off: nothing is kept"),
            Stage("remember", request.temporal, "the next frame looks back"),
        )  # fmt: skip
        state = before if isinstance(before, State) else None
        held = state.temporal if state is not None and moves else None
        return OnlinePlan(
            stages=stages,
            buffers=buffers,
            second=second,
            past=held if isinstance(held, Past) else None,
            learned=learned,
        )

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned; see `Family`."""
        assert isinstance(plan, OnlinePlan)
        assert context.engine is not None
        engine = context.engine
        shape = (plan.second.shape[0], plan.second.shape[1])
        exposure, (first, second) = self._exposed(plan, context)
        guides = _guide_planes(plan.buffers, context)
        with timed(context.timings, "regress"):
            both = self.pilots(first, second, guides, context.strips)
        warped = nothing(shape)
        if plan.past is not None and plan.runs("warp"):
            with timed(context.timings, "warp"):
                options = self.spec.temporal
                warped = warp(plan.past, plan.buffers, exposure, options, context)
        with timed(context.timings, "encode"):
            planes = self._encode((both, guides, warped.output), context)
        learned = plan.learned or Learned.begin(
            filter_network.join(engine.run("weights", {}), self._shapes)
        )
        with timed(context.timings, "network"):
            weights = filter_network.split(learned.weights, self._shapes)
            (theta,) = engine.run("network", {"features": planes, **weights}).values()
        with timed(context.timings, "filter"):
            estimates = Estimates(
                values=both,
                guides=_tell_apart(both, guides, context),
                past=warped.output,
                valid=warped.pilots[-1],
            )
            log = cross_bilateral(estimates, theta, context.strips, checkered=CHECKERED)
            output = radiance_of(log, exposure, context.strips)
            image = without_fourth(output, context.strips)

        def finish() -> State:
            after: Learned | None = None
            if plan.runs("learn"):
                with timed(context.timings, "learn"):
                    after = self._learn(learned, Lesson(planes, warped.pilots), engine)
            past: Past | None = None
            if plan.runs("remember"):
                with timed(context.timings, "remember"):
                    pilot_a, pilot_b = (
                        radiance_of(pilot, exposure, context.strips) for pilot in both
                    )
                    past = Past(
                        output=output,
                        pilot_a=pilot_a,
                        pilot_b=pilot_b,
                        guides=guides_of(plan.buffers, context.strips),
                        exposure=exposure,
                    )
            return State(shape=shape, temporal=past, learned=after)

        return Step(image=image, finish=finish)

    def pilots(
        self, first: np.ndarray, second: np.ndarray, guides: np.ndarray, strips: Strips
    ) -> np.ndarray:
        """What the filter is given, ``(2, 3, h, w)``; ablations give it something else."""
        return pilots(first, second, guides, strips)

    def pack(self, state: State) -> dict[str, np.ndarray]:
        """A state as arrays by name, of which `unpack` makes the same state.

        Numbers of steps are float32, exact up to 2 ** 24.
        """
        arrays = {"shape": np.array(state.shape, np.float32)}
        if isinstance(state.learned, Learned):
            learned = state.learned
            arrays |= {name: getattr(learned, name) for name in _VECTORS}
            arrays["steps"] = np.array([learned.steps, learned.adam_steps], np.float32)
        if isinstance(state.temporal, Past):
            past = state.temporal
            arrays |= {name: getattr(past, name) for name in _PLANES}
            # a float64 in two float32: the exposure goes on exactly as it was
            high = np.float32(past.exposure)
            arrays["exposure"] = np.array([high, past.exposure - float(high)], np.float32)
            if past.guides is not None:
                arrays["guides"] = past.guides
        return arrays

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> State:
        """`pack` undone.

        Raises
        ------
        InputError
            The arrays are not those of a state of this model.
        """
        shape = arrays.get("shape", np.empty(0, np.float32))
        if shape.shape != (2,) or not (shape >= 1).all() or not (shape <= _MOST_PIXELS).all():
            raise InputError(f"state must be one of {self.spec.name}: it has no shape of a frame")
        height, width = (int(size) for size in shape)
        count = sum(math.prod(part) for _, part in self._shapes)
        sizes: dict[str, tuple[int, ...]] = {name: (count,) for name in _VECTORS}
        sizes |= {name: (height, width, 4) for name in (*_PLANES, "guides")}
        sizes |= {"steps": (2,), "exposure": (2,), "shape": (2,)}
        for name, array in arrays.items():
            if array.shape != sizes.get(name):
                raise InputError(
                    f"state must be one of {self.spec.name}, got {name} of shape {array.shape}"
                )
        return State(
            shape=(height, width), temporal=_unpack_past(arrays), learned=_unpack_learned(arrays)
        )

    def _exposed(self, plan: OnlinePlan, context: Context) -> tuple[float, np.ndarray]:
        """The exposure, and logarithms of both halves, ``(2, 3, h, w)``."""
        halves, strips = (plan.buffers.color, plan.second), context.strips
        shape = (plan.second.shape[0], plan.second.shape[1])
        light = context.workspace.array("light", shape)
        logs = context.workspace.array("logarithms", (2, _COLORS, *shape))

        def add(rows: slice) -> None:
            # summed at half their size: the sum of two of the brightest is no float32
            first, second = (half[rows] * np.float32(0.5) for half in halves)
            features.luminance(first + second, out=light[rows])

        def expose(rows: slice) -> None:
            for half, log in zip(halves, logs, strict=True):
                log[:, rows] = logarithm(planes_of(half[rows]), exposure)

        with timed(context.timings, "expose"):
            strips.run(add, *shape)
            exposure = features.frame_exposure(light, self.spec.transfer)
            if plan.past is not None:
                before = plan.past.exposure
                exposure = features.steady_exposure(exposure, before, self.spec.transfer)
            strips.run(expose, *shape, pixels=STRIP_PIXELS // 2)
        return exposure, logs

    def _encode(self, given: Sequence[np.ndarray], context: Context) -> np.ndarray:
        """The network's input, ``(1, 15, H, W)``, of a size that it takes.

        It grows by repeating the last column and row. ``given`` are its planes, ``(..., h, w)``.
        """
        parts = [planes.reshape(-1, *planes.shape[-2:]) for planes in given]
        full = [-(-size // self._multiple) * self._multiple for size in parts[0].shape[1:]]
        planes = context.workspace.array("features", (1, sum(map(len, parts)), *full))

        def fill(rows: slice) -> None:
            first = 0
            for part in parts:
                surround(part, planes[0, first : first + len(part)], 0, rows)
                first += len(part)

        context.strips.run(fill, full[0], full[1], pixels=STRIP_PIXELS // 2)
        return planes

    def _learn(self, learned: Learned, lesson: Lesson, engine: Engine) -> Learned:
        learner = Learner(engine, rate=self._options.learning_rate, seed=self.spec.training.seed)
        after, why = learner.step(learned, lesson)
        if why:
            _log.warning("%s: learning was set back: %s", self.spec.name, why)
        return after


def _unpack_learned(arrays: Mapping[str, np.ndarray]) -> Learned | None:
    if not {*_VECTORS, "steps"} <= arrays.keys() or arrays["steps"].min() < 0:
        return None
    steps, adam_steps = (int(number) for number in arrays["steps"])
    vectors = {name: arrays[name] for name in _VECTORS}
    return Learned(steps=steps, adam_steps=adam_steps, **vectors)


def _unpack_past(arrays: Mapping[str, np.ndarray]) -> Past | None:
    if not {*_PLANES, "exposure"} <= arrays.keys():
        return None
    exposure = float(arrays["exposure"].astype(np.float64).sum())
    if exposure <= 0:
        return None
    planes = {name: arrays[name] for name in _PLANES}
    return Past(exposure=exposure, guides=arrays.get("guides"), **planes)


def _guide_planes(buffers: Buffers, context: Context) -> np.ndarray:
    """Albedo and normals, ``(6, h, w)``; 0 where they are not given: they tell nothing apart."""
    given = (buffers.albedo, buffers.normal)
    guides = context.workspace.array("guides", (2, _COLORS, *buffers.color.shape[:2]))

    def work(rows: slice) -> None:
        for planes, buffer in zip(guides, given, strict=True):
            planes[:, rows] = 0 if buffer is None else planes_of(buffer[rows])

    context.strips.run(work, *guides.shape[2:])
    return guides.reshape(-1, *guides.shape[2:])


def _tell_apart(both: np.ndarray, guides: np.ndarray, context: Context) -> np.ndarray:
    """What bands are of, ``(4, 3, h, w)``: both estimates, albedo and normals."""
    found = context.workspace.array("bands", (4, *both.shape[1:]))

    def work(rows: slice) -> None:
        found[:2, :, rows] = both[:, :, rows]
        found[2:, :, rows] = guides[:, rows].reshape(2, _COLORS, -1, both.shape[-1])

    context.strips.run(work, *both.shape[2:])
    return found


def _remembered(
    shape: tuple[int, int], before: State | Plan | None, request: Request
) -> tuple[bool, Learned | None, str]:
    """Whether there is a past of this size, what was learned, and why there is no past."""
    if not request.temporal:
        return False, None, "temporal accumulation is switched off"
    if isinstance(before, OnlinePlan):  # a plan that is only told
        held, size, learned = before.runs("remember"), before.second.shape[:2], None
    elif isinstance(before, State):
        held, size = isinstance(before.temporal, Past), before.shape
        learned = before.learned if isinstance(before.learned, Learned) else None
    else:
        held, size, learned = False, shape, None
    if not held or size != shape:
        return False, learned, "first frame, or the first after a reset or a new size"
    return True, learned, ""
