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
    assert values["edge"] == values["bias"] == 0
    assert "flicker" not in values  # one frame does not move


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


def test_rmse_is_of_displayed_pictures_and_measured_when_named(reference):
    # Fan et al. 2021, table 1 and supplement table 2, Classroom: 32.827 dB and 0.0229
    assert -20 * np.log10(0.0229) == pytest.approx(32.827, abs=0.03)
    image = reference * np.float32(1.1)
    values = metrics.evaluate([image], [reference], names=["psnr", "rmse"])
    assert list(values) == ["psnr", "rmse"]
    assert values["psnr"] == pytest.approx(-20 * np.log10(values["rmse"]), abs=1e-4)
    # over pixels and channels: twice as bright a tenth of the picture, of range 1
    flat = np.full((20, 30, 3), 0.2, np.float32)
    other = flat.copy()
    other[:2] *= 2
    expected = np.sqrt(0.1) * (0.4 ** (1 / 2.2) - 0.2 ** (1 / 2.2))
    found = metrics.evaluate([other], [flat], names=["rmse"])["rmse"]
    assert found == pytest.approx(expected, rel=1e-6)
    assert "rmse" not in metrics.evaluate([image], [reference])


def test_the_last_of_several_frames_counts(reference):
    worse = reference * np.float32(1.5)
    alone = metrics.evaluate([reference * np.float32(1.1)], [reference])
    both = metrics.evaluate([worse, reference * np.float32(1.1)], [worse, reference])
    seen = set(alone) - {"cvvdp"}  # which sees all frames
    assert {name: alone[name] for name in seen} == {name: both[name] for name in seen}


def test_exposure_of_a_dark_reference_is_limited():
    assert metrics.display_exposure(np.zeros((2, 2, 3))) == 8
    assert metrics.display_exposure(np.full((2, 2, 3), 0.4)) == pytest.approx(0.5)


def test_flicker_counts_change_that_the_reference_does_not_have(reference):
    still = np.full(reference.shape, 0.2, np.float32)
    assert metrics.flicker(reference, still, reference, still) == 0
    # a constant error does not flicker, one that comes and goes does
    assert metrics.flicker(still * 2, still * 2, still, still) == 0
    assert metrics.flicker(still * 2, still, still, still) > 0.1


def step(height, width, *, soft=0.0):
    """Dark on the left, bright on the right, over ``soft`` pixels; radiance."""
    across = np.arange(width) - width / 2 + 0.5
    share = np.clip(across / soft + 0.5, 0, 1) if soft else across > 0
    return np.repeat((0.05 + 0.4 * share)[None, :, None], height, 0).repeat(3, 2)


def test_edge_error_is_of_edges_blurred_or_stippled_and_not_of_flat_walls(rng):
    reference = step(40, 80)
    exposure = metrics.display_exposure(reference)

    def error(image):
        shown, wanted = (metrics.tone_map(part, exposure) for part in (image, reference))
        return metrics.edge_error(shown, wanted)

    assert error(reference) == 0
    slightly, much = error(step(40, 80, soft=4)), error(step(40, 80, soft=12))
    assert 0 < slightly < much
    noise = 1 + 0.3 * rng.uniform(-1, 1, reference.shape)
    near = np.abs(np.arange(80) - 39.5)[None, :, None] < 6
    stippled, mottled = np.where(near, reference * noise, reference), reference.copy()
    mottled[:, :30] *= noise[:, :30]
    assert error(stippled) > slightly / 4
    assert error(mottled) < 1e-3 * error(stippled)


def test_edge_error_of_a_lost_edge_is_its_slope():
    # a ramp of tone-mapped 0.01 a pixel everywhere, against nothing: all slopes are lost
    wanted = np.repeat((np.arange(64) * 0.01)[None, :, None], 48, 0).repeat(3, 2)
    expected = 0.01 * np.sqrt(3)  # three channels
    assert metrics.edge_error(np.zeros_like(wanted), wanted) == pytest.approx(expected, rel=1e-3)


def test_bias_is_percent_of_the_tone_mapped_mean(reference):
    exposure = metrics.display_exposure(reference)
    shown, wanted = (metrics.tone_map(part, exposure) for part in (reference * 0.9, reference))
    expected = 100 * (shown.mean() / wanted.mean() - 1)
    assert metrics.evaluate([reference * np.float32(0.9)], [reference])["bias"] == pytest.approx(
        expected, rel=1e-3
    )
    assert expected < -3
    assert metrics.brightness_bias(shown, np.zeros_like(shown)) == 0


def test_of_a_signed_metric_the_worst_is_told_and_nothing_cancels():
    by_name = {metric.name: metric for metric in metrics.METRICS}
    bias, psnr, smape = by_name["bias"], by_name["psnr"], by_name["smape"]
    assert bias.summary([3.0, -4.0, 1.0]) == -4.0
    assert psnr.summary([20.0, 30.0]) == 25.0
    assert bias.loss(-2.0) == bias.loss(2.0) > bias.loss(0.5)
    assert psnr.loss(30.0) < psnr.loss(20.0)
    assert smape.loss(0.1) < smape.loss(0.2)


def test_colorvideovdp_sees_noise_colour_and_all_frames(rng):
    pytest.importorskip("pycvvdp")
    still = np.full((72, 96, 3), 0.2, np.float32)
    little, much = (
        still * rng.uniform(1 - part, 1 + part, still.shape).astype(np.float32)
        for part in (0.05, 0.3)
    )
    assert metrics.color_video_vdp([still], [still]) == pytest.approx(10)
    scores = [metrics.color_video_vdp([image], [still]) for image in (much, little)]
    assert scores[0] < scores[1] - 1 < 9
    both = metrics.color_video_vdp([much, still], [still, still])
    assert both < 9  # though the last frame alone is perfect
    assert metrics.evaluate([much, still], [still, still])["cvvdp"] == both
    tinted = still * np.array([1.15, 0.96, 0.9], np.float32)
    assert metrics.color_video_vdp([tinted], [still]) < 9.9


def test_a_metric_without_its_package_is_left_out(reference, monkeypatch):
    absent = [
        dataclasses.replace(metric, module="no_such_module")
        if metric.name in ("psnr", "ssim", "flip", "cvvdp")
        else metric
        for metric in metrics.METRICS
    ]
    monkeypatch.setattr(metrics, "METRICS", tuple(absent))
    values = metrics.evaluate([reference, reference], [reference, reference])
    assert list(values) == ["smape", "relmse", "edge", "bias", "flicker"]
