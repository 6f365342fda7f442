from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray.errors import InputError
from stillray.exr import read_exr
from stillray.training.simulate import variant
from stillray.training.simulate.camera import Camera, look_at, smooth_path
from stillray.training.simulate.room import procedural_texture
from stillray.training.simulate.sequence import (
    SequenceOptions,
    is_complete,
    open_scene,
    render_sequence,
)

SMALL = SequenceOptions(
    frames=2, height=24, width=32, reference_spp=2, max_depth=3, seed=5, speed=0.02
)


@pytest.fixture(scope="module")
def mi():
    return variant.load_mitsuba("scalar_rgb")[0]


@pytest.fixture(scope="module")
def rendered(mi, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequence") / "room-0003-0"
    render_sequence(mi, open_scene(mi, "room", 3, SMALL.height, SMALL.width), folder, SMALL)
    return folder


def test_projection_puts_the_target_in_the_middle_and_right_to_the_right():
    camera = Camera(
        to_world=look_at(np.array([0, 0, 5.0]), np.zeros(3), np.array([0, 1.0, 0])), fov_x=90
    )
    x, y, z = camera.project(np.array([[0, 0, 0], [5, 0, 0], [0, 5, 0], [1, 1, 3]]), 100, 200)
    np.testing.assert_allclose(x, [100, 200, 100, 150], atol=1e-9)
    np.testing.assert_allclose(y, [50, 50, -50, 0], atol=1e-9)
    np.testing.assert_allclose(z, [5, 5, 5, 2])


def test_far_points_project_to_their_pixels():
    camera = Camera(
        to_world=look_at(np.array([1, 2, 3.0]), np.array([0, 1, 0.0]), np.array([0, 1.0, 0])),
        fov_x=50,
    )
    x, y, _ = camera.project(camera.far_points(6, 8), 6, 8)
    row, column = np.mgrid[0:6, 0:8] + 0.5
    np.testing.assert_allclose(x, column, atol=1e-6)
    np.testing.assert_allclose(y, row, atol=1e-6)


def test_paths_are_smooth_and_seeded():
    start = Camera(
        to_world=look_at(np.array([0, 1, 4.0]), np.zeros(3), np.array([0, 1.0, 0])), fov_x=60
    )
    one, two = (smooth_path(np.random.default_rng(3), start, 4.0, 8, speed=0.01) for _ in range(2))
    positions = np.array([camera.to_world[:3, 3] for camera in one])
    np.testing.assert_array_equal(positions, [camera.to_world[:3, 3] for camera in two])
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert (steps > 0).all()
    assert steps.max() < 2 * 0.01 * 4.0


def test_a_rendered_sequence_reads_back_as_frames(rendered):
    assert is_complete(rendered)
    frame = read_exr(rendered / "frame_0001.exr")
    assert frame.shape == (24, 32)
    assert frame.given == {"color", "albedo", "normal", "depth", "motion"}
    hit = frame.depth > 0
    assert hit.mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(frame.normal[hit], axis=-1), 1, atol=2e-3)
    assert (rendered / "ref_0001.exr").is_file()
    assert not (rendered / "ref_0000.exr").exists()


def test_motion_takes_points_to_where_the_previous_camera_saw_them(rendered):
    import json

    record = json.loads((rendered / "sequence.json").read_text())
    before, now = (
        Camera(to_world=np.array(entry["camera_to_world"]), fov_x=entry["fov_x_deg"])
        for entry in record["cameras"]
    )
    frame = read_exr(rendered / "frame_0001.exr")
    # lift pixel centres by depth; samples lie within half a pixel of them
    far = now.far_points(24, 32) - now.to_world[:3, 3]
    forward = now.to_world[:3, 2]
    points = now.to_world[:3, 3] + far * (frame.depth / (far @ forward))[..., None]
    x, y, _ = before.project(points, 24, 32)
    row, column = np.mgrid[0:24, 0:32] + 0.5
    expected = np.stack([x - column, y - row], axis=-1)
    error = np.abs(frame.motion - expected)[frame.depth > 0]
    assert np.median(error) < 0.02
    assert np.abs(expected).max() > 0.1


def test_the_same_seed_gives_the_same_pixels_and_a_finished_run_is_kept(mi, rendered, tmp_path):
    again = tmp_path / "again"
    source = open_scene(mi, "room", 3, SMALL.height, SMALL.width)
    render_sequence(mi, source, again, SMALL)
    for name in ("frame_0001.exr", "ref_0001.exr"):
        one, two = read_exr(rendered / name), read_exr(again / name)
        np.testing.assert_array_equal(one.color, two.color)
    before = (again / "frame_0000.exr").stat().st_mtime_ns
    (again / "sequence.json").unlink()
    (again / "frame_0001.exr").unlink()
    render_sequence(mi, source, again, SMALL)
    assert (again / "frame_0000.exr").stat().st_mtime_ns == before
    np.testing.assert_array_equal(
        read_exr(again / "frame_0001.exr").color, read_exr(rendered / "frame_0001.exr").color
    )


@pytest.mark.parametrize("seed", range(12))
def test_textures_fill_the_unit_range(seed):
    pattern = procedural_texture(np.random.default_rng(seed), 64)
    assert pattern.shape == (64, 64)
    assert pattern.min() == 0
    assert pattern.max() == pytest.approx(1)


def test_old_llvm_is_never_chosen(monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/usr/lib/libLLVM-15.so.1")
    assert variant.find_llvm() is None
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/usr/lib/libLLVM.so.19.1")
    assert variant.find_llvm() == "/usr/lib/libLLVM.so.19.1"


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spp": 0}, "spp must be 1 or more, got 0"),
        ({"frames": 2, "references": 3}, r"references must be 0 to frames \(2\), got 3"),
    ],
)
def test_options_beyond_their_rules_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        SequenceOptions(**changes)


def test_a_missing_scene_file_is_one_line_and_exit_code_2(tmp_path):
    done = subprocess.run(
        [sys.executable, "-m", "stillray.training.simulate", str(tmp_path),
         "--scene", "nowhere.xml", "--variant", "scalar_rgb"],
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 2
    assert "scene must be 'room' or a Mitsuba XML file, got nowhere.xml" in done.stderr
    assert "Traceback" not in done.stderr
