"""What stages work with, beside their data."""

from __future__ import annotations

from dataclasses import dataclass, field

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
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
    back_buffer
        A history that nobody needs any more, whose arrays may be overwritten.
    """

    spec: ModelSpec
    strips: Strips
    timings: dict[str, float] = field(default_factory=dict)
    workspace: Workspace = field(default_factory=Workspace)
    back_buffer: History | None = None

    def back_buffer_for(self, shape: tuple[int, int]) -> History | None:
        """The back buffer, if it is of a frame of that size."""
        if self.back_buffer is None or self.back_buffer.mean.shape[:2] != shape:
            return None
        return self.back_buffer
