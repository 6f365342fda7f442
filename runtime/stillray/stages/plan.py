"""What runs for a frame, and why: decided once, told to who asks, obeyed by what runs."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property


@dataclass(frozen=True)
class Stage:
    """One stage of the way of a frame.

    Attributes
    ----------
    name
        As in the timings.
    runs
        Whether this frame calls for it; only then it is run, and timed.
    reason
        Why, or why not.
    """

    name: str
    runs: bool
    reason: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Plan:
    """The stages of one frame, in the order they run."""

    stages: tuple[Stage, ...]

    @cached_property
    def _running(self) -> frozenset[str]:
        return frozenset(stage.name for stage in self.stages if stage.runs)

    def runs(self, name: str) -> bool:
        """Whether a stage runs."""
        return name in self._running
