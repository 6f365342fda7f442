"""How much of the last output a picture takes: what single pixels say, and what nobody says."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.contract import Context, Request
from stillray.families.registry import kernels_of
from stillray.model_spec import load
from stillray.stages.recall import (
    BLOCK,
    DARK,
    LEAST_APART,
    LITTLE_TOLD,
    TAIL,
    USUAL_NOISE,
    Compared,
    Recall,
    believed,
)
from stillray.stages.sample_counts import SampleCounts
from tests.conftest import make_frame


def recall(samples=None, power=0.5, limit=2.5):
    return Recall(power=power, limit=limit, counts=SampleCounts.of(samples, None))


def share(previous, color, exposure=1.0, strips=None, worth=None, **rules):
    strips = strips or Strips(1)
    seen = Compared(previous, previous, color, exposure, worth)
    found = recall(**rules).share(seen, strips, Workspace())
    plain = recall(**{**rules, "power": 0.0}).share(seen, strips, Workspace())
    # how far they agree has nothing to do with what a frame's samples weigh
    np.testing.assert_array_equal(found.agreed, plain.agreed)
    np.testing.assert_array_equal(plain.output, plain.agreed)
    return found.output.copy()


def noisy(rng, shape, noise):
    """A last output of some light, and a sample of it with so much noise."""
    light = rng.uniform(0.2, 2, (*shape, 1)) * np.ones(3)
    sample = light * np.exp(noise * rng.normal(size=(*shape, 1)))
    valid = np.ones((*shape, 1))
    return np.concatenate([light, valid], -1).astype(np.float32), sample.astype(np.float32)


def by_blocks(blocks, shape):
    """Blocks at their pixels, bilinear between their centres, pixel by pixel."""
    found = np.empty(shape)
    for at in np.ndindex(shape):
        places = [
            np.clip((place + 0.5) / BLOCK - 0.5, 0, size - 1)
            for place, size in zip(at, blocks.shape, strict=True)
        ]
        low = [min(int(place), size - 1) for place, size in zip(places, blocks.shape, strict=True)]
        high = [min(each + 1, size - 1) for each, size in zip(low, blocks.shape, strict=True)]
        (down, right) = (place - each for place, each in zip(places, low, strict=True))
        top = (1 - right) * blocks[low[0], low[1]] + right * blocks[low[0], high[1]]
        bottom = (1 - right) * blocks[high[0], low[1]] + right * blocks[high[0], high[1]]
        found[at] = (1 - down) * top + down * bottom
    return found


def by_loops(previous, color, exposure, worth, samples, power, limit):
    """The share in float64: differences, noise of windows and of the frame, by the docstring."""
    previous, color = previous.astype(np.float64), color.astype(np.float64)
    height, width = color.shape[:2]
    last, own = previous[..., :3] * exposure, color * exposure
    apart = np.abs(np.log((last + DARK) / (own + DARK))).mean(-1)
    told = (apart > LEAST_APART) & (previous[..., 3] > 0)
    logarithm = told * np.log(np.maximum(apart, LEAST_APART))
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    sums = np.zeros((2, rows + 2, columns + 2))  # a block more on each side
    for y, x in np.ndindex(height, width):
        sums[:, y // BLOCK + 1, x // BLOCK + 1] += (told[y, x], logarithm[y, x])
    sums /= BLOCK**2
    counted, total = sums.sum((1, 2))
    usual = total / counted if counted else np.log(LEAST_APART)
    noise = np.empty((rows, columns))
    for y, x in np.ndindex(rows, columns):
        inside, said = (plane[y : y + 3, x : x + 3].mean() for plane in sums)
        local = (said + LITTLE_TOLD * usual) / (inside + LITTLE_TOLD)
        noise[y, x] = np.exp(max(local, usual))
    reach = by_blocks(noise + TAIL * noise**2, (height, width))
    found = 1 - np.minimum(worth, 1) * (1 - 1 / (1 + np.maximum(apart / reach - limit, 0) ** 2))
    if samples is None:
        quiet = by_blocks(np.minimum(noise / USUAL_NOISE, 1), (height, width))
        return found * quiet if power else found
    return found * np.maximum(samples / 2, 1) ** -power


@pytest.mark.parametrize("samples", [None, 0.25, 1, 2, 16, "by pixel"])
@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 40), (16, 16), (37, 53), (100, 33)])
def test_the_share_equals_the_loop_oracle(rng, height, width, samples):
    previous, color = noisy(rng, (height, width), 0.2)
    previous[..., 3] *= rng.random((height, width)) < 0.9
    color[rng.random((height, width)) < 0.05] *= 30
    color[rng.random((height, width)) < 0.05] = 0
    each = samples
    if samples == "by pixel":
        samples = rng.choice(np.float32([0, 0.5, 4, 100]), (height, width))
        samples[0, 0] = 4
        each = np.where(samples > 0, samples, samples[samples > 0].mean())  # filled in: as the mean
    worth = rng.uniform(0.1, 1.5, (height, width)).astype(np.float32)
    for power in (0.0, 0.5):
        expected = by_loops(previous, color, 0.7, worth, each, power, 2.5)
        got = share(previous, color, 0.7, worth=worth, samples=samples, power=power)
        np.testing.assert_allclose(got, expected, rtol=2e-4, atol=1e-6)


def test_threads_and_strips_change_no_bit(rng):
    previous, color = noisy(rng, (133, 90), 0.3)
    expected = share(previous, color)
    for strips in (Strips(3), Strips(1, pixels=90 * 16), Strips(2, pixels=90 * 40)):
        np.testing.assert_array_equal(share(previous, color, strips=strips), expected)


def test_where_there_is_little_noise_a_pixel_of_another_light_is_the_frames_own(rng):
    for noise, most in ((0.02, 0.01), (0.1, 0.2)):
        previous, color = noisy(rng, (64, 64), noise)
        color[30:33, 40] *= 6  # a petal, three pixels high
        got = share(previous, color, samples=1)
        assert got[30:33, 40].max() < most
        assert np.median(got) == 1
        assert got.mean() > 0.97


def test_a_pixel_of_another_color_is_the_frames_own(rng):
    previous, color = noisy(rng, (64, 64), 0.02)
    own = previous[30:33, 40, :3] @ [0.2126, 0.7152, 0.0722]
    color[30:33, 40] = own[:, None] * np.float32([2.5, 0.6, 0.2])  # of nearly the same luminance
    assert share(previous, color, samples=1)[30:33, 40].max() < 0.05


def test_a_firefly_is_no_news(rng):
    previous, color = noisy(rng, (64, 64), 0.05)
    color[30, 40] = 1e4
    worth = np.ones((64, 64), np.float32)
    worth[30, 40] = 0.01
    assert share(previous, color, samples=1)[30, 40] < 0.01
    assert share(previous, color, worth=worth, samples=1)[30, 40] > 0.98


def test_where_samples_are_few_one_bright_sample_is_no_news(rng):
    previous, color = noisy(rng, (64, 64), 1.0)
    color[30:33, 40] = 6 * previous[30:33, 40, :3]
    assert share(previous, color, samples=1)[30:33, 40].min() == 1


def test_a_dark_corner_is_as_noisy_as_it_is(rng):
    previous, color = noisy(rng, (96, 160), 0.03)
    corner = np.s_[:64, :64]
    previous[corner], color[corner] = noisy(rng, (64, 64), 0.6)
    got = share(previous, color, samples=1)
    assert got[:40, :40].mean() > 0.9
    assert got[70:, 90:].mean() > 0.97


def test_sky_says_nothing_about_noise(rng):
    previous, color = noisy(rng, (64, 160), 0.5)
    small = share(previous[:, :48], color[:, :48], samples=1)
    previous[:, 48:, :3] = color[:, 48:] = 3
    got = share(previous, color, samples=1)
    np.testing.assert_allclose(got[:, :30], small[:, :30], atol=0.15)
    assert got[:, :40].mean() > 0.97


def test_who_does_not_tell_samples_is_taken_at_his_noise(rng):
    shares = []
    for noise in (1.5, 0.2, 0.02):
        previous, color = noisy(rng, (64, 64), noise)
        shares.append(float(np.median(share(previous, color))))
    assert shares[0] == 1
    assert 0.2 < shares[1] < 0.6
    assert shares[2] < 0.1


@pytest.mark.parametrize("color", [0, 1e-30, 1e30, 3e38])
@pytest.mark.parametrize("last", [0, 1e-30, 1e30, 3e38])
@pytest.mark.parametrize("exposure", [1e-20, 1.0, 1e20])
def test_any_light_gives_a_share(color, last, exposure):
    previous = np.full((20, 20, 4), last, np.float32)
    previous[..., 3] = 1
    got = share(previous, np.full((20, 20, 3), color, np.float32), exposure)
    assert np.isfinite(got).all()
    assert (got >= 0).all()
    assert (got <= 1).all()


@pytest.mark.parametrize(("height", "width"), [(1, 1), (5, 40), (37, 53)])
def test_what_is_believed_equals_the_loop_oracle(rng, height, width):
    mean = rng.uniform(0, 9, (height, width, 4)).astype(np.float32)
    mean[..., 3] += 0.1
    mean[0, 0, :3] = 1e30  # a firefly in a past that is dark elsewhere
    sample = rng.uniform(0.05, 2, (4, height, width)).astype(np.float32)
    agreed = rng.random((height, width), np.float32)
    agreed[0, 0] = 0
    agreed[-1, -1] = 1 if height > 1 else 0
    expected = np.empty((height, width, 4))
    for y, x in np.ndindex(height, width):
        share, held, own = (float(each) for each in (agreed[y, x], mean[y, x, 3], sample[3, y, x]))
        total = share * held + (1 - share) * own
        for channel in range(3):
            light, new = float(mean[y, x, channel]), float(sample[channel, y, x])
            expected[y, x, channel] = (share * held * light + (1 - share) * own * new) / total
        expected[y, x, 3] = total
    for strips in (Strips(1), Strips(2), Strips(1, pixels=2 * width)):
        got = believed(mean, sample, agreed, strips, np.empty_like(mean))
        np.testing.assert_allclose(got, expected, rtol=2e-6)
    # nothing is lost where all agrees, and the frame's sample alone is left where nothing does
    whole = believed(mean, sample, np.ones_like(agreed), Strips(1), np.empty_like(mean))
    np.testing.assert_allclose(whole, mean, rtol=2e-7)
    alone = believed(mean, sample, np.zeros_like(agreed), Strips(1), np.empty_like(mean))
    np.testing.assert_allclose(alone, sample.transpose(1, 2, 0), rtol=2e-7)


def test_a_frame_recalls_less_of_a_last_output_that_had_its_petals_elsewhere():
    """Small bright things that move otherwise than their motion says, in frames of little noise."""
    rng, spec, context = np.random.default_rng(3), load("kpyr-5s"), Context(strips=Strips(1))

    def frame(step):
        color = np.full((96, 128, 3), 0.4, np.float32)
        color[20:80:12, 10 + 3 * step : 110 + 3 * step : 12] = 4
        color *= np.exp(0.03 * rng.normal(size=color.shape)).astype(np.float32)
        still = np.zeros((96, 128, 2), np.float32)
        return dataclasses.replace(make_frame(96, 128), color=color, motion=still)

    with stillray.Denoiser("kpyr-5s", threads=1) as denoiser:
        for step in range(2):
            denoiser.denoise(frame(step))
        last = frame(2)
        plan = kernels_of(spec).plan(last, denoiser.state, Request(), context)
        prepared, _ = kernels_of(spec).prepare(plan, context)
    petals = last.color[..., 0] > 2
    assert prepared.recalled[petals].max() < 0.5 * np.median(prepared.recalled[~petals])
    # nor are they filtered as what was accumulated, which is remembered as it was
    held, left = prepared.history.mean[petals], prepared.mean[petals]
    own = prepared.sample[:3, petals].T
    off = [np.median(np.abs(light[:, :3] / own - 1)) for light in (left, held)]
    assert off[0] < 0.5 * off[1]
    assert (left[:, 3] < 0.8 * held[:, 3]).all()
    usual = [np.median(mean[~petals], 0) for mean in (prepared.mean, prepared.history.mean)]
    np.testing.assert_allclose(*usual, rtol=0.02)
