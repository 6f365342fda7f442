"""Files as renderers really write them are denoised without flags."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from stillray.cli import main
from stillray.io.exr.container import read_container
from stillray.io.exr.read import read_exr, read_picture

BLENDER = Path(__file__).parents[1] / "data/blender"


def roughness(image):
    """Mean difference of neighbours, of tone-mapped radiance: noise raises it."""
    toned = image / (1 + image)
    return np.abs(np.diff(toned, axis=0)).mean() + np.abs(np.diff(toned, axis=1)).mean()


def off(image, reference):
    """Mean difference of tone-mapped radiance."""
    return np.abs(image / (1 + image) - reference / (1 + reference)).mean()


def test_blender_5_is_denoised_with_all_its_buffers_and_no_flags(tmp_path, monkeypatch):
    shutil.copytree(BLENDER, tmp_path / "shot")
    monkeypatch.chdir(tmp_path)
    assert main(["denoise", "shot/frame_####.exr", "-o", "c.####.exr", "-m", "fast"]) == 0
    for number in (1, 2):
        noisy = read_exr(f"shot/frame_{number:04d}.exr")
        buffers = {"color", "albedo", "normal", "depth", "motion"}
        assert noisy.given == buffers | {"samples", "filter_spread"}
        clean = read_picture(f"c.{number:04d}.exr")
        assert clean.shape == noisy.color.shape
        # the part of it that its texture, which stays, does not explain
        assert roughness(clean) < 0.9 * roughness(noisy.color)
        assert abs(clean.mean() / noisy.color.mean() - 1) < 0.1
        parts = read_container(Path(f"c.{number:04d}.exr")).parts
        assert parts[0].text("Software") == "Blender 5.0.1"


@pytest.fixture(scope="module")
def mitsuba_files(tmp_path_factory):
    """The same view of 2 samples a pixel, and of 256."""
    mitsuba = pytest.importorskip("mitsuba")
    mitsuba.set_variant("scalar_rgb")
    scene = mitsuba.cornell_box()
    scene["sensor"]["film"] |= {"width": 45, "height": 33}
    scene["integrator"] = {
        "type": "aov",
        "aovs": "albedo:albedo,nn:sh_normal,dd.y:depth,pos:position",
        "img": {"type": "path", "max_depth": 4},
    }
    folder = tmp_path_factory.mktemp("mitsuba")
    loaded = mitsuba.load_dict(scene)
    paths = []
    for seed, spp in enumerate((2, 256), 1):
        mitsuba.render(loaded, spp=spp, seed=seed)
        paths.append(folder / f"{spp}.exr")
        loaded.sensors()[0].film().write(str(paths[-1]))
    return paths


@pytest.mark.parametrize(
    "model",
    [
        "high",
        pytest.param(
            "fast",
            marks=pytest.mark.xfail(
                strict=True, reason="0.81 since it learned fur, which such noise looks like"
            ),
        ),
    ],
)
def test_noise_that_a_film_spread_over_pixels_is_less(tmp_path, mitsuba_files, model):
    """The picture's own edges are at 0.72 of the noisy frame's roughness."""
    out = tmp_path / "c.exr"
    assert main(["denoise", str(mitsuba_files[0]), "-o", str(out), "-m", model]) == 0
    assert roughness(read_picture(out)) < 0.8 * roughness(read_exr(mitsuba_files[0]).color)


def test_mitsuba_is_denoised_with_all_its_buffers_and_no_flags(tmp_path, mitsuba_files):
    noisy, converged = (read_exr(path) for path in mitsuba_files)
    assert noisy.given == {"color", "albedo", "normal", "depth"}
    lengths = np.linalg.norm(noisy.normal, axis=-1)
    assert lengths.max() < 1.01  # normals, not positions, which lie further out
    hit = noisy.depth > noisy.depth.max() / 2  # beside the box nothing is
    assert (lengths[hit] > 0.5).mean() > 0.8  # the pixel filter mixes them at edges
    assert (
        main(["denoise", str(mitsuba_files[0]), "-o", str(tmp_path / "c.exr"), "-m", "fast"]) == 0
    )
    clean = read_picture(tmp_path / "c.exr")
    assert off(clean, converged.color) < 0.85 * off(noisy.color, converged.color)
    lamp = converged.color.max(axis=2) > 3  # four by three pixels, no firefly
    assert clean[lamp].mean() > 0.7 * converged.color[lamp].mean()
    np.testing.assert_array_equal(read_exr(tmp_path / "c.exr").depth, noisy.depth)
