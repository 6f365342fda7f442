from __future__ import annotations

import dataclasses

import numpy as np

from stillray.stages.demodulate import demodulation_albedo


def test_divisor_has_a_floor_and_is_one_where_albedo_is_black(spec):
    albedo = np.float32([[[0, 0, 0], [0.0005, 0, 0], [0.9, 0.01, 0.4], [1, 1, 1]]])
    floor = np.float32(spec.demodulate.floor)
    expected = np.float32([[[1, 1, 1], [1, 1, 1], [0.9, floor, 0.4], [1, 1, 1]]])
    np.testing.assert_array_equal(demodulation_albedo(albedo, spec.demodulate), expected)


def test_light_that_surfaces_reflect_besides_their_albedo_is_divided_by_both(spec):
    options = dataclasses.replace(spec.demodulate, floor=0.001, specular=0.15)
    # wood with a texture, under even light: a part of it is reflected without its colour
    albedo = np.float32([[[0.5, 0.3, 0.1], [0.25, 0.12, 0.02], [0, 0, 0], [0.0004, 0.2, 0]]])
    by = demodulation_albedo(albedo, options)
    wanted = albedo + np.float32(0.15)
    wanted[0, 2] = np.float32(1.15)
    wanted[0, 3, [0, 2]] = np.float32(0.151)
    np.testing.assert_allclose(by, wanted, rtol=1e-6)
    np.testing.assert_allclose(7 * (albedo[:, :2] + 0.15) / by[:, :2], 7, rtol=1e-6)
    assert albedo[0, 0, 0] == np.float32(0.5)  # what was given is not changed


def test_modulation_gives_the_radiance_back(spec, rng):
    albedo = (rng.random((20, 30, 3)) * (rng.random((20, 30, 1)) > 0.3)).astype(np.float32)
    radiance = rng.lognormal(0, 3, (20, 30, 3)).astype(np.float32)
    by = demodulation_albedo(albedo, spec.demodulate)
    np.testing.assert_allclose(radiance / by * by, radiance, rtol=3e-7)
