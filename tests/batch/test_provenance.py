"""Finished frames are known by what they were made of, and by what they hold."""

import numpy as np
import pytest

from stillray.batch.resume import Recipe, file_digest, is_finished, picture_digest
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr, read_metadata

RECIPE = Recipe(model="m", model_digest="aa", options={"temporal": True})
INPUTS = [{"color": "1", "albedo": "2"}, {"color": "3", "albedo": "4"}]


def write_clean(path, picture, recipe=RECIPE, inputs=INPUTS):
    channels = {name: picture[..., i] for i, name in enumerate("RGB")}
    write_channels(path, channels, attributes=recipe.attributes(recipe.digest(inputs), picture))


@pytest.fixture
def picture(rng):
    # with values that half precision clamps, rounds, and holds as denormals
    values = rng.random((7, 5, 3)).astype(np.float32)
    values[0, 0] = (1e9, 70000, 65519)
    values[1, 1] = (1e-7, 6e-8, 1e-12)
    return values


def test_written_frame_is_recognised_and_tells_what_made_it(tmp_path, picture):
    write_clean(tmp_path / "c.exr", picture)
    assert is_finished(tmp_path / "c.exr", RECIPE.digest(INPUTS))
    found = read_metadata(tmp_path / "c.exr")
    assert found.getattribute("stillray:model") == "m"
    assert found.getattribute("stillray:options") == '{"temporal": true}'
    assert found.getattribute("stillray:version")


@pytest.mark.parametrize(
    ("recipe", "inputs"),
    [
        (Recipe(model="m", model_digest="ab", options={"temporal": True}), INPUTS),
        (Recipe(model="m", model_digest="aa", options={"temporal": False}), INPUTS),
        (Recipe(model="m", model_digest="aa", options={"temporal": True}, version="0"), INPUTS),
        (RECIPE, INPUTS[1:]),  # a shorter history
        (RECIPE, INPUTS[::-1]),
        (RECIPE, [{"color": "1", "albedo": "2"}, {"color": "4", "albedo": "3"}]),
        (RECIPE, [INPUTS[0], {"color": "3"}]),
    ],
)
def test_any_change_of_what_made_it_shows(tmp_path, picture, recipe, inputs):
    write_clean(tmp_path / "c.exr", picture)
    assert not is_finished(tmp_path / "c.exr", recipe.digest(inputs))


def test_a_models_other_name_changes_nothing():
    other = Recipe(model="n", model_digest="aa", options={"temporal": True})
    assert other.digest(INPUTS) == RECIPE.digest(INPUTS)


def test_picture_that_was_worked_on_by_others_is_not_ours(tmp_path, picture):
    write_clean(tmp_path / "c.exr", picture)
    changed = read_exr(tmp_path / "c.exr").color.copy()
    changed[3, 3, 1] += 1 / 64
    # another program keeps the metadata of what it has read
    channels = {name: changed[..., i] for i, name in enumerate("RGB")}
    write_channels(tmp_path / "d.exr", channels, like=tmp_path / "c.exr")
    assert read_metadata(tmp_path / "d.exr").getattribute("stillray:digest")
    assert not is_finished(tmp_path / "d.exr", RECIPE.digest(INPUTS))


@pytest.mark.parametrize("keep", [0, 10, 300, -1])
def test_what_cannot_be_read_is_not_finished(tmp_path, picture, keep):
    write_clean(tmp_path / "c.exr", picture)
    whole = (tmp_path / "c.exr").read_bytes()
    (tmp_path / "c.exr").write_bytes(whole[:keep])
    assert not is_finished(tmp_path / "c.exr", RECIPE.digest(INPUTS))


def test_nothing_there_or_no_provenance_is_not_finished(tmp_path, picture):
    assert not is_finished(tmp_path / "none.exr", RECIPE.digest(INPUTS))
    write_channels(tmp_path / "c.exr", {name: picture[..., 0] for name in "RGB"})
    assert not is_finished(tmp_path / "c.exr", RECIPE.digest(INPUTS))


def test_file_digest_is_of_the_bytes(tmp_path):
    (tmp_path / "a").write_bytes(b"x" * 100_000)
    (tmp_path / "b").write_bytes(b"x" * 100_000)
    (tmp_path / "c").write_bytes(b"x" * 99_999 + b"y")
    assert file_digest(tmp_path / "a") == file_digest(tmp_path / "b")
    assert file_digest(tmp_path / "a") != file_digest(tmp_path / "c")
    with pytest.raises(InputError, match="d: cannot be read: No such file"):
        file_digest(tmp_path / "d")


def test_picture_digest_sees_no_difference_that_is_not_written(picture):
    stored = np.clip(picture, 0, 65504).astype(np.float16)
    assert picture_digest(picture) == picture_digest(stored.astype(np.float32))
    stored[2, 2, 2] = np.nextafter(stored[2, 2, 2], np.float16(2))
    assert picture_digest(picture) != picture_digest(stored.astype(np.float32))
