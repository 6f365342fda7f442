"""What a network learns from, where its model takes color alone."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.examples import load_examples  # noqa: E402
from stillray_training.patches import PatchSampler  # noqa: E402
from tests.conftest import make_frame  # noqa: E402
from tests.training.one_frame import write_one_frame  # noqa: E402

SIZE = (40, 48)


def unpainted(name):
    """A specification by which nothing is painted into what is learned from."""
    spec = load(name)
    shares = {
        share.name: 0.0
        for share in dataclasses.fields(spec.training)
        if share.name.endswith("_share") and share.name not in ("still_share", "quiet_share")
    }
    recipe = dataclasses.replace(
        spec.training, **shares, batch=2, patch=32, exposure_stops=0.0, redraw_every=0
    )
    return dataclasses.replace(spec, training=recipe)


@pytest.fixture
def sequence(tmp_path):
    folder = tmp_path / "room-0000-0"
    folder.mkdir()
    write_one_frame(folder, SIZE)
    return folder


@pytest.mark.parametrize("name", ["kpyr-5-color", "kpyr-5s-color"])
def test_a_model_of_color_alone_learns_from_light_that_nothing_divides(name, sequence):
    spec = unpainted(name)
    noisy, *_ = load_examples(sequence, spec, Strips(1))
    for white in (noisy.albedo, noisy.demodulation_albedo, noisy.remodulation_albedo):
        np.testing.assert_array_equal(white, 1)
    # but for fireflies, of which this frame has none
    np.testing.assert_allclose(noisy.mean[..., :3], make_frame(*SIZE, 1).color, rtol=2e-3)
    batch = PatchSampler([noisy], spec).batch(0)
    assert batch.features.shape == (2, len(spec.network.features), 32, 32)
    assert batch.features[:, :3].any(axis=(0, 2, 3)).all()
    np.testing.assert_array_equal(batch.divisor, 1)


def test_other_models_learn_from_light_without_albedo(sequence):
    noisy, *_ = load_examples(sequence, unpainted("kpyr-5"), Strips(1))
    frame = make_frame(*SIZE, 1)
    assert noisy.normal.any()
    np.testing.assert_allclose(noisy.depth, frame.depth, rtol=1e-3)
    divided = frame.color / noisy.demodulation_albedo
    assert np.abs(divided - frame.color).max() > 0.1
    np.testing.assert_allclose(noisy.mean[..., :3], divided, rtol=2e-2, atol=1e-3)
