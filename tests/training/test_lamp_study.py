"""What is left of a small lamp, with and without the rule."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

pytest.importorskip("torch", reason="training is of the extra train")

from stillray_training import lamp_study


def test_a_filter_that_keeps_all_keeps_all_and_a_median_keeps_nothing():
    kept = lamp_study.shares_kept(lambda frame: frame.color)
    lost = lamp_study.shares_kept(lambda frame: cv2.medianBlur(cv2.medianBlur(frame.color, 5), 5))
    for edge in lamp_study.EDGES:
        np.testing.assert_allclose(kept[edge], 1)
        assert max(lost[edge]) < 0.1


def test_edges_lie_on_those_of_pixels_or_within_them():
    hard, seen = lamp_study.wall_with_lamp(16, 0.0, 0)
    assert seen.sum() == 12
    assert (hard.color.max(-1) > 3).sum() == 12
    mixed, seen = lamp_study.wall_with_lamp(16, 0.5, 0)
    assert seen.sum() == 6
    assert (mixed.color.max(-1) > 0.5).sum() == 20


def test_the_rule_gives_back_what_a_model_loses(capsys):
    lamp_study.main(model=["wskp-6"])
    rows = [line.split() for line in capsys.readouterr().out.splitlines() if "wskp-6" in line]
    assert [row[1] for row in rows] == ["no", "yes"]
    assert float(rows[0][2]) < 0.5
    assert float(rows[1][2]) > 0.9
