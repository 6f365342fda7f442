from __future__ import annotations

import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stillray.errors import InputError
from stillray.model_spec import load
from stillray.models import registry
from stillray.models.registry import (
    differences,
    find_model,
    for_single_frames,
    list_models,
    qualities,
)
from stillray.pipeline.denoiser import Denoiser
from tests.conftest import make_frame


def test_a_quality_opens_one_file(monkeypatch):
    opened = []
    real = registry.read_checked

    def counted(path, **options):
        opened.append(path.name)
        return real(path, **options)

    monkeypatch.setattr(registry, "read_checked", counted)
    assert find_model("high").name == "kpyr-5"
    assert opened == ["kpyr-5.onnx"]


def test_qualities_are_the_aliases_that_the_files_and_the_specifications_hold():
    held = {alias: model.name for model in list_models() for alias in model.aliases}
    assert qualities() == held
    folder = Path(__file__).parents[2] / "models_spec"
    specs = [tomllib.loads(path.read_text()) for path in folder.glob("*.toml")]
    assert qualities() == {alias: spec["name"] for spec in specs for alias in spec["aliases"]}


@pytest.mark.parametrize(
    "name", sorted(p.stem for p in (Path(__file__).parents[2] / "models_spec").glob("*.toml"))
)
def test_a_specification_holds_the_recipe_that_made_the_file(name):
    assert load(name).training == find_model(name).spec.training


def test_differences_are_those_of_the_same_specification_or_the_file_s_own():
    model = find_model("wskp-3s")
    own = ("the paper says one thing; here is another",)
    # what was exported may know fewer than are known now
    for told in ((), own):
        spec = replace(model.spec, differs=told)
        assert differences(replace(model, spec=spec)) == load("wskp-3s").differs != ()
    # of the same name, and another model; and of another name
    other = replace(spec, temporal=replace(spec.temporal, max_samples=8.0))
    assert differences(replace(model, spec=other)) == own
    assert differences(replace(model, spec=replace(other, differs=()))) == ()
    assert differences(replace(model, name="mine", spec=replace(spec, name="mine"))) == own


def test_a_file_is_named_as_its_model_is():
    assert all(model.path.stem == model.name for model in list_models())


def test_an_unknown_name_lists_models_and_qualities():
    with pytest.raises(InputError, match=r"one of kpyr-5, .*wskp-mr, fast, balanced, high or"):
        find_model("best")


@pytest.mark.parametrize(
    ("quality", "stream", "alone"),
    [
        ("high", "kpyr-5", "kpyr-5-still"),
        ("balanced", "kpyr-5s", "kpyr-5-still"),
        ("fast", "kpyr-5s", "kpyr-5s-still"),
    ],
)
def test_a_quality_is_another_model_where_frames_have_no_past(quality, stream, alone):
    for name, temporal in ((stream, True), (alone, False)):
        with Denoiser(quality, temporal=temporal) as denoiser:
            assert denoiser.model.name == name
    # who names a model gets it
    with Denoiser(stream, temporal=False) as denoiser:
        assert denoiser.model.name == stream


@pytest.mark.parametrize(
    ("quality", "color"),
    [("high", "kpyr-5-color"), ("balanced", "kpyr-5-color"), ("fast", "kpyr-5s-color")],
)
def test_a_quality_is_another_model_where_single_frames_have_no_guides(quality, color):
    assert for_single_frames(quality, guided=False) == color
    assert find_model(color).spec.inputs.optional == ()
    assert for_single_frames("kpyr-5-still", guided=False) == "kpyr-5-still"


def test_a_model_of_single_frames_takes_no_past():
    frames = [make_frame(33, 50, seed=seed, shift=1.0) for seed in range(3)]
    with Denoiser("kpyr-5-still") as stream, Denoiser("kpyr-5-still", temporal=False) as alone:
        assert not stream.temporal
        for frame in frames:
            np.testing.assert_array_equal(stream.denoise(frame), alone.denoise(frame))
        assert stream.state is None
