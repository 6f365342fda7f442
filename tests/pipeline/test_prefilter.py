"""A frame's albedo is denoised before the frame is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.arrays.tiles import tiles_of
from stillray.errors import Cancelled, InputError
from stillray.families.contract import Context
from stillray.frame import Frame
from stillray.model_spec.stages import Prefilter as Prefilters
from stillray.models.registry import find_model
from stillray.pipeline.prefilter import PREFILTER, Prefilter, guides_of, prefilter_stages
from tests.conftest import ODD_SIZES, make_frame

MODEL = "kpyr-5-still"
PALE, DARK = np.float32([0.8, 0.75, 0.7]), np.float32([0.08, 0.12, 0.2])


@pytest.fixture(scope="module")
def prefilter():
    made = Prefilter("kpyr-5s-albedo", 1, None, "float32")
    yield made
    made.close()


@pytest.fixture
def context():
    strips = Strips(2)
    yield Context(strips=strips)
    strips.close()


def out_of_focus(rng, samples, height=64, width=96):
    """A frame whose samples meet a pale wall or a dark floor, by a share that rises to the right;
    and its albedo without noise."""
    share = np.clip((np.arange(width) - width / 2) / 32 + 0.5, 0, 1)
    floor = rng.random((samples, height, width)) < share
    albedo = np.where(floor[..., None], DARK, PALE).mean(0)
    normal = np.where(floor[..., None], np.float32([0, 1, 0]), np.float32([0, 0, 1])).mean(0)
    light = rng.exponential(1, (height, width, 1)).astype(np.float32)
    frame = Frame(
        color=albedo * light,
        albedo=albedo,
        normal=normal,
        depth=np.where(floor[-1], 6.0, 2.0),
        samples=samples,
    )
    mean = (1 - share[:, None]) * PALE + share[:, None] * DARK
    return frame, np.broadcast_to(mean.astype(np.float32), frame.color.shape)


@pytest.mark.parametrize(("samples", "left"), [(1, 0.5), (4, 0.5), (16, 0.7)])
def test_most_of_the_noise_of_an_albedo_out_of_focus_goes(rng, prefilter, context, samples, left):
    """Less of it where samples are many: a mean of those is known, see `sample_bounds`."""
    frame, mean = out_of_focus(rng, samples)
    found = prefilter.denoised(frame, context, None)

    def error(albedo):
        return np.sqrt(np.mean((albedo - mean)[8:-8, 34:62] ** 2))

    assert error(found.albedo) < left * error(frame.albedo)


def test_an_albedo_without_noise_keeps_its_texture(rng, prefilter, context):
    """Tiles with joints of one pixel, and single-pixel checks beside them."""
    albedo = np.full((64, 96, 3), 0.6, np.float32) * np.float32([1, 0.8, 0.6])
    albedo[::8] = albedo[:, ::8] = 0.2
    rows, columns = np.mgrid[:64, :48]
    albedo[:, 48:] = np.where((rows + columns)[..., None] % 2, 0.7, 0.3)
    normal = np.zeros_like(albedo) + np.float32([0, 0, 1])
    frame = Frame(color=albedo, albedo=albedo, normal=normal, depth=np.ones((64, 96)), samples=256)
    found = prefilter.denoised(frame, context, None).albedo
    assert np.sqrt(np.mean((found - albedo) ** 2)) < 0.02


def glass(rng, samples, size=64):
    """A pane of which each sample meets one of two materials, and its albedo without noise."""
    met = rng.random((samples, size, size)) < 0.4
    albedo = np.where(met[..., None], DARK, PALE).mean(0)
    normal = np.zeros((size, size, 3), np.float32) + np.float32([0, 0, 1])
    frame = Frame(color=albedo, albedo=albedo, normal=normal, samples=samples)
    return frame, 0.6 * PALE + 0.4 * DARK


def test_of_many_samples_a_network_expects_no_less_noise_than_of_one(rng):
    """Glass has noise at any count; pixels that carry nothing carry nothing."""
    frame, _ = glass(rng, 16, 2)
    counts = np.float32([[0, 0.5], [3, 64]])
    for samples, told in ((None, None), (16, 1), (0.5, 0.5), (counts, [[0, 0.5], [1, 1]])):
        given = dataclasses.replace(frame, samples=samples)
        found = guides_of(given, frame.albedo).samples
        assert found is None if told is None else np.array_equal(found, told)


def test_pixels_without_samples_carry_nothing_into_the_albedo(rng, prefilter, context):
    frame, mean = glass(rng, 16)
    counts = np.full(frame.shape, 16.0, np.float32)
    counts[20:24, 20:24] = 0
    albedo = frame.albedo.copy()
    albedo[20:24, 20:24] = 0.9
    broken = dataclasses.replace(frame, albedo=albedo, samples=counts)
    found = prefilter.denoised(broken, context, None).albedo
    np.testing.assert_allclose(found[20:24, 20:24], np.broadcast_to(mean, (4, 4, 3)), atol=0.15)


def test_what_is_denoised_lies_within_what_was_there(rng, prefilter, context):
    frame, _ = out_of_focus(rng, 2)
    found = prefilter.denoised(frame, context, None)
    for channel in range(3):
        given = frame.albedo[..., channel]
        assert found.albedo[..., channel].min() >= given.min() - 1e-5
        assert found.albedo[..., channel].max() <= given.max() + 1e-5
    assert found.clean_features
    for name in ("color", "normal", "depth"):
        np.testing.assert_array_equal(getattr(found, name), getattr(frame, name))


def test_a_sky_stays_black_beside_a_house(prefilter, context):
    albedo = np.zeros((48, 64, 3), np.float32)
    albedo[:, :32] = 0.7
    normal = np.zeros_like(albedo)
    normal[:, :32, 2] = 1
    depth = np.zeros((48, 64), np.float32)
    depth[:, :32] = 3
    frame = Frame(color=albedo + 1, albedo=albedo, normal=normal, depth=depth, samples=4)
    found = prefilter.denoised(frame, context, None).albedo
    assert (found[:, 34:] == 0).all()
    np.testing.assert_allclose(found[:, :30], 0.7, atol=0.01)


@pytest.mark.parametrize("size", [*ODD_SIZES, (1, 40), (40, 1)])
def test_every_size_and_broken_values_give_albedos(size, prefilter, context):
    frame = make_frame(*size, 0)
    albedo = frame.albedo.copy()
    albedo[0, 0], albedo[-1, -1] = np.nan, (np.inf, -1, 3)
    found = prefilter.denoised(dataclasses.replace(frame, albedo=albedo), context, None).albedo
    assert found.shape == albedo.shape
    assert found.min() >= 0
    assert found.max() <= 1


def test_a_frame_is_denoised_with_the_denoised_albedo(rng, prefilter, context):
    frame, mean = out_of_focus(rng, 4)
    first = prefilter.denoised(frame, context, None)
    info = find_model(MODEL)
    plain = dataclasses.replace(info, spec=dataclasses.replace(info.spec, prefilter=Prefilters()))
    with (
        stillray.Denoiser(info, precision="float32", threads=2) as ours,
        stillray.Denoiser(plain, precision="float32", threads=2) as bare,
    ):
        image = ours.denoise(frame)
        assert ours.last_timings[PREFILTER] > 0
        np.testing.assert_array_equal(image, bare.denoise(first))
        assert PREFILTER not in bare.last_timings
        # what is said to have no noise is taken as it is
        clean = dataclasses.replace(frame, clean_features=True)
        np.testing.assert_array_equal(ours.denoise(clean), bare.denoise(frame))
        assert PREFILTER not in ours.last_timings
        light = np.mean(frame.color / frame.albedo)
        assert (
            np.abs(image - light * mean)[8:-8].mean()
            < np.abs(bare.denoise(frame) - light * mean)[8:-8].mean()
        )


def test_stages_say_whether_and_why(rng):
    frame, _ = out_of_focus(rng, 1)
    with stillray.Denoiser(MODEL) as denoiser:
        told = {
            reason: denoiser.stages(given)[0]
            for reason, given in (
                ("the albedo may have noise: kpyr-5s-albedo", frame),
                ("there is no albedo", Frame(color=frame.color)),
                (
                    "the albedo is said to have no noise",
                    dataclasses.replace(frame, clean_features=True),
                ),
            )
        }
    assert [stage.name for stage in told.values()] == [PREFILTER] * 3
    assert [stage.runs for stage in told.values()] == [True, False, False]
    assert all(stage.reason == reason for reason, stage in told.items())
    assert prefilter_stages(frame, find_model("kpyr-5").spec) == []


@pytest.mark.parametrize("broken", [np.nan, np.inf, -1.0, 3.0])
def test_what_is_said_of_a_broken_albedo_is_what_runs(rng, broken):
    """It is denoised, not repaired: what is denoised is in its range."""
    frame, _ = out_of_focus(rng, 1)
    frame.albedo[5, 7] = broken
    with stillray.Denoiser(MODEL) as denoiser:
        said = {stage.name for stage in denoiser.stages(frame) if stage.runs}
        denoiser.denoise(frame)
        assert said == set(denoiser.last_timings)
    assert PREFILTER in said
    assert "repair" not in said


def test_tiles_give_what_the_whole_frame_gives(monkeypatch, prefilter, context):
    frame = make_frame(300, 420, 1)
    whole = prefilter.denoised(frame, context, None).albedo
    plans = []

    def plan(shape, use, traits, max_memory, name):
        plans.append(tiles_of(shape, 160, traits.tile_overlap, traits.tile_alignment))
        return plans[-1]

    monkeypatch.setattr(stillray.pipeline.plan, "plan_tiles", plan)
    tiles = prefilter.denoised(frame, context, 1).albedo
    assert len(plans[0]) > 2
    np.testing.assert_allclose(tiles, whole, atol=2e-3)


def test_a_frame_can_be_ended_while_its_albedo_is_denoised():
    frame = make_frame(96, 128, 1)
    told = []

    def never(share):
        told.append(share)
        return False

    with stillray.Denoiser(MODEL) as denoiser:
        with pytest.raises(Cancelled):
            denoiser.denoise(frame, progress=never)
        assert PREFILTER not in denoiser.last_timings
        assert len(told) == 1
        expected = denoiser.denoise(frame)
        np.testing.assert_array_equal(denoiser.denoise(frame), expected)


@pytest.mark.parametrize("value", [1, None, "yes"])
def test_clean_features_are_said_by_true_or_false(value):
    with pytest.raises(InputError, match="clean_features must be True or False, got"):
        Frame(color=np.ones((4, 6, 3)), clean_features=value)


def test_a_prefilter_that_is_not_there_is_named():
    info = find_model(MODEL)
    spec = dataclasses.replace(info.spec, prefilter=Prefilters(albedo="nothing"))
    with pytest.raises(InputError, match="nothing"):
        stillray.Denoiser(dataclasses.replace(info, spec=spec))
