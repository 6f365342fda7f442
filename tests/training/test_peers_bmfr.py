from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("scipy")

from stillray_training.peers.bmfr import Bmfr, BmfrOptions, block_offset, features, fit, regress
from stillray_training.peers.sequence import SequenceOptions, prepare
from tests.conftest import make_frame

OPTIONS = BmfrOptions()


def mirrored(index, size):
    """The image goes on mirrored, its last pixel twice, as often as needed."""
    index %= 2 * size
    return index if index < size else 2 * size - 1 - index


def slow_fit(irradiance, basis, index, options):
    """Block by block, least squares by `numpy.linalg.lstsq` on the shaken features."""
    height, width = irradiance.shape[:2]
    top, left = block_offset(index, options)
    size, count = options.block, basis.shape[2]
    corners = [
        (y, x) for y in range(-top, height, size) for x in range(-left, width, size)
    ]  # fmt: skip
    noise = np.random.default_rng(index).uniform(
        -options.noise, options.noise, (len(corners), size * size, count - 1)
    )
    result = np.zeros(irradiance.shape)
    for block, (y, x) in enumerate(corners):
        pixels = [(y + i, x + j) for i in range(size) for j in range(size)]
        seen = [(mirrored(i, height), mirrored(j, width)) for i, j in pixels]
        plain = np.array([basis[p] for p in seen])
        for column in range(4, count):
            values = plain[:, column]
            span = values.max() - values.min()
            plain[:, column] = (values - values.min()) / span if span > 0 else 0
        shaken = plain.copy()
        shaken[:, 1:] += noise[block]
        wanted = np.array([irradiance[p] for p in seen], np.float64)
        weights = np.linalg.lstsq(shaken, wanted, rcond=None)[0]
        for (i, j), row in zip(pixels, plain, strict=True):
            if 0 <= i < height and 0 <= j < width:
                result[i, j] = np.maximum(row @ weights, 0)
    return result


@pytest.mark.parametrize(("size", "index"), [((13, 19), 1), ((13, 19), 6), ((3, 5), 2)])
def test_fit_is_its_definition(rng, size, index):
    options = BmfrOptions(block=8)
    frame = make_frame(*size)
    basis = features(prepare(frame, None, SequenceOptions()))
    irradiance = rng.exponential(1.0, (*size, 3)).astype(np.float32)
    wanted = slow_fit(irradiance, basis, index, options)
    np.testing.assert_allclose(fit(irradiance, basis, index, options), wanted, rtol=1e-4, atol=1e-5)


def test_regression_of_one_block_is_least_squares(rng):
    basis = rng.normal(size=(1, 1024, 10))
    basis[..., 0] = 1
    colors = rng.normal(size=(1, 1024, 3))
    weights = regress(basis, colors, np.random.default_rng(5), OPTIONS)
    shaken = basis[0].copy()
    shaken[:, 1:] += np.random.default_rng(5).uniform(-0.01, 0.01, (1, 1024, 9))[0]
    wanted = np.linalg.lstsq(shaken, colors[0], rcond=None)[0]
    np.testing.assert_allclose(weights[0], wanted, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("index", [0, 3])
def test_what_features_explain_is_reproduced(index):
    box = make_frame(50, 70)
    frame = dataclasses.replace(box, depth=np.full((50, 70), 3.0))
    basis = features(prepare(frame, None, SequenceOptions()))
    # light that falls off along x and hangs on the normal
    x = np.linspace(-1, 1, 70)
    light = (1 + 0.5 * x + 0.3 * x**2)[None, :, None] + 0.4 * frame.normal
    result = fit(light.astype(np.float32), basis, index, OPTIONS)
    np.testing.assert_allclose(result, light, atol=0.02)


def test_features_that_depend_on_each_other_stay_regular():
    # one plane seen from the front: normal and depth are constant, as is the first feature
    basis = np.ones((40, 40, 10))
    irradiance = np.full((40, 40, 3), 2.0, np.float32)
    np.testing.assert_allclose(fit(irradiance, basis, 0, OPTIONS), 2, rtol=1e-5)


def test_blocks_are_displaced_from_frame_to_frame():
    offsets = {block_offset(index, OPTIONS) for index in range(16)}
    assert len(offsets) == 16
    assert all(0 <= part < 32 for offset in offsets for part in offset)
    assert block_offset(0, OPTIONS) == block_offset(16, OPTIONS)


def test_samples_and_fits_are_both_accumulated():
    stream = Bmfr()
    irradiance, fits = [], []
    for index in range(3):
        frame = make_frame(40, 50, index)
        stream.denoise(frame)
        buffers = prepare(frame, None, SequenceOptions())
        irradiance.append(buffers.irradiance)
        mean = np.mean(irradiance, axis=0).astype(np.float32)
        fits.append(fit(mean, features(buffers), index, OPTIONS))
    np.testing.assert_allclose(stream.history.color[..., :3], mean, rtol=1e-5, atol=1e-6)
    wanted = np.mean(fits, axis=0)
    np.testing.assert_allclose(stream.history.filtered[..., :3], wanted, rtol=1e-3, atol=1e-4)
