"""``python -m stillray_training.luxcore CHECKOUT OUT``: stills of LuxCore, for testing only.

CHECKOUT is one of github.com/LuxCoreRender/LuxCore (Apache License 2.0), whose test scenes are
rendered by ``pyluxcore`` of PyPI: a renderer that no network has learned from, with scenes,
sampler, albedo and normals of its own. What it writes is read as `stillray denoise` reads it, into
the layout that `stillray_training.evaluate.cases` has for stills.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray.frame import Frame
from stillray.io.frame_file import read_frame
from stillray_training.simulate.sequence import write

#: By name, each with its configuration's file: two interiors that light enters by a window, things
#: of glass and mirror, and a glossy head.
SCENES = {
    "classroom": "scenes/classroom/classroom.cfg",
    "kitchen": "scenes/kitchen/kitchen.cfg",
    "simple-mat": "scenes/simple-mat/simple-mat.cfg",
    "alloy": "scenes/alloy/alloy.cfg",
}
_STILLS = (1, 4, 16, 64)  # samples a pixel
#: What BlendLuxCore takes unless it is told otherwise.
_USUAL = {
    "renderengine.type": "PATHCPU",
    "sampler.type": "SOBOL",
    "film.filter.type": "BLACKMANHARRIS",
    "film.filter.width": "1.5",
}
#: A program for a process of its own: importing it imports pyluxcore.
_RENDER = Path(__file__).with_name("render.py")
_TOLD = ("is missing: left out", "samples a pixel")
_FULL = ("R", "G", "B", "depth.Z")
_COMPANIONS = {"albedo": "ALBEDO", "normal": "AVG_SHADING_NORMAL", "depth": "DEPTH"}


def rendered(checkout: Path, config: str, told: dict[str, str]) -> Frame:
    """A scene's film, from the files that LuxCore writes of it.

    Raises
    ------
    InputError
        It wrote none; what it printed is in the error.
    """
    with TemporaryDirectory() as folder:
        given = [str(checkout), config, folder, json.dumps(_USUAL | told)]
        run = subprocess.run([sys.executable, str(_RENDER), *given], capture_output=True, text=True)
        color = Path(folder) / "RGB.exr"
        if run.returncode or not color.is_file():
            raise InputError(f"LuxCore must render {config}, got {run.stderr[-500:]}")
        for line in run.stdout.splitlines():
            if line.endswith(_TOLD):  # and not what pyluxcore says of its libraries
                print(line, flush=True)
        return read_frame(
            color, {role: f"{folder}/{name}.exr" for role, name in _COMPANIONS.items()}
        )


def main(
    checkout: Annotated[Path, typer.Argument(help="Of LuxCore, with its folder `scenes`.")],
    out: Annotated[Path, typer.Argument(help="Folder of the frames.")],
    height: Annotated[int, typer.Option(help="Pixels; 16:9.", min=1)] = 180,
    reference_spp: Annotated[int, typer.Option(help="Samples of references.", min=1)] = 1024,
    threads: Annotated[int, typer.Option(help="Of LuxCore.", min=1)] = 2,
) -> None:
    """Render stills of each scene and their reference; resumes after a kill."""
    for name, config in SCENES.items():
        if not (checkout / config).is_file():
            raise InputError(f"checkout must have {config}, got {checkout}")
        wanted = {
            out / "spp" / name / str(spp) / "frame_0000.exr": spp for spp in _STILLS
        } | {out / name / "ref_0000.exr": reference_spp}  # fmt: skip
        for path, samples in wanted.items():
            if path.is_file():
                continue
            told = {
                "film.width": str(height * 16 // 9),
                "film.height": str(height),
                "batch.haltspp": str(samples),
                "renderengine.seed": str(samples),  # no still is another with more samples
                "native.threads.count": str(threads),
            }
            frame = rendered(checkout, config, told)
            path.parent.mkdir(parents=True, exist_ok=True)
            buffers = ("color", "albedo", "normal", "depth")
            # nothing is clamped: samples may be beyond what half floats hold
            write(path, {name: getattr(frame, name) for name in buffers}, full=_FULL)
            print(path, flush=True)


if __name__ == "__main__":
    program.run(main)
