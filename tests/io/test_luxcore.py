"""Files that LuxCore wrote, one a film output: color, albedo, normal and depth."""

from pathlib import Path

import numpy as np

import stillray
from stillray.cli import main

LUXCORE = Path(__file__).parents[1] / "data" / "luxcore"
FILES = {"albedo": "ALBEDO", "normal": "AVG_SHADING_NORMAL", "depth": "DEPTH"}


def test_film_outputs_are_the_buffers_of_a_frame():
    features = {role: LUXCORE / f"{name}.exr" for role, name in FILES.items()}
    frame = stillray.read_exr(LUXCORE / "RGB.exr", companions=features)
    assert frame.given == {"color", "albedo", "normal", "depth"}
    assert frame.shape == (37, 48)
    # the red square hovers above the middle, the floor fills the lowest rows
    np.testing.assert_allclose(frame.albedo[12, 24], [0.8, 0.2, 0.1], rtol=1e-3)
    np.testing.assert_allclose(frame.albedo[-1], [[0.7, 0.6, 0.5]] * 48, rtol=1e-3)
    # the mean over a pixel's samples: a unit vector away from silhouettes
    np.testing.assert_allclose(frame.normal[-6:], np.broadcast_to([0, 0, 1], (6, 48, 3)), atol=1e-3)
    assert frame.depth[-1, 24] < frame.depth[18, 24] < frame.depth[0, 24] == np.inf


def test_the_command_line_denoises_them(tmp_path):
    flags = [
        text for role, name in FILES.items() for text in (f"--{role}", f"{LUXCORE}/{name}.exr")
    ]
    assert main(["denoise", f"{LUXCORE}/RGB.exr", *flags, "-o", f"{tmp_path}/c.exr"]) == 0
    noisy, clean = (stillray.read_exr(p).color for p in (LUXCORE / "RGB.exr", tmp_path / "c.exr"))
    floor = np.s_[-6:, :]  # evenly lit there, but for the noise
    roughness = [np.abs(np.diff(image[floor], axis=1)).mean() for image in (clean, noisy)]
    assert roughness[0] < 0.5 * roughness[1]
    np.testing.assert_allclose(clean[floor].mean(), noisy[floor].mean(), rtol=0.1)
