"""Errors are told by where they are."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

pytest.importorskip("torch", reason="training is of the extra train")

from stillray.errors import InputError
from stillray_training.error_places import edges_of, find_errors
from tests.conftest import make_frame


@pytest.fixture
def halves():
    """A frame of two plain surfaces that meet between columns 23 and 24, and its picture."""
    left = np.arange(48) < 24
    normal = np.zeros((40, 48, 3), np.float32)
    normal[:, left, 0], normal[:, ~left, 2] = 1, 1
    color = np.where(left, np.float32(0.2), np.float32(0.6))
    color = np.broadcast_to(color[None, :, None], normal.shape).astype(np.float32)
    frame = make_frame(40, 48)
    flat = {"albedo": np.full_like(normal, 0.5), "depth": np.full((40, 48), 2, np.float32)}
    return dataclasses.replace(frame, normal=normal, **flat), color


def test_an_error_at_an_edge_one_on_plain_ground_and_their_sum(halves):
    frame, reference = halves
    edges = edges_of(frame)
    assert edges[:, 22:26].all()
    assert not edges[:, :18].any()
    assert not edges[:, 30:].any()
    at_edge, beside = reference.copy(), reference.copy()
    at_edge[:, 24] *= 0.5
    beside[:, 5] *= 0.5
    found = find_errors(at_edge, reference, edges)
    assert found.edges > 0
    assert found.rest == found.textures == 0
    found = find_errors(beside, reference, edges)
    assert found.rest > 0
    assert found.edges == found.textures == 0
    both = find_errors(np.minimum(at_edge, beside), reference, edges)
    assert both.total == pytest.approx(find_errors(at_edge, reference, edges).edges + found.rest)


def test_mottling_is_coarse_and_noise_is_fine(halves):
    frame, reference = halves
    edges, rng = edges_of(frame), np.random.default_rng(0)
    noise = 1 + rng.uniform(-0.3, 0.3, reference.shape).astype(np.float32)
    found = find_errors(reference * noise, reference, edges)
    assert found.bands[0] > 10 * max(found.bands[2:])
    found = find_errors(reference * np.float32(1.1), reference, edges)
    assert found.bands[-1] > 10 * max(found.bands[:-1])


@pytest.mark.parametrize(("wavelength", "band"), [(2, 0), (6, 1), (12, 2), (24, 3)])
def test_waves_of_an_error_lie_in_the_band_of_their_size(wavelength, band):
    # plain ground: as displayed an error is a share of it
    reference = np.full((16, 192, 3), 0.3, np.float32)
    wave = np.sin(2 * np.pi * (np.arange(192) + 0.5) / wavelength)
    image = (reference * (1 + 0.02 * wave[None, :, None])).astype(np.float32)
    found = find_errors(image, reference, np.zeros((16, 192), bool))
    assert np.argmax(found.bands) == band


def test_texture_of_the_picture_is_told_from_plain_ground(halves):
    frame, reference = halves
    striped = reference.copy()
    striped[:, 36::2] *= 0.5
    found = find_errors(striped * np.float32(1.1), striped, edges_of(frame))
    assert found.textures > 0
    assert found.rest > 0


def test_frames_without_features_are_refused(halves):
    frame, _ = halves
    with pytest.raises(InputError, match="albedo, normal and depth, lack depth"):
        edges_of(dataclasses.replace(frame, depth=None))
