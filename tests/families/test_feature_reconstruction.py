"""The reconstruction by feature distances, and its twin in PyTorch, against a loop in float64."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from stillray.arrays.strips import Strips
from stillray.families.feature_reconstruction import (
    Accumulated,
    Enlarged,
    Past,
    Rules,
    reconstruct,
)
from stillray.model_spec import load
from stillray_training.decoders import feature_filters as twin
from tests import oracles

SPEC = load("munet-x2")
RULES = Rules(filters=SPEC.decoder, demodulate=SPEC.demodulate, max_samples=32.0)
LEVELS = 4


def case(rng, height, width, spread=1.0):
    """A frame, its past and a network's planes: mirrors, black albedo, fireflies, no past."""
    light = lambda *shape: rng.lognormal(0, 2, shape).astype(np.float32)  # noqa: E731
    frame = {"color": light(height, width, 3)}
    frame["color"][0, 0] = 1e6
    frame["color"][-1, -1] = 0
    for name in ("albedo", "specular"):
        frame[name] = rng.uniform(0, 1, (height, width, 3)).astype(np.float32)
        frame[name][:, width // 2 :] *= rng.random((height, width - width // 2, 1)) < 0.5
    past = {}
    for name in ("light", "albedo", "specular"):
        values = light(height, width, 3) if name == "light" else rng.random((height, width, 3))
        counts = rng.uniform(0, 32, (height, width, 1)) * (rng.random((height, width, 1)) < 0.8)
        past[name] = np.concatenate([values * (counts > 0), counts], -1).astype(np.float32)
    past["output"] = light(height, width, 4)
    sizes = [(104, 2), (6, 2), (6, 4), (5, 8)]
    planes = [
        (spread * rng.normal(size=(count, height // part, width // part))).astype(np.float32)
        for count, part in sizes
    ]
    return frame, past, planes


EXPOSURE = 0.6


def in_runtime(frame, past, planes, strips=None, rules=RULES):
    kept = Accumulated(past["light"], past["albedo"], past["specular"])
    with_past = Past(kept, past["output"])
    image, after = reconstruct(
        Enlarged(**frame, exposure=EXPOSURE),
        with_past,
        planes,
        rules,
        strips or Strips(1),
        Accumulated.empty(frame["color"].shape[:2]),
    )
    return {
        "image": image,
        "light": after.light,
        "albedo": after.albedo,
        "specular": after.specular,
    }


def in_torch(frame, past, planes, kind=torch.float32, rules=RULES):
    def tensor(image):
        return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None].to(kind)

    image, kept = twin.reconstruct(
        twin.Enlarged(
            **{name: tensor(image) for name, image in frame.items()},
            exposure=torch.full((1, 1, 1, 1), EXPOSURE, dtype=kind),
        ),
        twin.Remembered(**{name: tensor(image) for name, image in past.items()}),
        [torch.from_numpy(part)[None].to(kind) for part in planes],
        rules,
    )
    parts = dict(zip(("image", "light", "albedo", "specular"), (image, *kept), strict=True))
    return {name: part[0].permute(1, 2, 0).numpy() for name, part in parts.items()}


def expected(frame, past, planes, rules=RULES):
    finest = torch.nn.functional.pixel_shuffle(torch.from_numpy(planes[0])[None], 2)[0].numpy()
    return oracles.feature_filters(frame, past, [finest, *planes[1:]], rules, EXPOSURE)


def filtered_by(*distances, tone=0.0):
    filters = dataclasses.replace(RULES.filters, coarsest_filters=distances, filter_tone=tone)
    return dataclasses.replace(RULES, filters=filters)


# 20: most logits lie beyond the bound; 7: further than the level is wide
@pytest.mark.parametrize("tone", [0.0, 0.7])
@pytest.mark.parametrize(("spread", "distances"), [(1.0, (1,)), (20.0, (1,)), (1.0, (7, 2, 1))])
def test_all_forms_agree_with_loops_in_float64(rng, spread, distances, tone):
    given, rules = case(rng, 16, 24, spread), filtered_by(*distances, tone=tone)
    oracle = expected(*given, rules)
    for found in (in_runtime(*given, rules=rules), in_torch(*given, rules=rules)):
        for name, image in found.items():
            # every pixel for itself, a firefly beside a dark one or not
            np.testing.assert_allclose(image, oracle[name], rtol=2e-4, atol=1e-6, err_msg=name)
    exact = in_torch(*given, kind=torch.float64, rules=rules)
    # weights of luminance are rounded to float32
    np.testing.assert_allclose(exact["image"], oracle["image"], rtol=1e-7 if tone else 1e-9)


def test_strips_do_not_show(rng):
    given = case(rng, 32, 24)
    rules = filtered_by(2, 1)
    whole = in_runtime(*given, rules=rules)
    cut = in_runtime(*given, strips=Strips(2, pixels=24 * 3), rules=rules)
    for name, image in whole.items():
        np.testing.assert_array_equal(cut[name], image, err_msg=name)


def test_no_light_is_invented(rng):
    frame, past, planes = case(rng, 16, 16, 4.0)
    zeros = np.zeros_like(frame["albedo"])
    found = in_runtime({**frame, "albedo": zeros, "specular": zeros}, past, planes)["image"]
    lights = [frame["color"], past["light"][..., :3], past["output"][..., :3]]
    most, least = max(map(np.max, lights)), min(map(np.min, lights))
    assert found.max() <= most * 1.0001
    assert found.min() >= least * 0.9999 - 1e-6


def test_without_a_past_nothing_of_it_shows(rng):
    frame, past, planes = case(rng, 16, 16)
    empty = {name: np.zeros_like(image) for name, image in past.items()}
    empty["output"] = past["output"]  # not known, though there
    image, after = reconstruct(
        Enlarged(**frame, exposure=EXPOSURE),
        None,
        planes,
        RULES,
        Strips(1),
        Accumulated.empty(frame["color"].shape[:2]),
    )
    found = in_runtime(frame, empty, planes)
    np.testing.assert_array_equal(image, found["image"])
    np.testing.assert_array_equal(after.light, found["light"])
    assert (after.light[..., 3] == 1).all()


def test_planes_that_are_no_numbers_count_as_zero(rng):
    frame, past, planes = case(rng, 16, 16)
    broken = [part.copy() for part in planes]
    for part in broken:
        part[:, 1, 1] = np.nan
    zeroed = [np.nan_to_num(part, nan=0.0) for part in broken]
    image = in_runtime(frame, past, broken)["image"]
    np.testing.assert_array_equal(image, in_runtime(frame, past, zeroed)["image"])
    assert np.isfinite(image).all()


def test_equal_frames_are_worth_as_many_samples_as_there_were(rng):
    frame, _, planes = case(rng, 16, 16, 0.0)  # logits of 0: the plain mean
    past = None
    for count in range(1, 41):
        _, kept = reconstruct(
            Enlarged(**frame, exposure=EXPOSURE),
            past,
            planes,
            RULES,
            Strips(1),
            Accumulated.empty(frame["color"].shape[:2]),
        )
        np.testing.assert_allclose(kept.light[..., 3], min(count, 32), rtol=1e-4)
        past = Past(kept, np.zeros((16, 16, 4), np.float32))
