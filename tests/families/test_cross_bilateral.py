"""The spatiotemporal filter against loops in float64, and against torch's twin."""

import dataclasses

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.cross_bilateral import Estimates, cross_bilateral, taps


def make(rng, height, width):
    estimates = Estimates(
        values=rng.random((2, 3, height, width)).astype(np.float32),
        guides=rng.random((2, 3, height, width)).astype(np.float32),
        past=rng.random((3, height, width)).astype(np.float32),
        valid=(rng.random((height, width)) < 0.7).astype(np.float32),
        edges=rng.random((height, width)) < 0.4,
    )
    parameters = rng.normal(0, 1, (6, height + 2, width + 3)).astype(np.float32)
    return estimates, parameters


def oracle(estimates, parameters, thinned):
    """Equations 8 to 10 as they stand, in float64."""
    values = estimates.values.astype(np.float64)
    guides = np.concatenate([values, estimates.guides.astype(np.float64)])
    past, valid = estimates.past.astype(np.float64), estimates.valid
    height, width = valid.shape
    found = np.empty((3, height, width))
    for y in range(height):
        for x in range(width):
            theta = parameters[:, y, x].astype(np.float64)
            bands = theta[:5] ** 2 + 1e-4
            sums, weights = np.zeros((2, 3)), np.zeros(2)
            for dy in range(-5, 6):
                for dx in range(-5, 6):
                    py, px = y + dy, x + dx
                    if not (0 <= py < height and 0 <= px < width):
                        continue
                    near = abs(dy) == abs(dx) == 1
                    if thinned and (dy % 2 or dx % 2) and not near:
                        continue
                    if thinned and abs(dy) == abs(dx) == 4:
                        continue
                    apart = ((guides[:, :, py, px] - guides[:, :, y, x]) ** 2).sum(1)
                    shared = apart[2] / bands[2] + apart[3] / bands[3]
                    shared += (dy * dy + dx * dx) / 25 / bands[4]
                    for half in range(2):
                        weight = np.exp(-apart[half] / bands[half] - shared)
                        weights[half] += weight
                        sums[half] += weight * values[half, :, py, px]
            alpha = 1 / (1 + np.exp(-theta[5]))
            alpha = min(alpha, 0.25) if estimates.edges[y, x] else alpha
            alpha = alpha if valid[y, x] else 1
            halves = alpha * sums / weights[:, None] + (1 - alpha) * past[:, y, x]
            found[:, y, x] = weights @ halves / weights.sum()
    return found


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (14, 17)])
@pytest.mark.parametrize("thinned", [False, True])
def test_filter_is_that_of_loops(rng, shape, thinned):
    estimates, parameters = make(rng, *shape)
    found = cross_bilateral(estimates, parameters, Strips(1), thinned=thinned)
    np.testing.assert_allclose(found, oracle(estimates, parameters, thinned), atol=1e-5)


def test_filter_does_not_depend_on_strips(rng):
    estimates, parameters = make(rng, 40, 60)
    whole = cross_bilateral(estimates, parameters, Strips(1), thinned=False)
    cut = cross_bilateral(estimates, parameters, Strips(2, pixels=100), thinned=False)
    np.testing.assert_array_equal(whole, cut)


def test_narrow_bands_leave_pixels_as_they_are(rng):
    estimates, parameters = make(rng, 9, 9)
    parameters[:] = 0
    parameters[5] = 100  # of this frame alone
    estimates = dataclasses.replace(estimates, edges=None)
    found = cross_bilateral(estimates, parameters, Strips(1), thinned=False)
    np.testing.assert_allclose(found, estimates.values.mean(0), atol=1e-6)


def test_a_thinned_window_has_a_fifth_of_its_pixels_on_all_sides_alike():
    assert len(taps(False)) == 121
    assert len(taps(True)) == 25
    assert set(taps(True)) < set(taps(False))
    assert (0, 0) in taps(True)
    for turned in ([(x, y) for y, x in taps(True)], [(-y, x) for y, x in taps(True)]):
        assert set(turned) == set(taps(True))


def test_bright_borders_do_not_shine_around_the_frame(rng):
    """Columns around the frame are computed along: nothing of them may reach it."""
    estimates, parameters = make(rng, 6, 20)
    estimates.values[..., 0] = estimates.values[..., -1] = 1e4
    for thinned in (False, True):
        found = cross_bilateral(estimates, parameters, Strips(1), thinned=thinned)
        expected = oracle(estimates, parameters, thinned)
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-5)


def test_torch_filters_as_the_runtime_does(rng):
    torch = pytest.importorskip("torch")
    from stillray_training.decoders import cross_bilateral as of_torch

    estimates, parameters = make(rng, 12, 16)
    parameters = parameters[:, :12, :16]
    pilots, guides = (
        torch.from_numpy(part.reshape(6, 12, 16)) for part in (estimates.values, estimates.guides)
    )
    for thinned in (False, True):
        halves, weights = of_torch.cross_bilateral(
            pilots, guides, torch.ones(1, 12, 16),
            torch.from_numpy(parameters), thinned=thinned,
        )  # fmt: skip
        combined = (halves * weights[:, None]).sum(0) / weights.sum(0)
        now = Estimates(
            values=estimates.values, guides=estimates.guides, past=estimates.past,
            valid=np.zeros((12, 16), np.float32),
        )  # fmt: skip
        found = cross_bilateral(now, parameters, Strips(1), thinned=thinned)
        np.testing.assert_allclose(found, combined.numpy(), atol=1e-5)
