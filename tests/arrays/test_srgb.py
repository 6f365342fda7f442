from __future__ import annotations

import numpy as np
from skimage import color

from stillray.arrays import srgb


def test_curve_is_the_standards_and_its_inverse():
    # every 8-bit value, the ends, and both sides of where the curve begins
    shown = np.concatenate([np.arange(256) / 255, [0.04044, 0.04046]]).astype(np.float32)
    light = srgb.decode(shown)
    assert light.dtype == np.float32
    # IEC 61966-2-1 as scikit-image has it, by way of the luminance of grey
    grey = np.repeat(shown[:, None], 3, axis=1).astype(np.float64)
    np.testing.assert_allclose(light, color.rgb2xyz(grey)[:, 1], rtol=2e-5, atol=1e-7)
    np.testing.assert_allclose(srgb.encode(light), shown, atol=1e-6)
    assert srgb.encode(np.float32([0, 1])).tolist() == [0, 1]
    assert srgb.decode(np.float32([0, 1])).tolist() == [0, 1]
