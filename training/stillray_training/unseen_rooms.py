"""``python -m stillray_training.unseen_rooms SCENES OUT``: rooms to test on, for nothing else.

Four rooms that nothing was trained on and nothing chosen by, in the layout that
`stillray_training.evaluate.cases` reads. SCENES has Benedikt Bitterli's Mitsuba versions of them
(docs/validation.md says where they are public, and whose they are); what a copy of them lacks is
left out or replaced, and said.
"""

from __future__ import annotations

import json
import shutil
import xml.etree.ElementTree as ET
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray_training.simulate.sequence import SequenceOptions, plan_scene, render_sequence
from stillray_training.simulate.stage import Stage
from stillray_training.simulate.variant import load_mitsuba

_FRAMES = 6
_STILLS = (4, 16, 64)  # samples a pixel
_DEPTH = 8  # path vertices, as validation's scenes have
#: What stands in for an environment that a copy lacks, beside the scene's folder.
_SKY = "living-room/textures/Sky 19.exr"


@dataclass(frozen=True)
class Room:
    """A scene, and how the camera of its file moves.

    Attributes
    ----------
    name
        Of its folder.
    ahead
        How far before the file's camera, which may stand behind a wall, the first one is; metres.
    step
        To the left and ahead, a frame; metres.
    turn
        Degrees a frame.
    """

    name: str
    ahead: float
    step: float
    turn: float


ROOMS = (
    Room("dining-room", 0.0, 0.03, 0.1),
    Room("kitchen", 0.0, 0.02, 0.15),
    Room("living-room", 0.4, 0.015, 0.15),
    Room("staircase", 0.5, 0.02, 0.1),
)


def mend(scene: Path, sky: Path) -> list[str]:
    """Make a scene's file one that Mitsuba 3 loads with the files that are there.

    Parameters
    ----------
    scene
        The XML file; written anew.
    sky
        An environment for one that lacks its own.

    Returns
    -------
    list of str
        What was changed, in words.
    """
    tree = ET.parse(scene)
    root, told = tree.getroot(), []
    for film in root.iter("film"):
        for option in film.findall("boolean[@name='high_quality_edges']"):
            film.remove(option)
    for part in list(root):
        file = part.find("string[@name='filename']")
        if file is None or (scene.parent / str(file.get("value"))).is_file():
            continue
        if part.tag == "emitter":
            told.append(f"{file.get('value')} is missing: {sky.name}")
            file.set("value", str(sky.resolve()))
        else:
            told.append(f"{file.get('value')} is missing: left out")
            root.remove(part)
    tree.write(scene, encoding="unicode")
    return told


def cameras(scene: Path, room: Room) -> dict[str, object]:
    """Cameras as ``stillray-simulate --cameras`` takes them, from the one of a scene's file."""
    sensor = ET.parse(scene).getroot().find("sensor")
    matrix = None if sensor is None else sensor.find("transform/matrix")
    fov = None if sensor is None else sensor.find("float[@name='fov']")
    if matrix is None or fov is None:
        raise InputError(f"{scene}: must have a sensor with a matrix and a fov")
    pose = np.array([float(number) for number in str(matrix.get("value")).split()]).reshape(4, 4)
    poses = []
    for frame in range(_FRAMES):
        angle = np.radians(room.turn * frame)
        move = np.eye(4)
        move[0, 3], move[2, 3] = room.step * frame, room.ahead + room.step * frame
        move[0, 0] = move[2, 2] = np.cos(angle)
        move[0, 2], move[2, 0] = np.sin(angle), -np.sin(angle)
        poses.append({"camera_to_world": (pose @ move).tolist()})
    return {"fov_x_deg": float(str(fov.get("value"))), "cameras": poses}


def main(
    scenes: Annotated[Path, typer.Argument(help="Folder with SCENE/scene.xml of each; mended.")],
    out: Annotated[Path, typer.Argument(help="Folder of the frames.")],
    height: Annotated[int, typer.Option(help="Pixels; 16:9.", min=1)] = 270,
    reference_spp: Annotated[int, typer.Option(help="Samples of references.", min=1)] = 2048,
    samples: Annotated[
        list[int] | None,
        typer.Option(help="Sequences of so many samples a pixel, too: into OUT/sequences.", min=2),
    ] = None,
) -> None:
    """Render a sequence of one sample a pixel and stills of each room; resumes after a kill."""
    mi, _ = load_mitsuba(None)
    for room in ROOMS:
        scene = scenes / room.name / "scene.xml"
        if not scene.is_file():
            raise InputError(f"scenes must have {room.name}/scene.xml, {scene} is missing")
        for change in mend(scene, scenes / _SKY):
            print(f"{room.name}: {change}")
        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{room.name}.cameras.json"
        path.write_text(json.dumps(cameras(scene, room)), encoding="utf-8")
        sequence = SequenceOptions(
            frames=_FRAMES, height=height, width=height * 16 // 9, spp=1,
            reference_spp=reference_spp, references=1, depth=_DEPTH, cameras=str(path),
        )  # fmt: skip
        plan = plan_scene(mi, str(scene), 0, None, sequence)
        stage = Stage(mi, plan, sequence.height, sequence.width)
        render_sequence(stage, out / room.name, sequence)
        for spp in _STILLS:
            # of another seed: no still is the sequence's frame with more samples
            still = replace(sequence, first=_FRAMES - 1, spp=spp, references=0, seed=spp)
            render_sequence(stage, out / "spp" / room.name / str(spp), still)
        for spp in samples or ():
            folder = out / "sequences" / str(spp) / room.name
            render_sequence(stage, folder, replace(sequence, spp=spp, references=0, seed=spp))
            for reference in (out / room.name).glob("ref_*.exr"):
                shutil.copy(reference, folder)


if __name__ == "__main__":
    program.run(main)
