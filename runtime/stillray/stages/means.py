"""What stages work with, beside their data."""

from __future__ import annotations

from dataclasses import dataclass, field

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Scratch
from stillray.model_spec.loader import ModelSpec
from stillray.stages.state import History


@dataclass(frozen=True, kw_only=True, eq=False)
class Means:
    """The means of one frame.

    Attributes
    ----------
    spec
        The model's specification.
    strips
        Where the work runs.
    timings
        Stage name to milliseconds, filled in.
    workspace
        Where results lie, all but the history, until the next frame with the same.
    spare
        A history that nobody needs any more, whose arrays may be overwritten.
    """

    spec: ModelSpec
    strips: Strips
    timings: dict[str, float] = field(default_factory=dict)
    workspace: Scratch = field(default_factory=Scratch)
    spare: History | None = None

    def spare_for(self, shape: tuple[int, int]) -> History | None:
        """The spare history, if it is of a frame of that size."""
        if self.spare is None or self.spare.mean.shape[:2] != shape:
            return None
        return self.spare
