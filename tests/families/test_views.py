"""A frame seen mirrored: the same filters, and a mean that does not care how it is held."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.cli import main
from stillray.errors import InputError
from stillray.families import kernel_pyramid as pyramid
from stillray.families.views import VIEWS, mean_picture
from stillray.io.exr.read import read_exr
from stillray.model_spec import load
from stillray.models.steps import in_numbers
from stillray.stages.state import Filterable
from tests.batch.test_resume import write_frame
from tests.conftest import make_frame
from tests.families.test_depth_to_space import by_blocks
from tests.families.test_kernel_pyramid import draw
from tests.families.test_logit_maps import integers_of

FRAMES = 3
ROOM = Path(__file__).parents[1] / "data/room"


@pytest.mark.parametrize("integers", [False, True])
@pytest.mark.parametrize("blocks", [False, True])
@pytest.mark.parametrize("view", VIEWS)
def test_mirrored_light_and_logits_give_the_mirrored_picture(view, blocks, integers):
    spec = load("kpyr-5")
    # every kind of logit that knows a direction
    decoder = dataclasses.replace(spec.decoder, finest_neighbours=(1, 2))
    network = dataclasses.replace(spec.network, widths=(16, 32, 48), encoder_blocks=(0, 2, 3),
                                  decoder_blocks=(3, 3), concatenate=(False, False))  # fmt: skip
    model = pyramid.KernelPyramidModel(dataclasses.replace(spec, decoder=decoder, network=network))
    mean, sample, albedo, previous, logits = draw(16, 24, options=decoder)
    if blocks:
        logits[0] = by_blocks(logits[0])
    if integers:
        logits = [integers_of(level) for level in logits]

    def picture(turn, given):
        of_pixels = [turn.of_pixels(part) for part in (mean, albedo, previous)]
        light = Filterable(
            mean=of_pixels[0], sample=turned(turn, sample), remodulation_albedo=of_pixels[1],
            previous=of_pixels[2], exposure=1.0,
        )  # fmt: skip
        return model.reconstruct(light, given, Strips(1), {})

    straight = picture(VIEWS[0], logits)
    mirrored = picture(view, model.seen_from(view, logits, Strips(2), "seen"))
    np.testing.assert_allclose(view.of_pixels(mirrored), straight, rtol=1e-5)
    if view != VIEWS[0]:
        wrong = picture(view, [turned(view, level) for level in in_numbers(logits)])
        assert np.abs(view.of_pixels(wrong) / straight - 1).max() > 0.1


def turned(view, planes):
    """Planes seen so."""
    flipped = [axis for axis, is_so in ((1, view.rows), (2, view.columns)) if is_so]
    return np.ascontiguousarray(np.flip(planes, flipped))


def mirrored(frame, view):
    """A frame as a mirror shows it, its motion too."""
    signs = np.array([-1 if view.columns else 1, -1 if view.rows else 1], np.float32)
    buffers = {name: view.of_pixels(getattr(frame, name)) for name in ("color", "albedo", "normal")}
    motion = view.of_pixels(frame.motion) * signs
    return dataclasses.replace(frame, motion=motion, depth=view.of_pixels(frame.depth), **buffers)


@pytest.mark.parametrize("view", VIEWS[1:])
@pytest.mark.parametrize("model", ["kpyr-5", "kpyr-5s"])
def test_a_mean_over_all_views_does_not_care_how_a_frame_is_held(model, view):
    frames = [make_frame(48, 64, seed=index, shift=1.5) for index in range(FRAMES)]
    off = {}
    for ensemble in (1, 4):
        with stillray.Denoiser(model, ensemble=ensemble) as straight:
            wanted = [straight.denoise(frame) for frame in frames]
        with stillray.Denoiser(model, ensemble=ensemble) as other:
            got = [other.denoise(mirrored(frame, view)) for frame in frames]
        off[ensemble] = [
            np.abs(view.of_pixels(image) / right - 1)
            for image, right in zip(got, wanted, strict=True)
        ]
    assert off[4][0].max() < 1e-5 < 1e-2 < off[1][0].max()
    # whether a past still holds is found in blocks that begin at the top left
    assert np.median(off[4][-1]) < 0.1 * np.median(off[1][-1])


@pytest.mark.parametrize(
    "model",
    [
        pytest.param(
            "kpyr-5",
            marks=pytest.mark.xfail(
                strict=True, reason="1.3 % less since it learned sequences of several samples"
            ),
        ),
        "kpyr-5-still",
        "kpyr-5s",
    ],
)
def test_more_views_have_less_error(model):
    errors = errors_by_views(model)
    assert errors[2] < errors[1] < 0.985 * errors[0]


def test_more_views_of_the_flagship_have_a_little_less_error():
    errors = errors_by_views("kpyr-5")
    assert errors[2] < errors[1] < errors[0]


def errors_by_views(model):
    """Squared errors of means of 1, 2 and 4 views."""
    # a rendered room: on a box in white noise four views are as good as two
    frame, reference = (read_exr(ROOM / f"{name}_0007.exr") for name in ("frame", "ref"))
    wanted, errors = as_displayed(reference.color), []
    for ensemble in (1, 2, 4):
        with stillray.Denoiser(
            model, temporal=False, ensemble=ensemble, precision="float32"
        ) as denoiser:
            errors.append(np.square(as_displayed(denoiser.denoise(frame)) - wanted).mean())
    return errors


def as_displayed(image):
    return image / (1 + image)


def test_layers_of_all_views_add_up():
    rng = np.random.default_rng(3)
    with stillray.Denoiser("kpyr-5s", ensemble=3) as denoiser:
        for index in range(FRAMES):
            frame = make_frame(45, 38, seed=index, shift=1.5)
            part = (frame.color * rng.random(frame.color.shape)).astype(np.float32)
            layers = {"one": part, "other": frame.color - part}
            image, filtered = denoiser.denoise_layers(frame, layers)
            np.testing.assert_allclose(sum(filtered.values()), image, rtol=1e-5, atol=1e-5)


def test_tiles_of_all_views_are_the_whole():
    frame = make_frame(150, 760)  # longer than the least of tiles
    with stillray.Denoiser("kpyr-5s", precision="float32", ensemble=2) as denoiser:
        whole = denoiser.denoise(frame)
        denoiser.reset()
        denoiser.max_memory = 340 << 20
        np.testing.assert_allclose(denoiser.denoise(frame), whole, rtol=1e-4, atol=1e-5)


def test_a_mean_lies_in_the_first_picture():
    pictures = [np.full((2, 3, 3), value, np.float32) for value in (1, 2, 6)]
    assert mean_picture(pictures) is pictures[0]
    np.testing.assert_array_equal(pictures[0], 3)
    assert mean_picture(pictures[1:2])[0, 0, 0] == 2


@pytest.mark.parametrize(
    ("model", "ensemble", "message"),
    [
        ("kpyr-5", 0, "ensemble must be an integer from 1 to 4 with kpyr-5, got 0"),
        ("kpyr-5", 5, "ensemble must be an integer from 1 to 4 with kpyr-5, got 5"),
        ("kpyr-5", 2.0, "ensemble must be an integer from 1 to 4 with kpyr-5, got 2.0"),
        ("kpyr-5", True, "ensemble must be an integer from 1 to 4 with kpyr-5, got True"),
        ("wskp-3", 2, "ensemble must be 1 with wskp-3, got 2"),
    ],
)
def test_an_ensemble_that_a_model_cannot_make_is_refused(model, ensemble, message):
    with pytest.raises(InputError, match=message):
        stillray.Denoiser(model, ensemble=ensemble)


def test_a_plan_tells_of_them():
    with stillray.Denoiser("kpyr-5s", ensemble=2) as denoiser:
        (network,) = (
            stage for stage in denoiser.stages(make_frame(9, 14)) if stage.name == "network"
        )
    assert "2 times" in network.reason


def test_the_command_line_makes_anew_what_had_another_ensemble(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    write_frame(tmp_path / "shot.01.exr", 1)
    command = ["denoise", "shot.01.exr", "-o", "clean.exr", "-m", "kpyr-5s", "--resume"]
    frame = read_exr(tmp_path / "shot.01.exr")
    for ensemble in (1, 4):
        assert main([*command, "--ensemble", str(ensemble)]) == 0
        with stillray.Denoiser("kpyr-5s", ensemble=ensemble) as denoiser:
            wanted = denoiser.denoise(frame)
        np.testing.assert_allclose(read_exr(tmp_path / "clean.exr").color, wanted, rtol=1e-3)
    capsys.readouterr()
    assert main([*command, "--ensemble", "5"]) == 2
    assert "ensemble must be" in capsys.readouterr().err
