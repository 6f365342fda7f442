"""The same model with outliers and without, on frames that have one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("skimage")
pytest.importorskip("torch", reason="training is of the extra train")

from stillray_training import outlier_study
from tests.conftest import make_frame


def test_with_and_without_are_the_same_model_on_the_same_frames(monkeypatch, rng, capsys):
    frame = make_frame(24, 32)
    reference = frame.color.copy()
    frame.color[11, 12] = 300.0
    runs = [("stills", False, [frame], reference), ("sequences", True, [frame] * 2, reference)]
    asked = []
    monkeypatch.setattr(
        outlier_study, "runs", lambda folder, samples: asked.append(samples) or iter(runs)
    )
    outlier_study.main(Path(), model="nbg-2x1", deviations=[2.0], samples=16)
    assert asked == [16]
    scores = outlier_study.measure("nbg-2x1", Path(), [2.0], 16)
    for rows in scores.values():
        assert list(rows) == [0.0, 2.0]
        assert rows[2.0]["relmse"] < rows[0.0]["relmse"]
    shown = capsys.readouterr().out
    assert "2 deviations" in shown
    told = float(shown.split("none")[1].split()[0])
    assert np.isclose(scores["stills"][0.0]["psnr"], told, atol=0.01)
