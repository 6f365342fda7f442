"""The trained model that denoises and doubles, on a scene that is known at every point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stillray
from stillray.frame import Frame
from stillray.models.registry import find_model
from stillray_training.upscaling.enlarge import enlarge
from stillray_training.upscaling.still_frames import SIZE, curve, frame, psnr, wanted
from tests.conftest import make_frame

SPEED = 0.35  # pixels a frame


@pytest.fixture(scope="module")
def munet():
    with stillray.Denoiser("munet-x2", threads=1) as denoiser:
        yield denoiser


@pytest.fixture
def fresh(munet):
    munet.reset()
    return munet


def test_it_is_found_by_name_and_not_listed() -> None:
    assert "munet-x2" not in [model.name for model in stillray.list_models()]
    assert find_model("munet-x2").spec.decoder.scale == 2


def test_it_is_nearer_than_denoising_first_and_enlarging_then(fresh) -> None:
    with stillray.Denoiser("kpyr-5", threads=1) as plain:
        found = []
        for number in range(8):
            image = fresh.denoise(frame(number, speed=SPEED))
            enlarged = enlarge(plain.denoise(frame(number, speed=SPEED)), 2)
            found.append(psnr(image, wanted(number, SPEED)) - psnr(enlarged, wanted(number, SPEED)))
    assert image.shape == (2 * SIZE[0], 2 * SIZE[1], 3)
    assert np.mean(found[4:]) > 0.3


def test_pictures_become_better_with_their_past(fresh) -> None:
    found = list(curve(fresh, 12, SPEED))
    assert found[3] > found[0] + 1
    assert min(found[8:]) > found[0] + 1.2


def test_a_hundred_still_frames_stay_what_they_show(fresh) -> None:
    """Detail of the doubled picture grows; nothing drifts, darkens or blows up."""
    target = wanted(0)
    found, means = [], []
    for number in range(100):
        image = fresh.denoise(frame(number))
        found.append(psnr(image, target))
        means.append(float(image.mean()))
    assert found[15] > found[0] + 3
    assert min(found[30:]) > found[15] - 0.5
    assert np.mean(found[80:]) > np.mean(found[12:16]) + 0.7
    np.testing.assert_allclose(means[30:], target.mean(), rtol=0.03)


def test_without_jitter_and_guides_it_still_denoises(fresh) -> None:
    noisy = psnr(enlarge(frame(0, speed=SPEED).color, 2), wanted(0, SPEED))
    for number in range(4):
        given = frame(number, speed=SPEED)
        image = fresh.denoise(Frame(color=given.color, motion=given.motion))
    assert psnr(image, wanted(3, SPEED)) > noisy + 4
    assert np.isfinite(image).all()


@pytest.mark.parametrize("size", [(1, 1), (1, 4), (5, 3), (16, 2), (2, 16), (9, 14)])
def test_every_size_is_doubled(fresh, size) -> None:
    for seed in range(2):
        image = fresh.denoise(make_frame(*size, seed))
        assert image.shape == (2 * size[0], 2 * size[1], 3)
        assert np.isfinite(image).all()


@pytest.mark.parametrize("broken", [np.nan, np.inf, -1e30, 3e38, 0.0])
def test_broken_samples_do_not_spread(fresh, broken: float) -> None:
    for number in range(5):
        given = frame(number, speed=SPEED)
        color = given.color.copy()
        color[20:22, 30:33] = broken
        image = fresh.denoise(stillray.Frame(
            color=color, albedo=given.albedo, normal=given.normal, depth=given.depth,
            motion=given.motion, jitter=given.jitter, roughness=given.roughness,
            specular_albedo=given.specular_albedo,
        ))  # fmt: skip
    assert np.isfinite(image).all()
    error = np.abs(image - wanted(4, SPEED)).mean(-1)
    error[24:60, 44:82] = 0
    assert error[8:-8, 8:-8].mean() < 0.12
    assert image.max() < 300


@pytest.mark.parametrize("model", ["munet-x1", "munet-x2"])
@pytest.mark.parametrize("factor", [1e-3, 0.1, 10.0])
def test_light_that_is_switched_is_followed(model, factor) -> None:
    with stillray.Denoiser(model, threads=1) as denoiser:
        for number in range(8):
            denoiser.denoise(frame(number))
        means = []
        for number in range(8, 12):
            given = frame(number)
            image = denoiser.denoise(replace(given, color=given.color * np.float32(factor)))
            means.append(float(image.mean()))
    expected = factor * float(wanted(0).mean())
    # the first, too: of a thousandth one held 2.5 times the light before its past was looked at
    assert abs(means[0] / expected - 1) < 0.15
    assert abs(means[-1] / expected - 1) < 0.15


@pytest.mark.parametrize("model", ["munet-x1", "munet-x2"])
def test_clusters_of_fireflies_are_left_out(model):
    """Nine pixels share one sample, and come a pixel on with every frame."""
    images = []
    for bright in (1.0, 1e4):
        with stillray.Denoiser(model, threads=1) as denoiser:
            for number in range(6):
                given = frame(number)
                color = given.color.copy()
                color[20:23, 10 + number : 13 + number] *= np.float32(bright)
                image = denoiser.denoise(replace(given, color=color))
        images.append(image)
    plain, lit = images
    # 400 times, where nothing but what scenes have was learned from
    assert (lit / (plain + 0.01)).max() < 40


@pytest.mark.parametrize(("farther", "other"), [(1.7, True), (1 / 1.7, True), (1.15, False)])
def test_a_view_whose_depth_is_another_is_a_cut(fresh, farther: float, other: bool) -> None:
    """A camera that moves ahead is none."""
    before = [make_frame(40, 48, seed) for seed in range(4)]
    after = make_frame(40, 48, 9)
    after = replace(after, depth=before[-1].depth * np.float32(farther))
    alone = fresh.denoise(after)
    fresh.reset()
    for given in before:
        fresh.denoise(given)
    apart = np.abs(fresh.denoise(after) - alone).mean() / alone.mean()
    assert (apart < 0.01) == other
