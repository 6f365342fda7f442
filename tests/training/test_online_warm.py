"""What other scenes teach the model that learns while it denoises."""

import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.families.cross_bilateral import Estimates, cross_bilateral  # noqa: E402
from stillray.families.online import THINNED  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.model_spec.network_weights import network_weights  # noqa: E402
from stillray_training.networks.filter_parameters import (  # noqa: E402
    filter_parameters,
    split,
    start,
)
from stillray_training.online.warm import Taught, lessons_of, main, picture_loss, teach  # noqa: E402
from stillray_training.simulate.sequence import write  # noqa: E402

LAYOUT = network_weights(load("online"))
SIZE = 24


def render(folder, frames=3):
    """A box before a wall, in two noisy halves."""
    rng = np.random.default_rng(4)
    folder.mkdir(parents=True)
    albedo = np.full((SIZE, SIZE, 3), 0.7, np.float32)
    albedo[6:16, 8:18] = (0.6, 0.2, 0.1)
    clean = albedo * np.linspace(0.3, 1, SIZE, dtype=np.float32)[:, None, None]
    normal = np.zeros_like(albedo)
    normal[..., 2] = 1
    for number in range(frames):
        halves = [clean * rng.standard_exponential(clean.shape[:2], np.float32)[..., None]
                  for _ in range(2)]  # fmt: skip
        write(
            folder / f"frame_{number:04d}.exr",
            {
                "color": halves[0], "color_b": halves[1], "albedo": albedo, "normal": normal,
                "depth": np.ones((SIZE, SIZE), np.float32),
                "motion": np.zeros((SIZE, SIZE, 2), np.float32),
            },
        )  # fmt: skip
        write(folder / f"ref_{number:04d}.exr", {"color": clean})
    record = {"scene": "room", "seed": 0, "complete": True, "options": {"spp": 1}}
    (folder / "sequence.json").write_text(json.dumps(record))
    return folder


def test_what_is_taught_is_the_picture_that_the_runtime_gives(tmp_path):
    weights = start(LAYOUT, 3)
    *_, lesson = lessons_of(render(tmp_path / "room-0-0"), weights.numpy())
    assert lesson.valid.mean() > 0.9
    features = torch.from_numpy(lesson.features)
    theta = filter_parameters(split(weights, LAYOUT), features[None])[0].numpy()
    values, guides = lesson.features[:6], lesson.features[6:12]
    estimates = Estimates(
        values=values.reshape(2, 3, SIZE, SIZE), guides=guides.reshape(2, 3, SIZE, SIZE),
        past=lesson.features[12:], valid=lesson.valid[0], edges=lesson.edges[0] > 0,
    )  # fmt: skip
    filtered = cross_bilateral(estimates, theta, Strips(1), thinned=THINNED)
    image, wanted = filtered * lesson.factor, lesson.wanted
    expected = np.mean(np.abs(image - wanted) / (image + wanted + 0.01))
    planes = {name: torch.from_numpy(part) for name, part in vars(lesson).items()}
    found = float(picture_loss(weights, planes, LAYOUT))
    # the rest is the error as displayed
    assert expected < found < expected + 0.3
    perfect = {**planes, "wanted": torch.from_numpy(image)}
    assert float(picture_loss(weights, perfect, LAYOUT)) < 1e-4


def test_references_teach(tmp_path):
    weights = start(LAYOUT, 3)
    lessons = list(lessons_of(render(tmp_path / "room-0-0"), weights.numpy()))
    assert all(isinstance(lesson, Taught) for lesson in lessons)
    _, first = teach(weights, lessons, LAYOUT, steps=2, rate=0.0, seed=0)
    taught, _ = teach(weights, lessons, LAYOUT, steps=120, rate=5e-3, seed=0)
    _, last = teach(taught, lessons, LAYOUT, steps=2, rate=0.0, seed=0)
    assert last < 0.9 * first


def test_sequences_without_references_are_refused(tmp_path):
    folder = render(tmp_path / "room-0-0")
    for path in folder.glob("ref_*"):
        path.unlink()
    with pytest.raises(InputError, match="must hold references"):
        list(lessons_of(folder, start(LAYOUT, 0).numpy()))
    with pytest.raises(InputError, match="data must be a folder of sequences"):
        main(tmp_path / "nothing", tmp_path / "out")
