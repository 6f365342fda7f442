from __future__ import annotations

import numpy as np
import pytest

from stillray.errors import InputError
from stillray_training.noise import measure, measure_folder, table


def test_a_tail_is_the_share_of_the_brightest_thousandth():
    reference = np.ones((50, 40, 3), np.float32)
    noisy = reference.copy()
    noisy[3, 7] = noisy[20, 9] = 500.0  # 2 of 2000 pixels are a thousandth
    noise = measure(noisy, reference)
    assert noise.tail == pytest.approx(1000 / 2998)
    assert noise.reference_tail == pytest.approx(2 / 2000)
    assert noise.capped == pytest.approx((1998 + 2 * 16) / 2998)


def test_a_brighter_scene_has_the_same_noise():
    rng = np.random.default_rng(0)
    reference = rng.uniform(0.5, 1, (40, 50, 3)).astype(np.float32)
    noisy = (reference * rng.exponential(1, reference.shape)).astype(np.float32)
    one, other = measure(noisy, reference), measure(8 * noisy, 8 * reference)
    for name in ("tail", "reference_tail", "capped", "psnr"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=1e-4)


def test_pixels_that_are_not_finite_count_as_black():
    reference = np.ones((20, 20, 3), np.float32)
    noisy = reference.copy()
    noisy[0, 0] = np.nan
    assert np.isfinite(measure(noisy, reference).psnr)


def test_a_folder_without_references_is_refused(tmp_path):
    (tmp_path / "room-0000-0").mkdir()
    with pytest.raises(InputError, match="must hold sequences with references"):
        measure_folder(tmp_path)


def test_the_table_gives_medians_and_percentiles():
    frames = [measure(np.full((20, 50, 3), 1.0), np.full((20, 50, 3), 1.0))] * 3
    assert "| one | 3 | 0.001 (0.001 to 0.001)" in table({"one": frames})
