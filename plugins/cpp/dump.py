"""Write a sequence's buffers as the example reads them: ``python dump.py SEQUENCE FRAMES``.

Prints width, height and number of the frames. Every frame must have all five buffers.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from stillray import Frame, read_exr

BUFFERS = ("color", "albedo", "normal", "depth", "motion")


def dump(frames: Sequence[Frame], folder: Path) -> tuple[int, int, int]:
    """Write ``0.f32``, ``1.f32``, ...: little-endian float32, the buffers one after the other.

    Returns
    -------
    width, height, number
        Of the frames.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for index, frame in enumerate(frames):
        values = [np.ravel(getattr(frame, name)) for name in BUFFERS]
        np.concatenate(values).astype("<f4").tofile(folder / f"{index}.f32")
    height, width = frames[0].shape
    return width, height, len(frames)


if __name__ == "__main__":
    paths = sorted(Path(sys.argv[1]).glob("frame_*.exr"))
    print(*dump([read_exr(path) for path in paths], Path(sys.argv[2])))
