"""NFOR is what its equations say, and does what it is for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("torch", reason="training is of the extra train")

from stillray.errors import InputError
from stillray.frame import Frame
from stillray_training.evaluate.methods import choose_peers
from stillray_training.online import evaluate as online
from stillray_training.peers import nfor
from stillray_training.peers.nfor import NforOptions
from tests.conftest import make_frame

SMALL = NforOptions(window=2, patch=1)


def slow_weight(guide, variance, p, q, patch, bandwidth):
    """Of pixel q in the window of p, patch by patch, in float64."""
    height, width, channels = guide.shape
    distances = []
    for i in range(-patch, patch + 1):
        for j in range(-patch, patch + 1):
            a, b = (p[0] + i, p[1] + j), (q[0] + i, q[1] + j)
            if not all(0 <= y < height and 0 <= x < width for y, x in (a, b)):
                continue
            apart = 0.0
            for c in range(channels):
                va, vb = variance[*a, c], variance[*b, c]
                square = (guide[*a, c] - guide[*b, c]) ** 2 - (va + min(va, vb))
                apart += min(square / (1e-7 + bandwidth**2 * (va + vb)), 1e4)
            distances.append(apart / channels)
    weight = np.exp(-max(np.mean(distances), 0))
    return max(weight, 1e-4) if p == q else weight


def slow_regression(image, features, guide, variance, options, bandwidth):
    """A window's least squares by their rows, pixel by pixel."""
    height, width = image.shape[:2]
    total, weights = np.zeros_like(image), np.zeros((height, width))
    for p in np.ndindex(height, width):
        inside = [
            (y, x)
            for y in range(p[0] - options.window, p[0] + options.window + 1)
            for x in range(p[1] - options.window, p[1] + options.window + 1)
            if 0 <= y < height and 0 <= x < width
        ]
        w = np.array([slow_weight(guide, variance, p, q, options.patch, bandwidth) for q in inside])
        rows = np.array(
            [
                [
                    1,
                    (q[1] - p[1]) / options.window,
                    (q[0] - p[0]) / options.window,
                    *(features[q] - features[p]),
                ]
                for q in inside
            ]
        )
        # the ridge as rows of their own, weight 1
        ridge = np.sqrt(1e-6 * (w[:, None] * rows**2).sum() / rows.shape[1])
        above = np.sqrt(w)[:, None]
        system = np.vstack([above * rows, ridge * np.eye(rows.shape[1])])
        wanted = np.vstack([above * [image[q] for q in inside], np.zeros((rows.shape[1], 3))])
        fit = np.linalg.lstsq(system, wanted, rcond=None)[0]
        for q, weight, row in zip(inside, w, rows, strict=True):
            total[q] += weight * (row @ fit)
            weights[q] += weight
    return total / weights[..., None]


@pytest.mark.parametrize("size", [(1, 1), (2, 5), (7, 6)])
@pytest.mark.parametrize("bandwidth", [0.5, 1.0])
def test_regression_equals_the_loop_oracle(rng, size, bandwidth):
    image, guide = (rng.uniform(0, 2, (*size, 3)) for _ in range(2))
    variance = rng.uniform(0, 1, (*size, 3))
    features = rng.normal(size=(*size, 2))
    given = (image, features, guide, variance, SMALL, bandwidth)
    expected = slow_regression(*given)
    np.testing.assert_allclose(nfor.collaborative_regression(*given), expected, atol=1e-7)


def test_non_local_means_equal_the_loop_oracle(rng):
    image, guide = rng.normal(size=(5, 6, 3)), rng.uniform(0, 2, (5, 6, 3))
    variance = rng.uniform(0, 1, (5, 6, 3))
    expected = np.zeros_like(image)
    for p in np.ndindex(5, 6):
        near = [q for q in np.ndindex(5, 6) if max(abs(q[0] - p[0]), abs(q[1] - p[1])) <= 2]
        weights = np.array([slow_weight(guide, variance, p, q, 1, 1.0) for q in near])
        expected[p] = (weights[:, None] * [image[q] for q in near]).sum(0) / weights.sum()
    np.testing.assert_allclose(nfor.nl_means(image, guide, variance, 2, 1), expected, rtol=1e-9)


def test_the_error_of_filtered_halves_is_told_without_the_truth(rng):
    # filtered halves that are off by 0.3 and hold noise of their own, over many pixels
    truth, noise, left, off = 1.0, 0.5, 0.1, 0.3
    shape = (200, 200, 3)
    first, second = (truth + noise * rng.normal(size=shape) for _ in range(2))
    filtered = [truth + off + left * rng.normal(size=shape) for _ in range(2)]
    variance = np.full(shape, noise**2)
    told = nfor.estimated_error(first, second, filtered, variance).mean()
    assert told == pytest.approx(((np.mean(filtered, axis=0) - truth) ** 2).mean(), rel=0.03)


def test_a_plane_of_features_survives_and_noise_goes(rng):
    height, width = 24, 28
    albedo = rng.uniform(0.2, 0.9, (height, width, 3))  # a texture without any repetition
    halves = [albedo * 2 + 0.3 * rng.normal(size=albedo.shape) for _ in range(2)]
    options = NforOptions(window=4, patch=2)
    image = nfor.nfor(*halves, albedo, options)
    before = np.abs(np.mean(halves, axis=0) - 2 * albedo).mean()
    assert np.abs(image - 2 * albedo).mean() < 0.5 * before
    # with features that say nothing the texture is what is lost
    blind = nfor.nfor(*halves, np.zeros_like(albedo), options)
    assert np.abs(blind - 2 * albedo).mean() > 2 * np.abs(image - 2 * albedo).mean()


def test_frames_of_two_halves_are_filtered_and_others_refused(rng):
    frame = make_frame(12, 14)
    with pytest.raises(InputError, match="color_b"):
        nfor.Nfor(SMALL).denoise(frame)
    other = rng.uniform(0, 2, frame.color.shape).astype(np.float32)
    other[3, 4] = np.nan
    both = dataclasses.replace(frame, color_b=other)
    image = nfor.Nfor(SMALL).denoise(both)
    assert image.shape == frame.color.shape
    assert image.dtype == np.float32
    assert np.isfinite(image).all()
    assert (image >= 0).all()
    plain = nfor.Nfor(SMALL).denoise(Frame(color=frame.color, color_b=other))
    assert np.isfinite(plain).all()


def test_it_is_given_halves_online_and_not_by_the_evaluation_of_frames(rng, monkeypatch):
    assert "nfor" not in choose_peers(None)
    with pytest.raises(InputError, match="frames of one color, got nfor"):
        choose_peers(["svgf", "nfor"])
    frame = dataclasses.replace(make_frame(12, 14), color_b=rng.random((12, 14, 3), np.float32))
    monkeypatch.setattr(nfor, "NforOptions", lambda: SMALL)
    from contextlib import ExitStack

    with ExitStack() as opened:
        methods = dict(online.streams([], ["nfor"], opened, parts=False))
        expected = nfor.Nfor(SMALL).denoise(frame)
        np.testing.assert_array_equal(methods["nfor"](frame), expected)
