"""``python -m tests.pipeline.way_of_a_frame``: the files that one frame visits, in order.

docs/architecture.md holds the list, and a test compares.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import FrameType

import stillray
from stillray.models.registry import DEFAULT_MODEL
from stillray.profiling.synthetic import swing

SIZE = 72, 96  # pixels
_FOLDER = Path(stillray.__file__).parent


def files_visited(model: str) -> list[str]:
    """Files of the runtime, as a frame with all buffers and a past first enters them.

    What other threads run is left out; here all but the network runs in this one.
    """
    first, second = swing(*SIZE)
    visited: dict[str, None] = {}

    def note(frame: FrameType, event: str, _: object) -> None:
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.is_relative_to(_FOLDER):
            visited.setdefault(path.relative_to(_FOLDER).as_posix())

    with stillray.Denoiser(model, threads=1, precision="float32") as denoiser:
        for frame in (first, second):  # modules are loaded when they are first used
            denoiser.denoise(frame)
        before = sys.getprofile()
        sys.setprofile(note)
        try:
            denoiser.denoise(second)
        finally:
            sys.setprofile(before)
    return list(visited)


if __name__ == "__main__":
    print("\n".join(files_visited(DEFAULT_MODEL)))
