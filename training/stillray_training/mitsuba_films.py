"""``python -m stillray_training.mitsuba_films VALIDATION OUT``: its scenes through Mitsuba's film.

What `stillray-evaluate --film` makes of rendered samples, rendered: stills whose samples count in
all pixels that Mitsuba's own reconstruction filter reaches, as users' frames have them. Mitsuba's
path tracer and its integrator of features do it all; nothing of the simulator is used. The folder
is one for `stillray-evaluate OUT --only stills,fed --pixel-filter none`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from stillray.cli import program
from stillray.errors import InputError
from stillray_training.simulate.sequence import write
from stillray_training.simulate.variant import load_mitsuba

FRAME = 5
COUNTS = (4, 16, 64, 256)
#: Samples a pixel of one launch: what 4 GB hold.
_LAUNCH = 32
_FEATURES = "albedo:albedo,normal:sh_normal,depth:depth"


def main(
    validation: Annotated[Path, typer.Argument(help="Sequences, and their scenes in scenes/.")],
    out: Annotated[Path, typer.Argument(help="Where the stills go; those that are there stay.")],
    pixel_filter: Annotated[
        str, typer.Option("--filter", help="A reconstruction filter of Mitsuba.")
    ] = "gaussian",
    reference: Annotated[int, typer.Option(min=1, help="Samples a pixel of references.")] = 512,
) -> None:
    """Render the last frame of every scene with 4, 16, 64 and 256 samples, and a reference."""
    mi, _ = load_mitsuba(None)
    scenes = sorted(path for path in validation.glob("scenes/*/scene.xml"))
    if not scenes:
        raise InputError(f"validation must hold scenes/NAME/scene.xml, got {validation}")
    for index, scene in enumerate(scenes):
        name = scene.parent.name
        view = _View(mi, scene, validation / name / "scene.json", pixel_filter)
        for count in COUNTS:
            path = out / "spp" / name / str(count) / f"frame_{FRAME:04d}.exr"
            _written(path, view, count, 10_000 * index + count)
        _written(out / name / f"ref_{FRAME:04d}.exr", view, reference, 10_000 * index + 9_000)


def _written(path: Path, view: _View, samples: int, seed: int) -> None:
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    write(path, view.render(samples, seed))
    print(path, flush=True)


class _View:
    """A scene, seen as the last frame of its sequence.

    Parameters
    ----------
    mi
        Mitsuba.
    scene
        Its XML file.
    record
        What the sequence's own renders tell of the camera.
    pixel_filter
        The plugin of its film's reconstruction filter.
    """

    def __init__(self, mi: Any, scene: Path, record: Path, pixel_filter: str) -> None:
        told = json.loads(record.read_text())
        self._mi, self._size = mi, (told["height"], told["width"])
        self._scene = mi.load_file(str(scene))
        frame = next(frame for frame in told["frames"] if frame["frame"] == FRAME)
        self._sensor = mi.load_dict(
            {
                "type": "perspective",
                "to_world": mi.ScalarTransform4f(frame["camera_to_world"]),
                "fov": told["fov_x_deg"],
                "fov_axis": "x",
                "near_clip": 1e-3,
                "far_clip": 1e5,
                "film": {
                    "type": "hdrfilm",
                    "width": told["width"],
                    "height": told["height"],
                    "pixel_format": "rgb",
                    "component_format": "float32",
                    "rfilter": {"type": pixel_filter},
                },
                "sampler": {"type": "independent"},
            }
        )
        self._integrator = mi.load_dict(
            {
                "type": "aov",
                "aovs": _FEATURES,
                "light": {"type": "path", "max_depth": told["max_depth"]},
            }
        )

    def render(self, samples: int, seed: int) -> dict[str, np.ndarray]:
        """A frame of so many samples a pixel by layer: a mean of as many launches as needed."""
        total, left = np.zeros((*self._size, 10)), samples
        while left > 0:
            count = min(left, _LAUNCH)
            image = self._mi.render(
                self._scene, sensor=self._sensor, integrator=self._integrator,
                spp=count, seed=seed + left,
            )  # fmt: skip
            total += count * np.array(image, np.float64)
            left -= count
        mean = (total / samples).astype(np.float32)
        return {
            "color": np.maximum(mean[..., :3], 0),
            "albedo": np.clip(mean[..., 3:6], 0, 1),
            "normal": mean[..., 6:9],
            "depth": mean[..., 9],
        }


if __name__ == "__main__":
    program.run(main)
