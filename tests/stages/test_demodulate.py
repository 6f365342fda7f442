from __future__ import annotations

import numpy as np

from stillray.stages.demodulate import demodulation_albedo


def test_divisor_has_a_floor_and_is_one_where_albedo_is_black(spec):
    albedo = np.float32([[[0, 0, 0], [0.0005, 0, 0], [0.9, 0.01, 0.4], [1, 1, 1]]])
    floor = np.float32(spec.demodulate.floor)
    expected = np.float32([[[1, 1, 1], [1, 1, 1], [0.9, floor, 0.4], [1, 1, 1]]])
    np.testing.assert_array_equal(demodulation_albedo(albedo, spec.demodulate), expected)


def test_modulation_gives_the_radiance_back(spec, rng):
    albedo = (rng.random((20, 30, 3)) * (rng.random((20, 30, 1)) > 0.3)).astype(np.float32)
    radiance = rng.lognormal(0, 3, (20, 30, 3)).astype(np.float32)
    by = demodulation_albedo(albedo, spec.demodulate)
    np.testing.assert_allclose(radiance / by * by, radiance, rtol=3e-7)
