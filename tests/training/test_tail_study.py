"""What rare bright samples cost, on stills with references."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="training is of the extra train")

from stillray.errors import InputError
from stillray_training import tail_study
from stillray_training.evaluate.cases import find_cases
from stillray_training.simulate.sequence import write


@pytest.fixture
def stills(tmp_path):
    rng = np.random.default_rng(2)
    reference = np.full((40, 50, 3), 0.2, np.float32)
    noisy = (reference * rng.gamma(16, 1 / 16, (40, 50, 1))).astype(np.float32)
    for path, color in (("room/ref_0001", reference), ("spp/room/16/frame_0001", noisy)):
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        write(tmp_path / f"{path}.exr", {"color": color})
    return tmp_path


def test_frames_have_such_samples_and_references_their_mean(stills):
    (case,) = find_cases(stills, kinds=("stills",))
    plain, reference = tail_study.shown(case, 0.0)
    frame, lit = tail_study.shown(case, 0.1)
    again, _ = tail_study.shown(case, 0.1)
    np.testing.assert_array_equal(frame.color, again.color)
    # 16 samples of which 3.3 % are 3 times the light and more: two pixels in five have one
    assert np.mean(frame.color > plain.color) == pytest.approx(1 - np.exp(-16 * 0.1 / 3), abs=0.03)
    np.testing.assert_allclose(lit, reference * (1 + 0.1 * np.log(1e4 / 3)), rtol=1e-5)


def test_each_method_has_its_row_for_every_count(stills, capsys):
    tail_study.main(stills, model=["wskp-6"], counts=[16])
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert rows[0] == ["16", "samples", "0", "0.001", "0.01", "0.1"]
    values = {row[0]: [float(value) for value in row[1:]] for row in rows[1:] if row}
    assert list(values) == ["noisy", "wskp-6"]
    assert values["noisy"] == sorted(values["noisy"], reverse=True)
    assert all(
        ours > theirs for ours, theirs in zip(values["wskp-6"], values["noisy"], strict=True)
    )


def test_what_enlarges_is_refused(stills):
    with pytest.raises(InputError, match="the frame's size, got munet-x2, which enlarges"):
        tail_study.main(stills, model=["munet-x2"], counts=[16])
