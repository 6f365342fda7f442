"""Scenes to learn from, built and rendered by Blender's own Python."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from stillray.io.exr.read import read_exr
from tests.training.test_cycles_sequences import in_blender, render

AGAINST_WINDOWS = 7  # a seed whose camera sees two of them, with muntins
MOVING = 3  # a seed whose camera moves
FLOORED = 3  # and one that looks down at a floor

pytestmark = in_blender


@pytest.fixture(scope="module")
def backlit(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A room that is looked at against its windows, 32 pixels wide."""
    folder = tmp_path_factory.mktemp("scenes")
    options = ["--first-seed", str(AGAINST_WINDOWS), "--count", "1", "--size", "32"]
    shares = ["--rooms", "1", "--panelled", "0", "--backlit", "1", "--box", "1"]
    done = render(folder, *options, "--reference", "8", *shares)
    assert done.returncode == 0, done.stderr
    return folder / f"{AGAINST_WINDOWS:05d}"


def test_a_scene_has_frames_blocks_and_a_reference(backlit):
    record = json.loads((backlit / "rendered.json").read_text())
    assert record["scene"] == "cycles_backlit"
    assert len(list(backlit.glob("frame_*.exr"))) == record["frames"]
    assert len(list(backlit.glob("block_*.exr"))) == len(record["blocks"])
    reference = read_exr(backlit / "ref_0007.exr")
    assert reference.color.shape == (32, 32, 3)
    assert np.isfinite(reference.color).all()


def test_cameras_see_windows_far_brighter_than_the_room(backlit):
    light = read_exr(backlit / "ref_0007.exr").color.mean(axis=2)
    assert np.mean(light > 10 * np.quantile(light, 0.25)) > 0.05


def test_bars_before_a_window_are_dark(backlit):
    """Beside pixels of the window are some a tenth as bright: what thin bars look like."""
    light = read_exr(backlit / "ref_0007.exr").color.mean(axis=2)
    window = light > 10 * np.quantile(light, 0.25)
    across = np.minimum(light[:, :-2], light[:, 2:])
    between = window[:, :-2] & window[:, 2:]
    assert np.any(light[:, 1:-1][between] < 0.7 * across[between])


def test_scenes_of_all_kinds_are_built(tmp_path):
    options = ["--count", "5", "--size", "8", "--reference", "1", "--rooms", "0.6"]
    done = render(tmp_path, *options, "--panelled", "0.4", "--first-seed", "5")
    assert done.returncode == 0, done.stderr
    kinds = {json.loads(path.read_text())["scene"] for path in tmp_path.glob("*/rendered.json")}
    assert kinds == {"cycles_room", "cycles_panelled", "cycles_table", "cycles_outdoors"}


def scenes(folder, option, values, *, size, reference, seed=MOVING):
    """The same scene with each value of an option: the folders of its files."""
    for value in values:
        options = ["--first-seed", str(seed), "--count", "1", option, value]
        done = render(folder / value, *options, "--size", size, "--reference", reference)
        assert done.returncode == 0, done.stderr
        yield folder / value / f"{seed:05d}"


def without_and_with(folder, effect, **settings):
    """The same scene without an effect and with it: the folders of its files, which say so."""
    both = list(scenes(folder, f"--{effect}", ("0", "1"), **settings))
    records = [json.loads((scene / "rendered.json").read_text()) for scene in both]
    assert [record[effect] for record in records] == [False, True]
    return both


def test_cameras_move_further_in_the_same_scene(tmp_path):
    """Frame 4 of 8 is where all motions pass; frames before and after are further apart."""
    usual, further = (
        [read_exr(path) for path in sorted(scene.glob("frame_*.exr"))]
        for scene in scenes(tmp_path, "--motion", ("1", "6"), size="16", reference="1")
    )
    assert np.array_equal(usual[4].depth, further[4].depth)
    paths = [np.abs(frames[5].motion).mean() for frames in (usual, further)]
    assert paths[1] > 1.2 * paths[0] > 0.1


def test_relief_shows_in_normals_of_the_same_scene(tmp_path):
    both = without_and_with(tmp_path, "relief", size="32", reference="4")
    plain, embossed = (read_exr(scene / "ref_0007.exr") for scene in both)
    # edges aside, whose pixels hold what few samples met
    assert np.isclose(plain.depth, embossed.depth, rtol=0.01).mean() > 0.9
    steps = [np.abs(np.diff(each.normal, axis=1)).mean() for each in (plain, embossed)]
    assert steps[1] > 1.2 * steps[0]


def test_thin_things_stand_before_the_same_scene(tmp_path):
    both = without_and_with(tmp_path, "slender", size="32", reference="4")
    depths = [read_exr(scene / "ref_0007.exr").depth for scene in both]
    without, with_them = (np.where(depth > 0, depth, 50) for depth in depths)  # 0: the sky
    apart = with_them / without
    assert (apart < 0.98).mean() > 0.01  # they stand before what was seen
    assert (np.abs(apart - 1) < 0.01).mean() > 0.4  # which is still there between them
    assert (apart > 1.02).mean() < 0.02  # and they hide it: nothing is further off


def test_lamps_shine_in_the_same_scene(tmp_path):
    both = without_and_with(tmp_path, "lamps", size="32", reference="4")
    without, lit = (read_exr(scene / "ref_0007.exr") for scene in both)
    lamps = (lit.depth < 0.99 * without.depth) & (lit.depth > 0)
    assert 0 < lamps.mean() < 0.2  # small ones, before what was seen
    light = lit.color.mean(axis=2)
    assert light[lamps].max() > 3 * np.median(light)


@pytest.mark.parametrize("effect", ["fur", "leaves"])
def test_hair_and_leaves_stand_before_the_same_scene(tmp_path, effect):
    both = without_and_with(tmp_path, effect, size="32", reference="4", seed=4)
    bare, grown = (read_exr(scene / "ref_0007.exr") for scene in both)
    bare_depth, grown_depth = (np.where(each.depth > 0, each.depth, 50) for each in (bare, grown))
    before = grown_depth < 0.98 * bare_depth
    assert 0.01 < before.mean() < 0.95
    assert (grown_depth > 1.02 * bare_depth).mean() < 0.05  # they hide it: little is further off
    # neighbours have little in common: each is of other hairs
    steps = [np.abs(np.diff(each.normal, axis=1)).mean(axis=2) for each in (bare, grown)]
    inside = before[:, 1:] & before[:, :-1]
    assert steps[1][inside].mean() > 1.5 * steps[0][inside].mean()


def test_nights_are_dark_but_for_lamps(tmp_path):
    both = without_and_with(tmp_path, "night", size="32", reference="4", seed=6)
    day, night = (read_exr(scene / "ref_0007.exr") for scene in both)
    sky = (day.depth == 0) & (night.depth == 0)
    assert sky.mean() > 0.1
    light, dark = (each.color.mean(axis=2) for each in (day, night))
    assert dark[sky].mean() < 0.2 * light[sky].mean()
    assert dark.max() / dark[sky].mean() > 3 * light.max() / light[sky].mean()


def test_haze_pales_what_lies_behind_it(tmp_path):
    """Cycles counts a sample that haze has scattered as one of depth 0."""
    both = without_and_with(tmp_path, "haze", size="32", reference="16")
    clear, hazy = (read_exr(scene / "ref_0007.exr") for scene in both)
    inside = clear.depth > 0
    assert (hazy.depth < 0.95 * clear.depth)[inside].mean() > 0.9
    light = [cv2.blur(each.color.mean(axis=2), (5, 5))[inside] for each in (clear, hazy)]
    assert light[1].std() / light[1].mean() < 0.9 * light[0].std() / light[0].mean()


def test_what_is_out_of_focus_mixes_what_lies_behind_it(tmp_path):
    """Of one sample a pixel, neighbours have seen other things; what is known well is softer."""
    both = without_and_with(tmp_path, "shallow", size="64", reference="64")
    steps = [
        [np.abs(np.diff(read_exr(scene / name).albedo, axis=1)).mean() for scene in both]
        for name in ("block_00.exr", "ref_0007.exr")
    ]
    (sharp_noise, noise), (sharp, soft) = steps
    assert noise / soft > 1.5 * sharp_noise / sharp


def test_frames_of_many_samples_are_of_the_same_scene(tmp_path):
    few, many = scenes(tmp_path, "--many", ("0", "1"), size="32", reference="64")
    counts = [json.loads((scene / "rendered.json").read_text())["spp"] for scene in (few, many)]
    assert counts[0] in (1, 2, 4)
    assert counts[1] in (8, 16, 32, 64)
    truth = read_exr(few / "ref_0007.exr").color
    apart = [
        np.median(np.abs(read_exr(scene / "frame_0007.exr").color - truth)) for scene in (few, many)
    ]
    assert apart[1] < 0.8 * apart[0]


def test_a_motion_that_is_less_than_usual_is_told(tmp_path):
    done = render(tmp_path, "--motion", "0.5")
    assert done.returncode == 2
    assert "motion must be 1 to 100, got 0.5" in done.stderr


def test_water_stands_over_floors_of_the_same_scene(tmp_path):
    both = without_and_with(tmp_path, "water", size="32", reference="4", seed=FLOORED)
    dry, wet = (read_exr(scene / "ref_0007.exr") for scene in both)
    before = (wet.depth < 0.98 * dry.depth) & (dry.depth > 0)
    assert 0.05 < before.mean() < 0.95
    height = np.arange(32) + np.zeros((32, 1))
    assert height.T[before].mean() > height.T[~before].mean()  # it lies below
    # a floor's edges are where ripples bend the way to them, and no two pixels' ripples are alike
    steps = [np.abs(np.diff(each.normal, axis=1)).mean(axis=2) for each in (dry, wet)]
    inside = before[:, 1:] & before[:, :-1]
    assert steps[1][inside].mean() > steps[0][inside].mean()


def test_print_lies_on_surfaces_of_the_same_scene(tmp_path):
    both = without_and_with(tmp_path, "print", size="64", reference="4")
    plain, printed = (read_exr(scene / "ref_0007.exr") for scene in both)
    changed = np.abs(printed.albedo - plain.albedo).max(axis=2) > 0.1
    assert 0.02 < changed.mean() < 0.8
    flat = np.isclose(plain.depth, printed.depth, rtol=0.05)
    assert flat[changed].mean() > 0.7


def test_light_enters_wax(tmp_path):
    """What is lit and what is not are less far apart, in a scene of the same shapes."""
    both = without_and_with(tmp_path, "wax", size="32", reference="32")
    stone, wax = (read_exr(scene / "ref_0007.exr") for scene in both)
    assert np.isclose(stone.depth, wax.depth, rtol=0.02).mean() > 0.9
    light = [
        (each.color / np.maximum(each.albedo, 0.05)).mean(axis=2)[stone.depth > 0]
        for each in (stone, wax)
    ]
    assert not np.allclose(light[0], light[1], rtol=0.1, atol=0.02)


def test_smoke_hides_a_part_of_the_same_scene(tmp_path):
    """Cycles counts a sample that smoke has scattered as one of depth 0."""
    both = without_and_with(tmp_path, "smoke", size="32", reference="16")
    clear, smoky = (read_exr(scene / "ref_0007.exr") for scene in both)
    hidden = smoky.depth < 0.9 * clear.depth
    assert 0.01 < hidden.mean() < 0.9
