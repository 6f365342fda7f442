"""Cross-regression against loops in float64, and what a user would miss."""

import numpy as np
import pytest

from stillray.arrays.strips import Strips
from stillray.families.cross_regression import Guides, deviation, pilots

REACH, RIDGE, NOISE = 8, 1e-3, 0.01

UNITS = np.array([0.5, 0.5, 0.5, 2, 2, 2], np.float32)


def oracle_deviation(image):
    _, height, width = image.shape
    padded = np.pad(image.astype(np.float64), [(0, 0), (1, 1), (1, 1)], mode="edge")
    found = np.empty((height, width))
    for y in range(height):
        for x in range(width):
            window = padded[:, y : y + 3, x : x + 3]
            around = (window.sum((1, 2)) - window[:, 1, 1]) / 8
            found[y, x] = np.sqrt(((window[:, 1, 1] - around) ** 2).sum())
    return found


def oracle(explains, explained, guides, explaining):
    """Equations 3 to 7, pixel by pixel; centers beyond the frame are as the pixel at its edge."""
    explains, explained, guides = (a.astype(np.float64) for a in (explains, explained, guides))
    noise = oracle_deviation(explains)
    _, height, width = explains.shape
    sums, weights = np.zeros((3, height, width)), np.zeros((height, width))
    for center_y in range(0, height + 6, 6):
        for center_x in range(0, width + 6, 6):
            cy, cx = min(center_y, height - 1), min(center_x, width - 1)
            rows, places, w, y = [], [], [], []
            for py in range(max(center_y - 6, 0), min(center_y + 6, height)):
                for px in range(max(center_x - 6, 0), min(center_x + 6, width)):
                    apart = explains[:, py, px] - explains[:, cy, cx]
                    other = guides[:, py, px] - guides[:, cy, cx]
                    sigmas = noise[py, px], noise[cy, cx]
                    color = apart / (sum(sigmas) + NOISE)
                    rows.append([1, *color, *other[len(other) - explaining :]])
                    variance = sigmas[0] ** 2 + sigmas[1] ** 2 + NOISE**2
                    w.append(np.exp(-(apart**2).sum() / variance - (other**2).sum()))
                    y.append(explained[:, py, px])
                    places.append((py, px))
            if not places:  # beyond the frame's last tiles
                continue
            x, w, y = np.array(rows), np.array(w), np.array(y)
            normal = x.T @ (w[:, None] * x) + 1e-6 * np.eye(x.shape[1])
            normal[1:, 1:] += RIDGE * w.sum() * np.eye(x.shape[1] - 1)
            lines = np.linalg.solve(normal, x.T @ (w[:, None] * y))
            for (py, px), row, weight in zip(places, x, w, strict=True):
                sums[:, py, px] += weight * (row @ lines)
                weights[py, px] += weight
    found = (sums + 0.1 * explains) / (weights + 0.1)
    for py in range(height):
        for px in range(width):
            window = explained[
                :, max(py - REACH, 0) : py + REACH + 1, max(px - REACH, 0) : px + REACH + 1
            ]
            found[:, py, px] = np.clip(found[:, py, px], window.min((1, 2)), window.max((1, 2)))
    return found


def halves(rng, height, width):
    edge = np.where(np.arange(width) < width // 2, 0.3, 1.5)
    made = []
    for _ in range(2):
        noisy = edge * rng.exponential(1, (3, height, width))
        made.append(np.log1p(noisy).astype(np.float32))
    guides = rng.random((6, height, width)).astype(np.float32)
    return made, guides


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (12, 6), (19, 26)])
@pytest.mark.parametrize("explaining", [0, 3, 6])
def test_pilots_are_those_of_loops(rng, shape, explaining):
    (first, second), guides = halves(rng, *shape)
    found = pilots((first, second), Guides(guides, UNITS, explaining), Strips(1))
    for pilot, (own, other) in zip(found, [(first, second), (second, first)], strict=True):
        np.testing.assert_allclose(
            pilot, oracle(own, other, guides / UNITS[:, None, None], explaining), atol=2e-4
        )


def test_wide_frames_are_those_that_narrow_ones_are(rng):
    """Centers in a row are taken in parts of some hundred."""
    (first, second), guides = halves(rng, 9, 1900)
    wide = pilots((first, second), Guides(guides, UNITS, 3), Strips(1)).copy()
    left, right = slice(1146, 1164), slice(1128, 1182)  # of whole tiles
    part = [np.ascontiguousarray(planes[..., right]) for planes in (first, second, guides)]
    narrow = pilots((part[0], part[1]), Guides(part[2], UNITS, 3), Strips(1))
    np.testing.assert_allclose(wide[..., left], narrow[..., 18:36], atol=1e-6)


def test_deviation_is_that_of_loops(rng):
    image = rng.random((3, 4, 7)).astype(np.float32)
    np.testing.assert_allclose(deviation(image), oracle_deviation(image), atol=1e-6)


def test_pilots_do_not_depend_on_strips_or_threads(rng):
    (first, second), guides = halves(rng, 70, 300)
    whole = pilots((first, second), Guides(guides, UNITS, 3), Strips(1))
    cut = pilots((first, second), Guides(guides, UNITS, 3), Strips(2, pixels=2000))
    for a, b in zip(whole, cut, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_pilot_has_less_noise_than_its_half_and_keeps_an_edge_that_no_guide_shows(rng):
    height, width = 40, 64
    edge = np.where(np.arange(width) < width // 2, 0.2, 2.0) * np.ones((3, height, 1))
    first, second = ((edge + rng.normal(0, 0.1, edge.shape)).astype(np.float32) for _ in range(2))
    guides = np.zeros((6, height, width), np.float32)
    pilot, _ = pilots((first, second), Guides(guides, UNITS, 3), Strips(1))
    assert np.abs(pilot - edge).mean() < np.abs(first - edge).mean() / 2
    beside = pilot[:, :, width // 2].mean() - pilot[:, :, width // 2 - 1].mean()
    assert beside > 0.9 * 1.8


@pytest.mark.parametrize("guides", [0, 6])
def test_singular_windows_give_the_mean(guides):
    """All variables but 1 are 0 everywhere: of black frames, and of flat ones."""
    for level in (0.0, 1.0):
        flat = np.full((3, 9, 9), level, np.float32)
        for pilot in pilots(
            (flat, flat),
            Guides(np.zeros((guides, 9, 9), np.float32), UNITS[:guides], guides // 2),
            Strips(1),
        ):
            np.testing.assert_allclose(pilot, level, rtol=1e-5)


def test_a_firefly_explains_no_light_that_was_not_seen(rng):
    (first, second), guides = halves(rng, 20, 20)
    first[:, 10, 10] = 50
    found = pilots((first, second), Guides(guides, UNITS, 3), Strips(1))[0]
    assert found.max() <= second.max()
