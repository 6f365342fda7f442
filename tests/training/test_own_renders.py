"""Renders of one's own become sequences that training and evaluation read."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training is of the extra train")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.batch.file_layout import Told  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.io.exr.new_file import write_channels  # noqa: E402
from stillray.io.exr.read import read_exr  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.evaluate.cases import find_cases  # noqa: E402
from stillray_training.examples import find_sequences, load_examples  # noqa: E402
from stillray_training.own_renders import Source, gather_renders  # noqa: E402
from stillray_training.patches import PatchSampler  # noqa: E402
from stillray_training.targets import read_filter  # noqa: E402
from tests.conftest import clean_color, make_frame  # noqa: E402

HEIGHT, WIDTH = 97, 130


def write_render(path, frame, *, without=()):
    """As Blender names its passes, with the motion to and from the frame in one pass."""
    z = {"View Layer.Depth.Z": frame.depth}
    groups = {
        "color": [("View Layer.Combined." + c, i) for i, c in enumerate("RGB")],
        "albedo": [("View Layer.Denoising Albedo." + c, i) for i, c in enumerate("RGB")],
        "normal": [("View Layer.Denoising Normal." + c, i) for i, c in enumerate("XYZ")],
    }
    planes = {} if "depth" in without else dict(z)
    for role, names in groups.items():
        if role not in without:
            planes |= {name: getattr(frame, role)[..., i] for name, i in names}
    if "motion" not in without:
        planes |= {f"View Layer.Vector.{c}": np.zeros(frame.shape) for c in "XYZW"}
    write_channels(path, planes, formats=dict.fromkeys(planes, "float"))


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """Twelve noisy frames from 5 on, references of every other one."""
    monkeypatch.chdir(tmp_path)
    clean = clean_color(HEIGHT, WIDTH)
    for number in range(5, 17):
        frame = make_frame(HEIGHT, WIDTH, number)
        write_render(tmp_path / f"noisy.{number}.exr", frame)
        if number % 2 == 0:
            planes = {c: clean[..., i] for i, c in enumerate("RGB")}
            write_channels(tmp_path / f"clean.{number}.exr", planes)
    return tmp_path


def source(**options):
    return Source(frames="noisy.#.exr", references="clean.#.exr", **options)


def test_each_reference_ends_a_sequence_of_the_frames_before_it(shot):
    told = Told(samples=4, filter_spread=0.5)
    gathered = gather_renders(source(told=told, every=6), shot / "data", "show")
    assert [(one.folder.name, one.frames) for one in gathered] == [
        ("show-own-0006", 2), ("show-own-0012", 8),
    ]  # fmt: skip
    assert all(one.alike for one in gathered)
    folder = gathered[1].folder
    assert read_filter(folder) == 0.5
    for index, number in enumerate(range(5, 13)):
        mine, theirs = (
            read_exr(folder / f"frame_{index:04d}.exr"),
            make_frame(HEIGHT, WIDTH, number),
        )
        np.testing.assert_allclose(mine.color, theirs.color, rtol=1e-3, atol=1e-6)
        np.testing.assert_allclose(mine.depth, theirs.depth)
        assert mine.given >= {"albedo", "normal", "motion"}
    clean = clean_color(HEIGHT, WIDTH)
    np.testing.assert_allclose(read_exr(folder / "ref_0007.exr").color, clean, rtol=1e-3)


def test_training_and_evaluation_read_them(shot):
    gather_renders(source(told=Told(samples=4)), shot / "data", "show")
    sequences = find_sequences(shot / "data")
    assert all(read_filter(path) is None for path in sequences)  # nobody said
    assert [path.name for path in sequences] == ["show-own-0006", "show-own-0014"]
    spec = load("wskp-3s")
    recipe = dataclasses.replace(spec.training, patch=64)
    spec = dataclasses.replace(spec, training=recipe)
    examples = [e for path in sequences for e in load_examples(path, spec, Strips(1))]
    assert {example.spp for example in examples if example.kind == "noisy"} == {4.0}
    batch = PatchSampler(examples, spec).batch(0)
    assert np.isfinite(batch.features).all()
    assert len(find_cases(shot / "data", kinds=["sequences"])) == 2


def test_without_motion_each_frame_is_learned_from_alone(shot):
    for number in range(5, 17):
        write_render(f"noisy.{number}.exr", make_frame(HEIGHT, WIDTH, number), without=["motion"])
    gathered = gather_renders(source(), shot / "data", "show")
    assert [one.frames for one in gathered] == [1, 1]


def test_a_frame_of_other_light_than_its_reference_is_noticed(shot):
    planes = {c: np.full((HEIGHT, WIDTH), 9.0, np.float32) for c in "RGB"}
    write_channels("clean.6.exr", planes)
    one, other = gather_renders(source(), shot / "data", "show")
    assert (one.alike, other.alike) == (False, True)


def small(path):
    write_channels(path, {c: np.ones((9, 9), np.float32) for c in "RGB"})


def holed(path):
    write_channels(path, {c: np.full((HEIGHT, WIDTH), np.nan, np.float32) for c in "RGB"})


@pytest.mark.parametrize(
    ("bend", "options", "message"),
    [
        (lambda: small("clean.6.exr"), {}, r"clean\.6\.exr: must have the size \(97, 130\)"),
        (lambda: holed("clean.6.exr"), {}, "a reference must be finite, 12610 pixels are not"),
        (
            lambda: write_render("noisy.6.exr", make_frame(HEIGHT, WIDTH), without=["depth"]),
            {},
            r"noisy\.6\.exr: training needs albedo, normal and depth .*, lacks depth",
        ),
        (lambda: None, {"every": 0}, "every must be 1 frame or more"),
    ],
)
def test_what_cannot_be_learned_from_is_refused_in_a_line(shot, bend, options, message):
    bend()
    with pytest.raises(InputError, match=message):
        gather_renders(source(**options), shot / "data", "show")


def test_names_of_our_scenes_and_of_paths_are_refused(shot):
    with pytest.raises(InputError, match=r"not be that of a scene of stillray's own, got room"):
        gather_renders(source(), shot / "data", "room")
    with pytest.raises(InputError, match="name must be of letters"):
        gather_renders(source(), shot / "data", "../show")


def test_references_of_other_frames_are_refused(shot):
    with pytest.raises(InputError, match="must have the numbers of frames"):
        gather_renders(
            Source(frames="noisy.5.exr", references="clean.#.exr"), shot / "data", "show"
        )  # fmt: skip
