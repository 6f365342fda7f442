from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skimage")

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families import bilateral_grid as grid
from stillray.model_spec import load
from stillray_training import grid_study
from tests.families.test_bilateral_grid import draw

ROOM = Path(__file__).parents[1] / "data" / "room"
SPEC = load("nbg-2x3")


def changed(name, features, maps):
    return grid_study.changes(SPEC)[name](features, maps)


def test_a_scale_alone_is_all_of_the_picture():
    mean, maps = draw(33, 18, SPEC.decoder)
    features = np.zeros((len(SPEC.network.features), 33, 18), np.float32)
    for scale in range(3):
        alone = changed(f"scale {scale} alone", features, maps)
        got = grid.filter_grids(mean, alone, SPEC.decoder, Strips(1))
        other = maps.copy()
        others = [index for index in range(3) if index != scale]
        other[others] = 0.1
        other[3:] = alone[3:]
        same = grid.filter_grids(mean, other, SPEC.decoder, Strips(1))
        np.testing.assert_allclose(got, same, rtol=1e-6)
    np.testing.assert_array_equal(changed("as trained", features, maps), maps)


def test_the_mean_of_the_features_is_a_guide_between_0_and_1():
    _, maps = draw(3, 5, SPEC.decoder)
    features = np.zeros((len(SPEC.network.features), 3, 5), np.float32)
    place = SPEC.network.features.index
    features[place("albedo.r")] = features[place("depth")] = 0.7
    features[place("normal.z")] = -1
    got = changed("mean of features as guides", features, maps)
    # two of 0.7, two normals of 0 that count half, one of -1 that counts nothing
    np.testing.assert_allclose(got[:3], (0.7 + 0.7 + 0.5 + 0.5) / 7, rtol=1e-6)
    np.testing.assert_array_equal(got[3:], maps[3:])


def test_grids_and_kernels_are_timed_in_turn():
    taken = grid_study.times("nbg-2x3", 20, 30, rounds=2)
    assert {"1 grids", "3 grids", "6 kernels"} <= set(taken)
    assert all(len(values) == 2 and min(values) > 0 for values in taken.values())


def test_every_change_is_scored():
    scores = grid_study.ablations("nbg-2x1", ROOM.parent)
    assert set(scores) == {"as trained", "mean of features as guides"}
    assert scores["as trained"]["psnr"] > scores["mean of features as guides"]["psnr"] > 0


def test_the_page_holds_what_was_measured(tmp_path, capsys):
    report = tmp_path / "grids.md"
    grid_study.main("nbg-2x1", ROOM.parent, report, height=20, width=30, rounds=1)
    printed, written = capsys.readouterr().out, report.read_text()
    assert printed.strip() in written
    assert "| mean of features as guides |" in written
    assert "| 6 kernels |" in written
    assert "Memory of the 1 grids" in written


def test_models_without_grids_are_refused_by_name():
    with pytest.raises(InputError, match="model must be one with bilateral grids, got kpyr-5s"):
        grid_study.main("kpyr-5s")
