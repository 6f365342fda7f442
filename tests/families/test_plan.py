"""What `stages` says is what runs and what is timed, whatever a frame holds."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.frame import Frame
from stillray.pipeline.opening import family_of_model
from stillray.pipeline.plan import Asked, plan_frames
from tests.conftest import make_frame

SIZE = (40, 56)
LAYERS = {"a": np.ones((*SIZE, 3), np.float32)}


def frame(seed=0, shift=1.0, **buffers):
    return dataclasses.replace(make_frame(*SIZE, seed, shift=shift), **buffers)


def holed(name, value, seed=0):
    whole = frame(seed)
    array = getattr(whole, name).copy()
    array[3:6, 5:9] = value
    return dataclasses.replace(whole, **{name: array})


def mirrored(seed=0, albedo=0.0):
    """A large black thing in the picture, which may be a mirror."""
    whole = frame(seed)
    black = whole.albedo.copy()
    black[8:32, 8:48] = albedo
    return dataclasses.replace(whole, albedo=black)


ALONE = {
    "moving": frame(1),
    "still": frame(1, shift=0.0),
    "without motion": frame(1, motion=None),
    "without albedo": frame(1, albedo=None),
    "without geometry": frame(1, normal=None, depth=None),
    "color alone": Frame(color=make_frame(*SIZE, 1).color),
    "color and motion": frame(1, albedo=None, normal=None, depth=None),
    "NaN color": holed("color", np.nan, 1),
    "negative color": holed("color", -1, 1),
    "NaN normal": holed("normal", np.nan, 1),
    "albedo above 1": holed("albedo", 1.5, 1),
    "infinite depth": holed("depth", np.inf, 1),
    "NaN motion": holed("motion", np.nan, 1),
    "mirror": mirrored(1),
    "NaN albedo, which counts as black": mirrored(1, np.nan),
    "another size": make_frame(33, 18, 1, shift=1.0),
    "too small to tell light": make_frame(7, 9, 1, shift=1.0),
}


def said(denoiser, given, layers=()):
    return {stage.name for stage in denoiser.stages(given, layers) if stage.runs}


@pytest.fixture(params=["wskp-6", "wskp-mr", "kpyr-5s", "nbg-2x1"])
def model(request):
    return request.param


@pytest.mark.parametrize("temporal", [True, False])
@pytest.mark.parametrize("second", ALONE)
def test_what_is_said_is_what_runs_and_is_timed(model, second, temporal):
    with stillray.Denoiser(model, temporal=temporal) as denoiser:
        for given in (frame(), ALONE[second], frame(2)):
            told = said(denoiser, given)
            denoiser.denoise(given)
            assert told == set(denoiser.last_timings)


def test_a_first_frame_of_layers_is_said_to_begin_anew(model):
    with stillray.Denoiser(model) as denoiser:
        denoiser.denoise(frame())
        for seed, began in ((1, True), (2, False)):
            given = frame(seed)
            told = said(denoiser, given, LAYERS)
            denoiser.denoise_layers(given, LAYERS)
            assert told == set(denoiser.last_timings)
            assert ("reproject" in told) != began
            assert "layers" in told


def test_after_a_reset_and_after_a_state_put_back(model):
    with stillray.Denoiser(model) as denoiser:
        denoiser.denoise(frame())
        kept = denoiser.state
        denoiser.reset()
        assert "reproject" not in said(denoiser, frame(1))
        denoiser.state = kept
        assert "reproject" in said(denoiser, frame(1))


def test_asking_changes_nothing(model):
    with stillray.Denoiser(model) as asked, stillray.Denoiser(model) as plain:
        for seed in range(3):
            given = holed("color", np.nan, seed)
            asked.stages(given)
            np.testing.assert_array_equal(asked.denoise(given), plain.denoise(given))


def test_a_plan_of_a_sequence_is_what_its_frames_run(model):
    frames = [frame(), mirrored(1), frame(2, motion=None), frame(3)]
    with stillray.Denoiser(model) as denoiser:
        plans = plan_frames(frames, family_of_model(denoiser.model), Asked(model=model))
        for given, plan in zip(frames, plans, strict=True):
            denoiser.denoise(given)
            assert {stage.name for stage in plan.stages if stage.runs} == set(denoiser.last_timings)
            assert all(stage.reason for stage in plan.stages)
