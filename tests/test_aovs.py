"""Layers that add up to the beauty add up to the denoised beauty, frame after frame."""

import numpy as np
import pytest
from tests.conftest import make_frame

import stillray
from stillray.frame import Frame

HEIGHT, WIDTH = 45, 38
MODELS = ["fast", "balanced"]


def split(color, seed=0):
    """Three layers that add up to a color in float64; one of them has negative values."""
    rng = np.random.default_rng(seed)
    whole = np.asarray(color, np.float64)
    diffuse = whole * rng.random(whole.shape)
    specular = whole - diffuse + 0.3
    return {
        "diffuse": diffuse.astype(np.float32),
        "specular": specular.astype(np.float32),
        "correction": np.full(whole.shape, -0.3, np.float32),
    }


def added(layers):
    return np.sum([layer.astype(np.float64) for layer in layers.values()], axis=0)


def frames(count=5, **changes):
    """The box moves on; each frame has noise of its own and a firefly."""
    for index in range(count):
        frame = make_frame(HEIGHT, WIDTH, seed=index, shift=1.5 if index else 0.0)
        color = frame.color.copy()
        color[7 + index, 11] = (900, 40, 5)
        buffers = {n: getattr(frame, n) for n in ("albedo", "normal", "depth", "motion")}
        yield Frame(**{"color": color, **buffers, **changes})


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("temporal", [True, False])
def test_layers_add_up_to_the_denoised_beauty(model, temporal):
    with stillray.Denoiser(model, temporal=temporal) as denoiser:
        for index, frame in enumerate(frames()):
            image, layers = denoiser.denoise_layers(frame, split(frame.color, index))
            # rounding is relative to what went in: a firefly of 900 among values below 1
            np.testing.assert_allclose(added(layers), image, rtol=1e-5, atol=1e-5)
            assert all(np.isfinite(layer).all() for layer in layers.values())


@pytest.mark.parametrize("model", MODELS)
def test_beauty_is_the_same_with_layers_and_without(model):
    with stillray.Denoiser(model) as alone, stillray.Denoiser(model) as together:
        for frame in frames():
            expected = alone.denoise(frame)
            image, _ = together.denoise_layers(frame, split(frame.color))
            np.testing.assert_array_equal(image, expected)


@pytest.mark.parametrize("model", MODELS)
def test_a_layer_that_is_the_beauty_comes_out_as_the_beauty(model):
    with stillray.Denoiser(model) as denoiser:
        for frame in frames():
            image, layers = denoiser.denoise_layers(frame, {"beauty": frame.color})
            np.testing.assert_allclose(layers["beauty"], image, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_layers_have_a_past_of_their_own(model):
    # a light that is only in one layer, and goes out: the other layer must never show it
    with stillray.Denoiser(model) as denoiser:
        for index, frame in enumerate(frames()):
            lamp = np.zeros_like(frame.color)
            lamp[10:20, 5:15, 0] = 2.0 if index < 2 else 0.0
            sky = np.zeros_like(frame.color)
            sky[..., 2] = 0.25
            _, layers = denoiser.denoise_layers(frame, {"lamp": lamp, "sky": sky})
            assert not layers["sky"][..., :2].any()
            assert not layers["lamp"][..., 1:].any()
    assert layers["lamp"][14, 9, 0] > 0.01  # but its own past is in it


def test_layers_without_albedo_and_motion_add_up():
    with stillray.Denoiser("balanced") as denoiser:
        for frame in frames(3, albedo=None, motion=None):
            image, layers = denoiser.denoise_layers(frame, split(frame.color))
            np.testing.assert_allclose(added(layers), image, rtol=1e-5, atol=1e-5)


def test_layers_of_broken_pixels_are_filled_as_the_beauty_is():
    with stillray.Denoiser("balanced") as denoiser:
        for frame in frames(3):
            layers = split(frame.color)
            color = frame.color.copy()
            color[20, 20], color[3, 4, 1] = np.nan, np.inf
            layers["diffuse"][20, 20] = np.nan
            broken = Frame(
                color=color, albedo=frame.albedo, normal=frame.normal, depth=frame.depth,
                motion=frame.motion,
            )  # fmt: skip
            image, filtered = denoiser.denoise_layers(broken, layers)
            np.testing.assert_allclose(added(filtered), image, rtol=1e-5, atol=1e-5)


def test_other_layers_than_in_the_last_frame_start_a_new_history():
    first, second = list(frames(2))
    with stillray.Denoiser("balanced") as denoiser, stillray.Denoiser("balanced") as fresh:
        denoiser.denoise_layers(first, {"a": first.color})
        image, layers = denoiser.denoise_layers(second, split(second.color))
        expected = fresh.denoise(second)
    np.testing.assert_array_equal(image, expected)
    np.testing.assert_allclose(added(layers), image, rtol=1e-5, atol=1e-5)


@pytest.mark.parametrize("layer", [np.zeros((3, 3, 3)), np.zeros((HEIGHT, WIDTH), np.float32)])
def test_a_layer_of_another_shape_is_named(layer):
    frame = next(frames(1))
    with stillray.Denoiser("fast") as denoiser:
        with pytest.raises(stillray.InputError, match=r"layer spec must have shape \(45, 38, 3\)"):
            denoiser.denoise_layers(frame, {"spec": layer})
