"""Export of models that denoise and upscale: all forms of them agree, or nothing is written."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

import stillray  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.io.exr.new_file import write_channels  # noqa: E402
from stillray.io.exr.read import read_exr  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_export import feature_filters, to_onnx  # noqa: E402
from stillray_export.parity import ParityError  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.multi_branch import multi_branch_net  # noqa: E402
from stillray_training.simulate.sequence import RECORD, write  # noqa: E402
from stillray_training.upscaling import compare  # noqa: E402


@pytest.fixture(scope="module")
def spec():
    """The model with one level and few features: graphs are exported one operator at a time."""
    spec = load("munet-x2")
    network = replace(
        spec.network,
        radiance=("color.r", "past.r", "offset.x"),
        guides=("albedo.r", "depth"),
        radiance_widths=(4,),
        guide_widths=(4,),
    )
    return replace(spec, network=network, decoder=replace(spec.decoder, features=1))


@pytest.fixture(scope="module")
def exported(spec, tmp_path_factory):
    torch.manual_seed(0)
    network = multi_branch_net(spec)
    folder = tmp_path_factory.mktemp("models")
    return network, to_onnx.export(network, spec, {}, folder)


def test_the_file_runs_in_the_runtime(rng, exported):
    _, path = exported
    assert path.with_name("munet-x2.whole.onnx").is_file()
    motion = np.zeros((5, 7, 2), np.float32)
    with stillray.Denoiser(path, threads=1) as denoiser:
        for _ in range(2):
            color = rng.lognormal(size=(5, 7, 3)).astype(np.float32)
            image = denoiser.denoise(stillray.Frame(color=color, motion=motion))
            assert image.shape == (10, 14, 3)
            assert np.isfinite(image).all()


def test_it_is_compared_with_enlarged_pictures_and_with_all_pixels_traced(exported, tmp_path):
    pytest.importorskip("pyoidn", reason="a peer, of the extra compare")
    rng = np.random.default_rng(3)
    half, full = tmp_path / "half" / "room-0", tmp_path / "full" / "room"
    half.mkdir(parents=True)
    full.mkdir(parents=True)
    (half / RECORD).write_text(json.dumps({"scene": "room"}))
    for number in range(2):
        wanted = np.tile(rng.random((1, 32, 3), np.float32), (24, 1, 1))
        write(half / f"ref_{number:04d}.exr", {"color": wanted})
        for folder, color in ((half, wanted[::2, ::2]), (full, wanted)):
            buffers = {"color": color, "albedo": color, "normal": np.ones_like(color)}
            write(folder / f"frame_{number:04d}.exr", buffers)
    path = str(exported[1])
    found = compare.measure(half, path, "kpyr-5s", full.parent)
    assert list(found) == [
        "munet-x2", "kpyr-5s + Lanczos", "oidn-high + Lanczos",
        "kpyr-5s, all pixels traced", "oidn-high, all pixels traced",
    ]  # fmt: skip
    # frames without noise: of all pixels every stripe is there, of a quarter half of them are
    assert found["oidn-high, all pixels traced"]["psnr"] > found["oidn-high + Lanczos"]["psnr"] + 10
    with pytest.raises(InputError, match="full must hold room-0's scene of"):
        compare.measure(half, path, "kpyr-5s", tmp_path)


class Notes:
    """Hears what a user is told."""

    def __init__(self):
        self.lines = []

    def note(self, line):
        self.lines.append(line)

    def motion(self, detection): ...

    def wait(self, reason): ...

    def frame(self, done): ...


def test_files_have_twice_the_size_and_a_user_is_told(rng, exported, tmp_path):
    _, path = exported
    planes = {name: rng.random((5, 7)).astype(np.float32) for name in ("R", "G", "B", "albedo.R")}
    for number in (1, 2):
        write_channels(tmp_path / f"in.000{number}.exr", planes)
    notes = Notes()
    sources, output = str(tmp_path / "in.####.exr"), str(tmp_path / "out.####.exr")
    stillray.denoise_shot(sources, output, model=str(path), progress=notes)
    assert [read_exr(tmp_path / f"out.000{n}.exr").shape for n in (1, 2)] == [(10, 14)] * 2
    assert any("pictures are 2 times as wide and high" in line for line in notes.lines)


def test_another_network_than_the_file_s_is_noticed(spec, exported):
    network, path = exported
    graphs = [path.read_bytes(), path.with_name("munet-x2.whole.onnx").read_bytes()]
    worst = feature_filters.check(network, fuse(network), *graphs, spec)
    assert {"branches logits", "onnx logits", "runtime decoder", "whole graph"} <= set(worst)
    other = fuse(network)
    with torch.no_grad():
        other.heads[0].bias += 1e-2
    with pytest.raises(ParityError, match="fused logits must agree with float64"):
        feature_filters.check(network, other, *graphs, spec)
