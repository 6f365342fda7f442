"""Online denoising with cross-regression (Choi et al. 2024): what it knows, it learns from a shot.

Two halves of a frame's samples make two pilot estimates, each by regression on the other half; a
small network sets a filter over both and the past; and one step of learning a frame, which takes
the halves for each other's reference, moves the network's weights.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.arrays.extend import surround
from stillray.arrays.strips import STRIP_PIXELS, Strips, planes_of, with_halo
from stillray.families import filter_network
from stillray.families.contract import Context, Engine, Request, State, Step, Traits
from stillray.families.cost import cross_bilateral_cost, cross_regression_cost
from stillray.families.cross_bilateral import Estimates, cross_bilateral, taps
from stillray.families.cross_regression import LINES, Guides, pilots
from stillray.families.online_learning import Learned, Learner, Lesson
from stillray.families.online_past import (
    Past,
    exposed,
    exposure_of,
    picture_of_past,
    radiance_of,
)
from stillray.families.online_state import pack, unpack
from stillray.frame import Frame
from stillray.model_spec.decoders import CrossBilateral
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.network_weights import network_weights
from stillray.model_spec.networks import FilterNetwork
from stillray.stages import previous_output
from stillray.stages.decide import TemporalPlan, Wants, decide
from stillray.stages.means import Means
from stillray.stages.plan import Plan, Stage
from stillray.stages.prepare import prepare_planned
from stillray.stages.state import History, Prepared
from stillray.timing import timed

_log = logging.getLogger("stillray")
_COLORS = 3
#: Differences of albedo and of normals at which a pixel counts 1/e in the regression.
GUIDE_UNITS = np.array([0.15] * 3 + [0.5] * 3, np.float32)
# Of the guides, those that explain light in the regression (differs: all): normals, the last three.
# Light was divided by the albedo.
_EXPLAINING = 3
_CHANGE = np.float32(0.3)  # of albedo or of a normal's component: an edge
#: A part of a window's neighbours, see `cross_bilateral.taps`; the graph of a step has it too.
THINNED = True


@dataclass(frozen=True, kw_only=True, eq=False)
class OnlinePlan(Plan):
    """The decisions on a frame, with what they were taken on.

    Attributes
    ----------
    first, second
        Those on either half of the samples, up to what it has accumulated.
    past, learned
        What is remembered; None where the frame begins anew, or nothing was learned.
    """

    first: TemporalPlan
    second: TemporalPlan
    past: Past | None
    learned: Learned | None


_Half = History | TemporalPlan | None


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
        # the second half takes its geometry and its albedo from the first
        self._specs = (spec, replace(spec, temporal=replace(spec.temporal, albedo_samples=0.0)))
        self._shapes = network_weights(spec)
        #: What a network's height and width are multiples of, pixels.
        self.alignment = 2 ** (len(spec.network.widths) - 1)
        self.traits = Traits(
            required=frozenset(spec.inputs.required),
            optional=frozenset(spec.inputs.optional),
            memory=None,
            linear=False,
        )

    @property
    def costs(self) -> dict[str, tuple[float, float]]:
        """Operations and planes a pixel of the stages that are this family's alone."""
        guides = len(GUIDE_UNITS)
        return {
            "regress": cross_regression_cost(LINES, 1 + _COLORS + _EXPLAINING, guides),
            "filter": cross_bilateral_cost(len(taps(THINNED))),
        }

    def plan(
        self, frame: Frame, before: State | Plan | None, request: Request, context: Context
    ) -> OnlinePlan:
        """Decide what runs for a frame, and why; see `Family`."""
        assert frame.color_b is not None
        temporal, (held, other, learned) = request.temporal, _remembered(before, request)
        strips, timings = context.strips, context.timings
        wants = Wants(temporal=temporal, previous_output=temporal)
        first = decide(frame, self._specs[0], held, strips, timings, wants)
        half = replace(frame, color=frame.color_b, color_b=None)
        wants = Wants(temporal=temporal)
        second = decide(half, self._specs[1], other, strips, timings, wants)
        moves = first.runs("reproject")
        repairs = second.runs("repair")
        stages = (
            *(stage if stage.name != "repair" or not repairs else _stage(second, "repair")
              for stage in first.stages),
            Stage("regress", True, "each half of the samples explains the other"),
            Stage("warp", moves, "the last picture, along motion" if moves
                  else _stage(first, "reproject").reason),
            Stage("encode", True, f"{len(self.spec.network.features)} planes for the network"),
            Stage("network", True, self.spec.name),
            Stage("filter", True, "a cross-bilateral window around each pixel"),
            Stage("learn", temporal, "one step a frame" if temporal
                  else "temporal accumulation is switched off: nothing is kept"),
            Stage("remember", temporal, "the next frame looks back"),
        )  # fmt: skip
        past = before.temporal if isinstance(before, State) else None
        return OnlinePlan(
            stages=stages,
            first=first,
            second=second,
            past=past if isinstance(past, Past) and first.past is not None else None,
            learned=learned,
        )

    def step(self, plan: Plan, context: Context) -> Step:
        """Run a frame as it was planned; see `Family`."""
        assert isinstance(plan, OnlinePlan)
        assert context.engine is not None
        engine, strips = context.engine, context.strips
        prepared, other, picture = self._accumulate(plan, context)
        exposure = exposure_of(prepared.history, other)
        with timed(context.timings, "regress"):
            guides = _guide_planes(prepared, context)
            both = self._regressed((prepared.history, other), exposure, guides, strips)
        shape, albedo = plan.first.shape, prepared.remodulation_albedo
        last = np.zeros((4, *shape), np.float32)
        if plan.runs("warp") and picture is not None:
            with timed(context.timings, "warp"):
                last = picture_of_past(picture, both, albedo, exposure, context)
        with timed(context.timings, "encode"):
            planes = self._encode((both, guides, last[:3]), context)
        learned = plan.learned or Learned.begin(
            filter_network.join(engine.run("weights", {}), self._shapes)
        )
        with timed(context.timings, "network"):
            weights = filter_network.split(learned.weights, self._shapes)
            (theta,) = engine.run("network", {"features": planes, **weights}).values()
        with timed(context.timings, "filter"):
            estimates = Estimates(
                values=both,
                guides=guides.reshape(2, _COLORS, *shape),
                past=last[:3],
                valid=last[3],
                edges=_edges(guides, context),
            )
            filtered = self.filter(estimates, theta, strips)
            image = radiance_of(filtered, exposure, albedo, strips)

        def halves(part: tuple[slice, slice]) -> np.ndarray:
            means = (prepared.history.mean[part], other.mean[part])
            return np.concatenate([exposed(mean, exposure, strips) for mean in means])

        def finish() -> State:
            after: Learned | None = None
            if plan.runs("learn"):
                with timed(context.timings, "learn"):
                    after = self._learn(learned, Lesson(planes, shape, halves), engine)
            past: Past | None = None
            if plan.runs("remember"):
                with timed(context.timings, "remember"):
                    output = previous_output.keep(image, strips)
                    past = Past(
                        first=replace(prepared.history, output=output),
                        # for its edges, which are those of both halves
                        second=replace(other, output=output),
                    )
            return State(shape=shape, temporal=past, learned=after)

        return Step(image=image, finish=finish)

    def _accumulate(
        self, plan: OnlinePlan, context: Context
    ) -> tuple[Prepared, History, np.ndarray | None]:
        """Both halves, each on its own past, and the last picture at these pixels."""

        def means(spec: ModelSpec) -> Means:
            return Means(
                spec=spec,
                strips=context.strips,
                timings=context.timings,
                workspace=context.workspace,
            )

        # the second first: what the workspace then holds of it, the other one overwrites
        specs = self._specs
        other = prepare_planned(plan.second, means(specs[1])).history
        prepared = prepare_planned(plan.first, means(specs[0]))
        other = replace(other, surface_guides=prepared.history.surface_guides)
        picture: np.ndarray | None = None
        if plan.runs("resample_output") and plan.first.past is not None:
            with timed(context.timings, "resample_output"):
                picture = previous_output.resampled(
                    plan.first.past, prepared, context.strips, context.workspace, sharp=True
                )
        return prepared, other, picture

    def _regressed(
        self, halves: tuple[History, History], exposure: float, guides: np.ndarray, strips: Strips
    ) -> np.ndarray:
        """`pilots` of what both halves hold; exposed, that is held no longer than it takes."""
        first, second = (exposed(half.mean, exposure, strips) for half in halves)
        return self.pilots(first, second, guides, strips)

    def pilots(
        self, first: np.ndarray, second: np.ndarray, guides: np.ndarray, strips: Strips
    ) -> np.ndarray:
        """What the filter is given, ``(2, 3, h, w)``; ablations give it something else."""
        return pilots((first, second), Guides(guides, GUIDE_UNITS, _EXPLAINING), strips)

    def filter(self, estimates: Estimates, theta: np.ndarray, strips: Strips) -> np.ndarray:
        """The picture's irradiance, ``(3, h, w)``, as `Estimates` are; for ablations as well."""
        return cross_bilateral(estimates, theta, strips, thinned=THINNED)

    def pack(self, state: State) -> dict[str, np.ndarray]:
        """A state as arrays by name, of which `unpack` makes the same state."""
        return pack(state, self.spec.name)

    def unpack(self, arrays: Mapping[str, np.ndarray]) -> State:
        """`pack` undone.

        Raises
        ------
        InputError
            The arrays are not those of a state of this model.
        """
        count = sum(math.prod(part) for _, part in self._shapes)
        return unpack(arrays, self.spec.name, count)

    def _encode(self, given: Sequence[np.ndarray], context: Context) -> np.ndarray:
        """The network's input, ``(1, 15, H, W)``, of a size that it takes.

        It grows by repeating the last column and row. ``given`` are its planes, ``(..., h, w)``.
        """
        parts = [planes.reshape(-1, *planes.shape[-2:]) for planes in given]
        full = [-(-size // self.alignment) * self.alignment for size in parts[0].shape[1:]]
        planes = context.workspace.array("features", (1, sum(map(len, parts)), *full))

        def fill(rows: slice) -> None:
            first = 0
            for part in parts:
                surround(part, planes[0, first : first + len(part), rows], 0, rows)
                first += len(part)

        context.strips.run(fill, full[0], full[1], pixels=STRIP_PIXELS // 2)
        return planes

    def _learn(self, learned: Learned, lesson: Lesson, engine: Engine) -> Learned:
        learner = Learner(engine, rate=self._options.learning_rate, seed=self.spec.training.seed)
        after, why = learner.step(learned, lesson)
        if why:
            _log.warning("%s: learning was set back: %s", self.spec.name, why)
        return after


def _stage(plan: Plan, name: str) -> Stage:
    return next(stage for stage in plan.stages if stage.name == name)


def _guide_planes(prepared: Prepared, context: Context) -> np.ndarray:
    """Albedo and normals, ``(6, h, w)``; 0 where they are not given: they tell nothing apart."""
    given = (prepared.albedo, prepared.normal)
    guides = context.workspace.array("guides", (2, _COLORS, *prepared.luminance.shape))

    def work(rows: slice) -> None:
        for planes, buffer in zip(guides, given, strict=True):
            planes[:, rows] = 0 if buffer is None else planes_of(buffer[rows])

    context.strips.run(work, *guides.shape[2:])
    return guides.reshape(-1, *guides.shape[2:])


def _edges(guides: np.ndarray, context: Context) -> np.ndarray:
    """Where a guide ``(g, h, w)`` changes among the 3x3 pixels around one, ``(h, w)`` bool."""
    height, width = guides.shape[1:]
    edges, around = np.zeros((height, width), bool), np.ones((3, 3), np.uint8)

    def work(rows: slice) -> None:
        near, own = with_halo(rows, 1, height)
        for guide in guides[:, near]:
            span = cv2.morphologyEx(guide, cv2.MORPH_GRADIENT, around)
            edges[rows] |= span[own] > _CHANGE

    context.strips.run(work, height, width)
    return edges


def _remembered(
    before: State | Plan | None, request: Request
) -> tuple[_Half, _Half, Learned | None]:
    """What is remembered of either half, and what was learned."""
    if not request.temporal:
        return None, None, None
    if isinstance(before, OnlinePlan):  # a plan that is only told
        return before.first, before.second, None
    if not isinstance(before, State):
        return None, None, None
    learned = before.learned if isinstance(before.learned, Learned) else None
    past = before.temporal
    if not isinstance(past, Past):
        return None, None, learned
    return past.first, past.second, learned
