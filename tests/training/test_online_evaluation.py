"""Frames of the evaluation of learning, and their references."""

import json

import numpy as np
import pytest

pytest.importorskip("torch")

import cv2

from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.write import write_exr
from stillray.profiling import plot
from stillray_training.online import curves, evaluate, still_frames, to_and_fro
from tests.conftest import clean_color, make_frame


def test_cameras_go_to_and_fro_one_step_at_a_time_and_end_with_the_last():
    for frames in (1, 2, 7, 30):
        order = to_and_fro.to_and_fro(frames, 6)
        assert len(order) == frames
        assert order[-1] == 5
        assert set(np.abs(np.diff(order))) <= {1}
        assert set(order) <= set(range(6))
    assert to_and_fro.to_and_fro(8, 3) == [1, 0, 1, 2, 1, 0, 1, 2]


def test_cameras_are_written_as_the_simulator_takes_them(tmp_path):
    poses = [(np.eye(4) * (index + 1)).tolist() for index in range(3)]
    scene = {"fov_x_deg": 50.0, "frames": [{"camera_to_world": pose} for pose in poses]}
    (tmp_path / "scene.json").write_text(json.dumps(scene))
    to_and_fro.main(tmp_path / "scene.json", tmp_path / "cameras.json", 4)
    cameras = json.loads((tmp_path / "cameras.json").read_text())["cameras"]
    assert [camera["camera_to_world"] for camera in cameras] == [poses[i] for i in (1, 0, 1, 2)]
    assert {camera["fov_x_deg"] for camera in cameras} == {50.0}
    (tmp_path / "scene.json").write_text("{}")
    with pytest.raises(InputError, match="cameras"):
        to_and_fro.main(tmp_path / "scene.json", tmp_path / "cameras.json", 4)


def test_a_larger_reference_is_averaged_over_boxes(tmp_path, rng):
    image = rng.random((8, 12, 3)).astype(np.float32)
    path = tmp_path / "ref_0005.exr"
    write_channels(path, {name: image[..., i] for i, name in enumerate("RGB")})
    found = evaluate.read_reference(path, (4, 6))
    expected = image.reshape(4, 2, 6, 2, 3).mean((1, 3))
    np.testing.assert_allclose(found, expected, atol=2e-3)
    with pytest.raises(InputError, match="multiple"):
        evaluate.read_reference(path, (3, 5))


def test_other_models_are_fed_the_mean_of_both_halves():
    frame = make_frame(4, 4)
    both = evaluate.mean_of_halves(evaluate.dataclasses.replace(frame, color_b=3 * frame.color))
    np.testing.assert_allclose(both.color, 2 * frame.color, rtol=1e-6)
    assert both.color_b is None


def test_both_errors_are_drawn_over_frames(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    figures = []
    monkeypatch.setattr(curves, "save", lambda figure, path: figures.append(figure))
    scores = {
        "online": {9: {"relmse": 0.1, "ssim": 0.8}, 0: {"relmse": 0.4, "ssim": 0.6}},
        "svgf": {0: {"relmse": 0.2, "ssim": 0.7}, 9: {"relmse": 0.2, "ssim": 0.7}},
    }
    curves.draw_curves(scores, "a scene", tmp_path / "plot.png")
    left, right = figures[0].axes
    assert [line.get_label() for line in left.lines] == ["online", "svgf"]
    assert left.lines[0].get_xydata().tolist() == [[0, 0.4], [9, 0.1]]
    np.testing.assert_allclose(right.lines[0].get_xydata(), [[0, 0.4], [9, 0.2]])
    plot.save(figures[0], tmp_path / "plot.png")
    assert (tmp_path / "plot.png").read_bytes().startswith(b"\x89PNG")


def test_where_nothing_can_be_drawn_is_told_before_measuring(tmp_path):
    pytest.importorskip("matplotlib")
    with pytest.raises(InputError, match="plot must be in a folder that exists"):
        evaluate.main(tmp_path, tmp_path, plot=tmp_path / "none" / "plot.png")


def test_noise_of_still_frames_has_the_right_mean(rng):
    clean = rng.random((40, 50, 3)).astype(np.float32)
    mean = sum(still_frames.noisy(clean, rng).mean() for _ in range(40)) / 40
    assert mean == pytest.approx(clean.mean(), rel=0.03)
    assert np.mean(still_frames.noisy(clean, rng)[..., 0] == 0) == pytest.approx(0.5, abs=0.05)


def test_a_still_run_is_looked_at_at_powers_of_two_and_its_end():
    frame = make_frame(16, 24)
    small = still_frames.shrunk(frame, (8, 12))
    np.testing.assert_allclose(
        small.albedo, frame.albedo.reshape(8, 2, 12, 2, 3).mean((1, 3)), rtol=1e-5
    )
    found = dict(still_frames.run(np.full((8, 12, 3), 0.2, np.float32), small, 6))
    assert list(found) == [1, 2, 4, 6]
    assert found[6]["psnr"] > found[1]["psnr"]
    with pytest.raises(InputError, match="features must hold albedo"):
        still_frames.shrunk(evaluate.dataclasses.replace(frame, depth=None), (8, 12))


def test_renders_of_two_seeds_have_references_by_number(tmp_path):
    frames = [make_frame(6, 8, seed) for seed in range(4)]
    for number, frame in enumerate(frames):
        write_exr(tmp_path / f"a.{number:04d}.exr", frame.color)
        write_exr(tmp_path / f"b.{number:04d}.exr", 2 * frame.color)
    write_exr(tmp_path / "clean.0002.exr", frames[2].color)
    patterns = [str(tmp_path / f"{name}.####.exr") for name in ("a", "b", "clean")]
    shown = list(evaluate.of_renders(*patterns, last=3))
    assert [one.number for one in shown] == [1, 2, 3]
    assert [one.reference is not None for one in shown] == [False, True, False]
    for one in shown:
        np.testing.assert_allclose(one.frame.color_b, 2 * one.frame.color, rtol=1e-3)
        np.testing.assert_allclose(one.frame.color, frames[one.number].color, rtol=1e-3)
    with pytest.raises(InputError, match="references must have numbers of frames"):
        list(evaluate.of_renders(*patterns, last=1))


def halves(count, height=30, width=40):
    """Frames of two halves with references, as a shot has them."""
    for number in range(count):
        frame = make_frame(height, width, number)
        other = make_frame(height, width, 100 + number)
        both = evaluate.dataclasses.replace(frame, color_b=other.color)
        reference = clean_color(height, width) if number else None
        yield evaluate.Shown(number, both, reference)


def test_the_last_frame_that_is_measured_is_shown(tmp_path):
    scores = evaluate.measure(halves(3), [], [], parts=False, pictures=tmp_path / "seen")
    assert list(scores["online"]) == [1, 2]
    shown = {path.stem: cv2.imread(str(path)) for path in (tmp_path / "seen").glob("*.png")}
    assert sorted(shown) == ["noisy", "online", "reference"]
    assert {image.shape for image in shown.values()} == {(30, 40, 3)}
    noisy, online = (np.abs(shown[name] - 1.0 * shown["reference"]) for name in ("noisy", "online"))
    assert online.mean() < 0.5 * noisy.mean()


@pytest.mark.parametrize("both", [False, True])
def test_neighbours_share_a_sample_that_stays_for_eight_frames(both):
    before = list(halves(9, height=60, width=80))
    after = list(evaluate.with_fireflies(before, 1000.0, both=both))
    assert [one.number for one in after] == [one.number for one in before]
    places = []
    for plain, shown in zip(before, after, strict=True):
        first, second = (
            (getattr(shown.frame, name) != getattr(plain.frame, name)).all(-1)
            for name in ("color", "color_b")
        )
        assert first.sum() == 9  # one block of 3x3 pixels of so small a frame
        np.testing.assert_array_equal(second, first if both else np.zeros_like(first))
        bright = shown.frame.color[first]
        assert (bright == bright[0, 0]).all()
        assert bright[0, 0] > 100 * np.median(plain.frame.color)
        places.append(tuple(np.argwhere(first)[0]))
    assert len(set(places[:8])) == 1
    assert places[8] != places[0]


def test_a_model_that_learns_runs_without_learning_too():
    found = evaluate.measure(halves(3), ["online-warm"], [], parts=True)
    assert {"online-warm", "online-warm, nothing learned", "nothing learned"} <= set(found)
    # nothing is learned before the second frame's picture but from the first
    same = [found[name][1]["psnr"] for name in ("online-warm", "online-warm, nothing learned")]
    assert same[0] != same[1]
