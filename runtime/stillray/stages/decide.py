"""Which stages a frame calls for, by the values of its buffers and by what is remembered."""

from __future__ import annotations

from dataclasses import dataclass, replace

from stillray.arrays.strips import Strips
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.planes import PIXEL_FILTER
from stillray.stages.outliers import remove_outliers
from stillray.stages.plan import Plan, Stage
from stillray.stages.repair import Buffers
from stillray.stages.shared_noise import shared_spread
from stillray.stages.specular_motion import has_mirrors
from stillray.stages.state import History, Remembered
from stillray.timing import timed


@dataclass(frozen=True, kw_only=True)
class Wants:
    """What is asked of a frame, beside what its buffers call for.

    Attributes
    ----------
    temporal
        Whether the past is used, and this frame remembered.
    sample
        Whether this frame's own sample is wanted beside what was accumulated.
    previous_output
        Whether the previous output is looked at.
    layers
        Names of the other layers that are filtered with the frame.
    """

    temporal: bool = True
    sample: bool = False
    previous_output: bool = False
    layers: frozenset[str] = frozenset()


@dataclass(frozen=True, kw_only=True, eq=False)
class TemporalPlan(Plan):
    """The decisions on one frame, with what they were taken on.

    Attributes
    ----------
    buffers
        The frame's, repaired where that was needed.
    past
        The history that is used; None where the frame begins anew, or is planned alone.
    wants
        What was asked for.
    leaves
        What there will be to remember of this frame.
    """

    buffers: Buffers
    past: History | None
    wants: Wants
    leaves: Remembered

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width, pixels."""
        height, width = self.buffers.color.shape[:2]
        return height, width

    @property
    def moved(self) -> History | None:
        """The history that is brought to this frame's pixels, by motion; None where none is."""
        return self.past if self.runs("reproject") else None


def decide(
    frame: Frame,
    spec: ModelSpec,
    past: History | TemporalPlan | None,
    strips: Strips,
    timings: dict[str, float],
    wants: Wants,
) -> TemporalPlan:
    """Decide what runs before the network.

    A frame is decided on as the stages see it, so what must be repaired is repaired here.

    Parameters
    ----------
    frame
        The buffers.
    spec
        The model's specification.
    past
        What is remembered, if anything. One of another size is not used, nor one without the
        layers that are wanted: a layer without a past would not add up with those that have one.
        The plan of the frame before stands for what that frame will leave; such a plan cannot run.
    strips
        Where the work runs.
    timings
        Stage name to milliseconds, filled in.
    wants
        What is asked for.
    """
    buffers = Buffers.of(frame)
    with timed(timings, "inspect"):
        whole = all(strips.run(buffers.in_range, *frame.shape))
    if not whole:
        with timed(timings, "repair"):
            buffers = buffers.repaired(strips)
    deviations = spec.temporal.outlier_deviations
    if deviations:
        with timed(timings, "remove_outliers"):
            buffers = replace(buffers, color=remove_outliers(buffers.color, deviations, strips))
    asks = PIXEL_FILTER in spec.network.features
    told = buffers.filter_spread is not None
    if asks and not told:
        with timed(timings, "find_filter"):
            spread = shared_spread(buffers.color, buffers.albedo)
            buffers = replace(buffers, filter_spread=spread)
    found = past.leaves if isinstance(past, TemporalPlan) else None
    if isinstance(past, History):
        found = past.remembered
    why_anew = _why_anew(frame.shape, found, wants)
    facts = _Facts(buffers, spec, None if why_anew else found, why_anew, wants)
    return TemporalPlan(
        stages=(
            Stage("inspect", True, "values tell what a frame calls for"),
            Stage("repair", not whole, _REPAIR[whole]),
            *([Stage("remove_outliers", True, _OUTLIERS)] if deviations else []),
            *([Stage("find_filter", not told, _FILTER[told])] if asks else []),
            *facts.of_this_frame(),
            *facts.of_the_past(),
        ),
        buffers=buffers,
        past=past if isinstance(past, History) and not why_anew else None,
        wants=wants,
        leaves=facts.leaves(),
    )


_REPAIR = {
    True: "every value is finite and in its range",
    False: "a value is NaN, infinite or out of its range, or a pixel has no samples",
}
_FILTER = {
    True: "the renderer's pixel filter is told",
    False: "nobody says the renderer's pixel filter: do neighbours share their noise?",
}
_OUTLIERS = "the model asks for it"
REJECT = "what the past says is compared with this frame's samples"


def _why_anew(shape: tuple[int, int], past: Remembered | None, wants: Wants) -> str:
    """Why nothing that is remembered is used; empty if it is."""
    if not wants.temporal:
        return "temporal accumulation is switched off"
    if past is None or past.shape != shape:
        return "first frame, or the first after a reset or a new size"
    if wants.layers and past.layers != wants.layers:
        return "other layers are filtered than in the last frame"
    return ""


class _Facts:
    """What decisions are taken on, and the decisions."""

    def __init__(
        self,
        buffers: Buffers,
        spec: ModelSpec,
        past: Remembered | None,
        why_anew: str,
        wants: Wants,
    ) -> None:
        self._buffers, self._spec, self._past, self._wants = buffers, spec, past, wants
        self._albedo = buffers.albedo is not None
        self._geometry = buffers.normal is not None or buffers.depth is not None
        self._moves = past is not None and buffers.motion is not None
        self._why = why_anew or (
            "history and motion are there"
            if self._moves
            else "no motion given: where the past went is not known"
        )
        height, width = buffers.color.shape[:2]
        self._shape = (height, width)

    def leaves(self) -> Remembered:
        """What there will be to remember."""
        return Remembered(
            shape=self._shape,
            mean_albedo=self._albedo and self._spec.temporal.albedo_samples > 0,
            output=self._wants.previous_output,
            layers=self._wants.layers,
        )

    def of_this_frame(self) -> list[Stage]:
        """What a frame calls for by itself."""
        given = "albedo is given" if self._albedo else "no albedo given"
        return [
            Stage("demodulate", self._albedo, given),
            Stage("expose", True, "features are relative to the frame's brightness"),
        ]

    def of_the_past(self) -> list[Stage]:
        """What the past, and the frame after, call for."""
        return [
            self._specular_motion(),
            self._surface_guides(),
            Stage("reproject", self._moves, self._why),
            Stage("reject_history", self._moves, REJECT if self._moves else self._why),
            Stage("accumulate", True, self._why if self._moves else f"begins anew: {self._why}"),
            self._accumulate_albedo(),
            self._resample_output(),
        ]

    def _specular_motion(self) -> Stage:
        buffers = self._buffers
        if not self._moves or buffers.albedo is None or buffers.depth is None:
            why = "only motion, depth, albedo and a past tell what a mirror shows"
            return Stage("specular_motion", False, why)
        found = has_mirrors(buffers.albedo, self._spec.demodulate.black)
        which = "some" if found else "no"
        return Stage(
            "specular_motion", found, f"{which} surfaces are black, as mirrors and glass are"
        )

    def _surface_guides(self) -> Stage:
        if not self._wants.temporal:
            return Stage("surface_guides", False, self._why)
        why = (
            "normal or depth tell surfaces apart" if self._geometry else "no normal or depth given"
        )
        return Stage("surface_guides", self._geometry, why)

    def _accumulate_albedo(self) -> Stage:
        if self._spec.temporal.albedo_samples <= 0:
            return Stage("accumulate_albedo", False, "the model smooths edges otherwise")
        if not self._moves or not self._albedo:
            return Stage(
                "accumulate_albedo", False, self._why if self._albedo else "no albedo given"
            )
        held = self._past is not None and self._past.mean_albedo
        return Stage(
            "accumulate_albedo", held, "albedo is given" if held else "the last frame had no albedo"
        )

    def _resample_output(self) -> Stage:
        if not self._wants.previous_output:
            return Stage("resample_output", False, "the model does not look at its last output")
        if not self._moves:
            return Stage("resample_output", False, self._why)
        held = self._past is not None and self._past.output
        return Stage(
            "resample_output", held, self._why if held else "the last frame has left no output"
        )
