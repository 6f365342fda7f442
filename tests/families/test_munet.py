"""The trained model that denoises and doubles, on a scene that is known at every point."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import stillray
from stillray.frame import Frame
from stillray.models.registry import find_model
from stillray_training.upscaling.enlarge import enlarge
from tests.conftest import make_frame

SIZE = (45, 70)
SPEED = 0.35  # pixels a frame


def surface(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Albedo of a wall at positions in pixels: waves, and bars a pixel wide."""
    waves = [np.sin(0.5 * x + phase) * np.cos(0.4 * y) for phase in (0.0, 1.0, 2.0)]
    bars = (np.floor(x + 0.3 * y) % 8 == 0)[..., None]
    return np.where(bars, 0.08, 0.5 + 0.3 * np.stack(waves, -1)).astype(np.float32)


def frame(number: int, *, speed: float = SPEED, noise: float = 1.0) -> Frame:
    """The wall slides under light of one noisy sample a pixel."""
    rng = np.random.default_rng([7, number])
    # spread evenly over the pixel, as renderers do (Roberts 2018, R2)
    jitter = np.modf(number * np.array([0.7548776662, 0.5698402910]))[0] - 0.5
    y, x = np.indices(SIZE) + 0.5
    albedo = surface(x + jitter[0] + speed * number, y + jitter[1])
    flat = np.ones(SIZE, np.float32)
    light = 1 + noise * (rng.exponential(1.0, (*SIZE, 1)) - 1)
    return Frame(
        color=albedo * light,
        albedo=albedo,
        normal=np.stack([0 * flat, 0 * flat, flat], -1),
        depth=3 * flat,
        motion=np.stack([speed * flat, 0 * flat], -1),
        roughness=flat,
        specular_albedo=0 * albedo,
        jitter=jitter,
    )


def wanted(number: int, speed: float = SPEED) -> np.ndarray:
    """The wall at the picture's pixels, each the mean of 4x4 points."""
    steps = (np.arange(8 * SIZE[0]) + 0.5) / 8, (np.arange(8 * SIZE[1]) + 0.5) / 8
    y, x = np.meshgrid(*steps, indexing="ij")
    points = surface(x + speed * number, y)
    return points.reshape(2 * SIZE[0], 4, 2 * SIZE[1], 4, 3).mean((1, 3))


def psnr(image: np.ndarray, reference: np.ndarray) -> float:
    inner = (slice(8, -8), slice(8, -8))
    return float(-10 * np.log10(np.square(image[inner] - reference[inner]).mean()))


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
            image = fresh.denoise(frame(number))
            enlarged = enlarge(plain.denoise(frame(number)), 2)
            found.append(psnr(image, wanted(number)) - psnr(enlarged, wanted(number)))
    assert image.shape == (2 * SIZE[0], 2 * SIZE[1], 3)
    assert np.mean(found[4:]) > 0.3


def test_pictures_become_better_with_their_past(fresh) -> None:
    found = [psnr(fresh.denoise(frame(number)), wanted(number)) for number in range(12)]
    assert found[3] > found[0] + 1
    assert min(found[8:]) > found[0] + 1.2


def test_a_hundred_still_frames_stay_what_they_show(fresh) -> None:
    """Detail of the doubled picture grows; nothing drifts, darkens or blows up."""
    target = wanted(0, speed=0.0)
    found, means = [], []
    for number in range(100):
        image = fresh.denoise(frame(number, speed=0.0))
        found.append(psnr(image, target))
        means.append(float(image.mean()))
    assert found[15] > found[0] + 2
    assert min(found[30:]) > found[15] - 1
    np.testing.assert_allclose(means[30:], target.mean(), rtol=0.03)


def test_without_jitter_and_guides_it_still_denoises(fresh) -> None:
    noisy = psnr(enlarge(frame(0).color, 2), wanted(0))
    for number in range(4):
        given = frame(number)
        image = fresh.denoise(Frame(color=given.color, motion=given.motion))
    assert psnr(image, wanted(3)) > noisy + 4
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
        given = frame(number)
        color = given.color.copy()
        color[20:22, 30:33] = broken
        image = fresh.denoise(stillray.Frame(
            color=color, albedo=given.albedo, normal=given.normal, depth=given.depth,
            motion=given.motion, jitter=given.jitter, roughness=given.roughness,
            specular_albedo=given.specular_albedo,
        ))  # fmt: skip
    assert np.isfinite(image).all()
    error = np.abs(image - wanted(4)).mean(-1)
    error[24:60, 44:82] = 0
    assert error[8:-8, 8:-8].mean() < 0.12
    assert image.max() < 300


@pytest.mark.parametrize("model", ["munet-x1", "munet-x2"])
@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_light_that_is_switched_is_followed(model, factor) -> None:
    with stillray.Denoiser(model, threads=1) as denoiser:
        for number in range(8):
            denoiser.denoise(frame(number, speed=0.0))
        means = []
        for number in range(8, 12):
            given = frame(number, speed=0.0)
            image = denoiser.denoise(replace(given, color=given.color * np.float32(factor)))
            means.append(float(image.mean()))
    expected = factor * float(wanted(0, speed=0.0).mean())
    assert abs(means[-1] / expected - 1) < 0.15


@pytest.mark.parametrize("model", ["munet-x1", "munet-x2"])
def test_clusters_of_fireflies_are_left_out(model):
    """Nine pixels share one sample, and come a pixel on with every frame."""
    images = []
    for bright in (1.0, 1e4):
        with stillray.Denoiser(model, threads=1) as denoiser:
            for number in range(6):
                given = frame(number, speed=0.0)
                color = given.color.copy()
                color[20:23, 10 + number : 13 + number] *= np.float32(bright)
                image = denoiser.denoise(replace(given, color=color))
        images.append(image)
    plain, lit = images
    # 400 times, where nothing but what scenes have was learned from
    assert (lit / (plain + 0.01)).max() < 40
