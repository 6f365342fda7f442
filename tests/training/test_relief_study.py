"""What relief is worth, on frames that have some."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("skimage")
pytest.importorskip("torch", reason="training is of the extra train")

from stillray.errors import InputError
from stillray_training import relief_study
from stillray_training.simulate.sequence import RECORD, write


@pytest.fixture
def bumps(tmp_path, rng):
    """A folder of one sequence, of a wall with bumps: its last frame has a block of 4 samples."""
    folder = tmp_path / "data" / "wall"
    folder.mkdir(parents=True)
    columns = np.mgrid[:64, :96][1].astype(np.float32)
    normal = np.zeros((64, 96, 3), np.float32)
    normal[..., 0], normal[..., 2] = 0.4 * np.sin(columns), 1
    light = 1 + 0.8 * normal[..., :1] + np.zeros((64, 96, 3), np.float32)
    for name in ("frame_0000", "block_00", "ref_0000"):
        grain = 1 if name == "ref_0000" else rng.lognormal(-0.3, 0.8, (64, 96, 1))
        layers = {"color": light * grain, "albedo": np.full_like(normal, 0.5), "normal": normal}
        write(folder / f"{name}.exr", {**layers, "depth": np.full((64, 96), 2, np.float32)})
    (folder / RECORD).write_text(json.dumps({"options": {"spp": 1, "blocks": [4]}}))
    return folder.parent


def test_bumps_that_noise_hid_are_gained_by_the_count_of_samples(bumps, capsys):
    ((count, (gained,)),) = relief_study.gains("kpyr-5s", [bumps / "wall"]).items()
    assert count == 4
    assert gained["psnr"] > 0.5
    assert gained["ssim"] > 0
    relief_study.main([bumps], model="kpyr-5s", most=1)
    shown = capsys.readouterr().out
    assert f"{gained['psnr']:+.3f}" in shown


def test_a_model_without_relief_is_refused(bumps):
    with pytest.raises(InputError, match="model must put relief back, got wskp-3"):
        relief_study.gains("wskp-3", [bumps / "wall"])
