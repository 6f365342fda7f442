"""What a network says is told as it is used."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("skimage")
pytest.importorskip("torch", reason="training is of the extra train")

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families import bilateral_grid as grid
from stillray.families import box_filter
from stillray.model_spec import load
from stillray_training import network_maps
from tests.families.test_bilateral_grid import draw

ROOM = Path(__file__).parents[1] / "data" / "room"


def test_shares_are_what_the_filter_mixes_its_kernels_by(rng):
    # the picture of all kernels is the sum of each kernel's picture times its share
    options = load("wskp-3").decoder
    mean = rng.uniform(0.1, 2, (19, 23, 4)).astype(np.float32)
    logits = rng.normal(size=(12, 19, 23)).astype(np.float32) * 8  # some beyond the bound
    shares = network_maps.kernel_shares(logits, options)
    assert list(shares) == [f"share of {size}x{size}" for size in (3, 5, 7, 9, 11, 13)]
    mixed = np.zeros((19, 23, 3))
    for index, (size, share) in enumerate(zip(options.kernel_sizes, shares.values(), strict=True)):
        one = dataclasses.replace(options, kernel_sizes=(size,))
        alone = box_filter.filter_rows(mean, logits[[index, 6 + index]], slice(0, 19), one)
        mixed += share[..., None] * alone
    whole = box_filter.filter_rows(mean, logits, slice(0, 19), options)
    np.testing.assert_allclose(mixed, whole, rtol=1e-5)


def test_levels_tell_their_kernels_and_how_far_they_give_way():
    options = load("wskp-mr").decoder
    fine, coarse = np.zeros((5, 4, 8), np.float32), np.zeros((4, 2, 4), np.float32)
    coarse[2, 0, 1] = np.log(3)  # 3x3 counts three times 5x5 in one pixel
    fine[4, 3, 5] = 20  # beyond the bound of 12
    maps = network_maps.level_shares([fine, coarse], options)
    assert list(maps) == [
        "1/1 of the size, share of 3x3", "1/1 of the size, share of 5x5",
        "1/1 of the size, coarser ones",
        "1/2 of the size, share of 3x3", "1/2 of the size, share of 5x5",
    ]  # fmt: skip
    expected = np.full((4, 8), 0.5)
    expected[0:2, 2:4] = 0.75
    np.testing.assert_allclose(maps["1/2 of the size, share of 3x3"], expected, rtol=1e-6)
    way = maps["1/1 of the size, coarser ones"]
    assert way[0, 0] == 0.5
    assert way[3, 5] == pytest.approx(1 / (1 + np.exp(-12)))


def test_scales_are_blended_by_the_shares_that_are_told():
    spec = load("nbg-2x3")
    mean, maps = draw(33, 18, spec.decoder)
    features = np.full((len(spec.network.features), 33, 18), 0.4, np.float32)
    found = network_maps.grid_maps(features, maps, spec)
    mixed = np.zeros((33, 18, 3))
    for scale in range(3):
        alone = maps.copy()
        alone[3:] = np.array([scale == 0, scale == 1], np.float32)[:, None, None]
        picture = grid.filter_grids(mean, alone, spec.decoder, Strips(1))
        mixed += found[f"share of scale {scale}"][..., None] * picture
    whole = grid.filter_grids(mean, maps, spec.decoder, Strips(1))
    np.testing.assert_allclose(mixed, whole, rtol=1e-4)
    np.testing.assert_array_equal(found["guide 1"], np.clip(maps[1], 0, 1))
    # four features of 0.4, three parts of a normal, (0.4 + 1) / 2 each
    np.testing.assert_allclose(found["mean of features"], (4 * 0.4 + 3 * 0.7) / 7, rtol=1e-6)


def test_one_command_writes_a_picture_a_map(tmp_path, capsys):
    network_maps.main("wskp-3s", ROOM / "frame_0000.exr", out=tmp_path)
    files = {path.name for path in tmp_path.glob("*.png")}
    assert files == {"wskp-3s-picture.png"} | {
        f"wskp-3s-share-of-{size}x{size}.png" for size in (3, 5, 7, 9, 11, 13)
    }
    shown = [cv2.imread(str(path)) for path in sorted(tmp_path.glob("*share*.png"))]
    # shares of a pixel add up to white, up to rounding to 8 bits
    np.testing.assert_allclose(np.sum(shown, axis=0, dtype=float), 255, atol=3)
    assert "share of 13x13" in capsys.readouterr().out


def test_other_models_and_empty_folders_are_refused(tmp_path):
    with pytest.raises(InputError, match="fuse kernels or have bilateral grids, got kpyr-5s"):
        network_maps.maps_of(load("kpyr-5s"), np.zeros((1, 2, 2)), [])
    with pytest.raises(InputError, match=r"sequence must hold frame_0000\.exr"):
        network_maps.main("wskp-3s", tmp_path, out=tmp_path)
