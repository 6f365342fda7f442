"""Frames of many strips have the pictures of one: every operator, on the way of whole frames."""

from __future__ import annotations

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.contract import Context, Layer, Request
from stillray.families.registry import kernels_of
from stillray.models.network import Network
from stillray.models.registry import find_model
from tests.conftest import make_frame

SIZE = (97, 86)  # large enough for changes of light to be told; whole blocks of nothing
PIXELS = 86 * 7  # strips of a few rows


def frames():
    """A box that moves, a fireflies' rain, a mirror, and a light that goes down."""
    rng = np.random.default_rng(3)
    for seed in range(3):
        frame = make_frame(*SIZE, seed, shift=1.7)
        frame.color[rng.random(SIZE) < 0.01] *= 300
        frame.albedo[20:70, 10:30] = 0
        if seed == 2:
            frame.color[...] *= 0.1
            frame.normal[3, 5] = np.nan
        yield frame


def stream(model, strips, engine):
    """Pictures, layers and what is remembered."""
    family, request = kernels_of(model.spec), Request(layers=frozenset({"half"}))
    state, found = None, []
    for frame in frames():
        context = Context(strips=strips, engine=engine)
        step = family.step(family.plan(frame, state, request, context), context)
        layer = step.filter_layer("half", Layer(radiance=frame.color / 2))
        state = step.finish()
        past = state.temporal
        found.append(
            (step.image, layer, past.mean, past.surface_guides, past.output, past.mean_albedo)
        )
        assert {"reject_history", "specular_motion", "reproject"} <= set(context.timings) or len(
            found
        ) == 1
    return found


@pytest.mark.parametrize("name", ["wskp-6", "wskp-3s", "wskp-mr", "kpyr-5s", "nbg-2x3"])
def test_pictures_do_not_depend_on_how_frames_are_cut(name):
    model = find_model(name)
    engine = Network(model.path, threads=1, providers=None)
    few, many = Strips(1), Strips(2, pixels=PIXELS)
    assert len(few.of(*SIZE)) == 1
    assert len(many.of(*SIZE)) > 10
    for whole, cut in zip(stream(model, few, engine), stream(model, many, engine), strict=True):
        for expected, got in zip(whole, cut, strict=True):
            if expected is None:
                assert got is None
            else:
                # sums that go over several strips are added in another order
                np.testing.assert_allclose(got, expected, rtol=1e-4, atol=1e-5)
    engine.close()
