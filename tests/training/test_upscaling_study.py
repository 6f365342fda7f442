"""The study of branches and partial convolutions: its networks, and the way from data to page."""

from __future__ import annotations

import dataclasses

import pytest

torch = pytest.importorskip("torch")

from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.multi_branch import multi_branch_net  # noqa: E402
from stillray_training.networks.repvgg import by_branches  # noqa: E402
from stillray_training.networks.single_branch import single_branch_net  # noqa: E402
from stillray_training.upscaling import study  # noqa: E402
from tests.training.test_upscaling import render  # noqa: E402


def test_one_branch_has_the_weights_of_two_and_gives_the_same_planes():
    spec = load(study.BASE)
    one, two = single_branch_net(spec, study.SINGLE_WIDTHS), multi_branch_net(spec)
    weights = [sum(part.numel() for part in fuse(net).parameters()) for net in (one, two)]
    assert weights[0] == pytest.approx(weights[1], rel=0.01)
    planes = torch.randn(1, len(spec.network.features), 16, 24)
    assert [m.shape for m in one(planes)] == [m.shape for m in two(planes)]
    with by_branches(one):
        for fused, plain in zip(fuse(one)(planes), one(planes), strict=True):
            torch.testing.assert_close(fused, plain, atol=1e-4, rtol=1e-4)


def test_from_data_to_the_page(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "SHORT", {"batch": 1, "patch": 16, "frames": 2, "warm_frames": 0})
    monkeypatch.setattr(study, "PICTURE", (16, 16))
    # six networks are exported; of two levels, the coarser still has half of its channels left out
    base = load(study.BASE)
    network = dataclasses.replace(base.network, radiance_widths=(8, 12), guide_widths=(4, 6))
    decoder = dataclasses.replace(base.decoder, features=2, coarsest_filters=(2, 1))
    less = dataclasses.replace(base, network=network, decoder=decoder)
    monkeypatch.setattr(study, "load", {study.BASE: less}.get)
    monkeypatch.setattr(study, "SINGLE_WIDTHS", (9, 14))
    render(tmp_path / "data" / "plane-0-0")
    render(tmp_path / "validation" / "plane-1-0")
    given = {"out": tmp_path / "out", "seeds": 2, "steps": 1, "threads": 1}
    with pytest.raises(InputError, match="must hold scores"):
        study.main(**given, report=tmp_path / "page.md")
    report = tmp_path / "page.md"
    study.main(**given, data=[tmp_path / "data"], validation=tmp_path / "validation", report=report)
    rows = [line for line in report.read_text().splitlines() if line.startswith("| ")][1:]
    assert [row.split(" | ")[0].strip("| ") for row in rows] == [
        "two branches, half of the channels", "two branches, all channels", "one branch"
    ]  # fmt: skip
    assert all("±" in row for row in rows)
    # what is finished is not trained again
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.safetensors")}
    assert len(before) == 6
    study.main(**given, data=[tmp_path / "data"])
    assert before == {path: path.stat().st_mtime_ns for path in before}
