"""Make a static folder of the demo page: the page, a frame graph, ONNX Runtime and a sequence.

stillray-export kpyr-5 --frame-graph
npm install --ignore-scripts --prefix plugins/web
python plugins/web/demo/build.py kpyr-5.frame.onnx demo_web
python -m http.server --directory demo_web
"""

from __future__ import annotations

import argparse
import json
import shutil
from pathlib import Path

import numpy as np

from stillray.frame import Frame
from stillray.io.exr.read import read_exr

HERE = Path(__file__).parent
_BUFFERS = ("color", "albedo", "normal", "depth", "motion")
_RUNTIME = ("ort.wasm.bundle.min.mjs", "ort.webgpu.bundle.min.mjs", "*threaded.wasm", "*asyncify.*")


def main() -> None:
    """Parse the command line and build."""
    parser = argparse.ArgumentParser(description="Make a static folder of the demo page.")
    parser.add_argument("graph", type=Path, help="NAME.frame.onnx")
    parser.add_argument("out", type=Path, help="folder to make")
    parser.add_argument("--sequence", type=Path, default=HERE.parents[2] / "tests/data/room")
    parser.add_argument("--frames", type=int, default=8, help="how many at most")
    parser.add_argument(
        "--runtime", type=Path, default=HERE.parent / "node_modules/onnxruntime-web/dist"
    )
    parser.add_argument("--corner", type=int, help="pixels: a square of the frames alone")
    given = parser.parse_args()
    frames = [read_exr(path) for path in sorted(given.sequence.glob("frame_*.exr"))]
    if min(given.frames, len(frames), 1 if given.corner is None else given.corner) < 1:
        parser.error(f"{given.sequence}, --frames and --corner must leave a frame and a pixel")
    frames = [corner(frame, given.corner) for frame in frames[: given.frames]]
    build(given.graph, frames, given.runtime, given.out)


def corner(frame: Frame, size: int | None) -> Frame:
    """The upper left square of a frame, of as many pixels to a side; all of it if None."""
    return Frame(
        **{name: getattr(frame, name)[:size, :size] for name in _BUFFERS if name in frame.given}
    )


def build(graph: Path, frames: list[Frame], runtime: Path, out: Path) -> None:
    """Write the folder.

    Parameters
    ----------
    graph
        A frame graph.
    frames
        At least one, all of one size and with the same buffers.
    runtime
        The folder ``dist`` of the package onnxruntime-web.
    out
        Made if it is not there.
    """
    (out / "ort").mkdir(parents=True, exist_ok=True)
    shutil.copyfile(graph, out / "model.onnx")
    for path in (HERE / "index.html", HERE / "demo.js", HERE.parent / "stillray.js"):
        shutil.copyfile(path, out / path.name)
    for pattern in _RUNTIME:
        for path in runtime.glob(pattern):
            shutil.copyfile(path, out / "ort" / path.name)
    write_frames(frames, out / "frames")


def write_frames(frames: list[Frame], folder: Path) -> None:
    """Buffers of each frame one after the other as float32, and what they are as JSON."""
    folder.mkdir(parents=True, exist_ok=True)
    given = [name for name in _BUFFERS if getattr(frames[0], name) is not None]
    for index, frame in enumerate(frames):
        values = [getattr(frame, name).astype("<f4").ravel() for name in given]
        np.concatenate(values).tofile(folder / f"{index}.f32")
    height, width = frames[0].shape
    channels = {name: getattr(frames[0], name).size // (height * width) for name in given}
    about = {"width": width, "height": height, "count": len(frames), "buffers": channels}
    (folder / "sequence.json").write_text(json.dumps(about))


if __name__ == "__main__":
    main()
