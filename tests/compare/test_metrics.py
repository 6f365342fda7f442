from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("flip_evaluator")
pytest.importorskip("skimage")

from stillray.compare import metrics


@pytest.fixture
def reference(rng):
    return rng.random((32, 40, 3)).astype(np.float32)


def test_an_image_equal_to_its_reference_is_perfect(reference):
    values = metrics.evaluate([reference], [reference])
    assert values["psnr"] == np.inf
    assert values["ssim"] == pytest.approx(1)
    assert values["smape"] == values["relmse"] == 0
    assert values["flip"] == pytest.approx(0, abs=1e-6)
    assert not {"flicker", "fovvideovdp"} & set(values)  # one frame does not move


def test_psnr_and_smape_are_their_definitions(reference):
    image = reference * np.float32(1.1)
    exposure = 0.2 / np.median(reference.mean(-1))
    shown = [np.clip(part * exposure, 0, 1) ** (1 / 2.2) for part in (image, reference)]
    values = metrics.evaluate([image], [reference])
    mse = np.mean((shown[0].astype(float) - shown[1]) ** 2)
    assert values["psnr"] == pytest.approx(-10 * np.log10(mse), abs=1e-3)
    exposed = reference * exposure
    expected = np.mean(0.1 * exposed / (2.1 * exposed + 0.01))
    assert values["smape"] == pytest.approx(expected, rel=1e-3)


def test_the_last_of_several_frames_counts(reference):
    worse = reference * np.float32(1.5)
    alone = metrics.evaluate([reference * np.float32(1.1)], [reference])
    both = metrics.evaluate([worse, reference * np.float32(1.1)], [worse, reference])
    assert alone == {name: both[name] for name in alone}


def test_exposure_of_a_dark_reference_is_limited():
    assert metrics.display_exposure(np.zeros((2, 2, 3))) == 8
    assert metrics.display_exposure(np.full((2, 2, 3), 0.4)) == pytest.approx(0.5)


def test_flicker_counts_change_that_the_reference_does_not_have(reference):
    still = np.full(reference.shape, 0.2, np.float32)
    assert metrics.flicker(reference, still, reference, still) == 0
    # a constant error does not flicker, one that comes and goes does
    assert metrics.flicker(still * 2, still * 2, still, still) == 0
    assert metrics.flicker(still * 2, still, still, still) > 0.1


def test_fovvideovdp_minds_what_comes_and_goes_more_than_what_stays(rng):
    pytest.importorskip("pyfvvdp")
    still = np.full((72, 96, 3), 0.2, np.float32)
    fixed = still * rng.uniform(0.7, 1.3, still.shape).astype(np.float32)
    other = still * rng.uniform(0.7, 1.3, still.shape).astype(np.float32)
    assert metrics.fovvideovdp([still, still], [still, still]) == pytest.approx(10)
    steady = metrics.fovvideovdp([fixed, fixed], [still, still])
    flickering = metrics.fovvideovdp([fixed, other], [still, still])
    assert flickering < steady - 0.1 < 10
    assert metrics.evaluate([fixed, other], [still, still])["fovvideovdp"] == flickering


def test_a_metric_without_its_package_is_left_out(reference, monkeypatch):
    absent = [
        dataclasses.replace(metric, module="no_such_module")
        if metric.name in ("psnr", "ssim", "flip", "fovvideovdp")
        else metric
        for metric in metrics.METRICS
    ]
    monkeypatch.setattr(metrics, "METRICS", tuple(absent))
    values = metrics.evaluate([reference, reference], [reference, reference])
    assert list(values) == ["smape", "relmse", "flicker"]
