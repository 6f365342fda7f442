"""Frames at half their size, and what doubling makes of them."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("flip_evaluator")
pytest.importorskip("pyoidn", reason="Open Image Denoise is of the extra compare")

from stillray.errors import InputError
from stillray.frame import Frame
from stillray_training.evaluate.cases import find_cases
from stillray_training.simulate.sequence import write
from stillray_training.upscaling import halved as command
from stillray_training.upscaling.halved import halved, measure


def a_frame(height=9, width=12):
    rng = np.random.default_rng(2)
    return Frame(
        color=rng.exponential(1.0, (height, width, 3)),
        albedo=rng.uniform(0, 1, (height, width, 3)),
        normal=np.broadcast_to(np.float32([0, 0, 1]), (height, width, 3)),
        depth=np.where(np.arange(width) % 2, 9.0, 3.0) * np.ones((height, 1)),
        motion=np.broadcast_to(np.float32([3, -1]), (height, width, 2)),
        samples=2.0,
        filter_spread=np.sqrt(1 / 12),
    )


def test_a_halved_frame_is_what_a_renderer_gives_at_half_the_size():
    frame = a_frame()
    small = halved(frame)
    assert small.shape == (4, 6)
    expected = frame.color[:8].reshape(4, 2, 6, 2, 3).mean((1, 3))
    np.testing.assert_allclose(small.color, expected, rtol=1e-6)
    np.testing.assert_array_equal(small.depth, 3.0)  # of one surface, not between two
    np.testing.assert_array_equal(small.motion, np.broadcast_to([1.5, -0.5], (4, 6, 2)))
    assert small.samples == 8
    assert small.filter_spread == pytest.approx(np.sqrt(1 / 12))  # a box stays a box
    assert small.roughness is None
    with pytest.raises(InputError, match=r"frame must have two pixels each way, got \(1, 12\)"):
        halved(a_frame(height=1))


@pytest.fixture
def folder(tmp_path):
    """One scene, noisy and fed its reference: a wall of two halves."""
    wall = np.full((32, 48, 3), 0.2, np.float32)
    wall[:, 20:] = 0.8
    scene = tmp_path / "wall"
    still = tmp_path / "spp" / "wall" / "4"
    for made in (scene, still):
        made.mkdir(parents=True)
    light = np.random.default_rng(1).exponential(1.0, (32, 48, 1)).astype(np.float32)
    features = {
        "albedo": wall, "normal": np.zeros_like(wall) + np.float32([0, 0, 1]),
        "depth": np.ones((32, 48), np.float32), "motion": np.zeros((32, 48, 2), np.float32),
    }  # fmt: skip
    for path in (scene / "frame_0000.exr", still / "frame_0000.exr"):
        write(path, {"color": wall * light, **features})
    write(scene / "ref_0000.exr", {"color": wall})
    return tmp_path


def test_doubled_pictures_are_measured_against_references_of_full_size(folder):
    by_kind = {case.kind: case for case in find_cases(folder)}
    noisy, fed = (measure(by_kind[kind], "munet-x2", "high") for kind in ("stills", "fed"))
    methods = ["munet-x2", "kpyr-5-still + Lanczos", "oidn-high + Lanczos"]
    assert list(noisy) == list(fed) == methods
    for method in methods:
        assert 15 < noisy[method]["psnr"] < fed[method]["psnr"]
    with pytest.raises(InputError, match="model must double what it is given, got kpyr-5"):
        measure(by_kind["fed"], "kpyr-5", "high")


def test_every_set_is_told_and_pictures_are_written(folder, capsys):
    command.main([str(folder)], "munet-x2", "high", folder / "pictures")
    told = capsys.readouterr().out
    for title in ("stills, 4 samples a pixel", "fed the references"):
        assert title in told
    names = {path.name for path in (folder / "pictures").iterdir()}
    assert "fed-the-references-wall-munet-x2.png" in names
    assert "stills-4-samples-a-pixel-wall-reference.png" in names
