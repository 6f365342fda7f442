"""Features that weigh alike are kept apart, and the network computes what it did."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

import onnx
from onnxruntime import InferenceSession

from stillray.models.registry import find_model
from stillray_export.plane_order import best_order, order_features
from stillray_export.small_sums import scales_of_outputs


def test_features_that_weigh_alike_are_kept_apart(rng):
    # 0 and 1, 2 and 3 and so on are as red and green of one light
    weights = np.repeat(rng.normal(size=(20, 6, 3, 3)), 2, axis=1)
    weights[:, ::2] *= 0.9
    order = best_order(weights)
    assert sorted(order) == list(range(12))
    pairs = {frozenset(pair) for pair in order.reshape(-1, 2).tolist()}
    assert not pairs & {frozenset((first, first + 1)) for first in range(0, 12, 2)}
    finer = scales_of_outputs(weights[:, order]) / scales_of_outputs(weights)
    assert np.median(finer) < 0.8
    assert (finer < 1.05).all()


@pytest.mark.parametrize("name", ["kpyr-5s", "kpyr-5-still"])
def test_a_network_computes_the_same_of_features_in_its_order(name, rng):
    network = onnx.load(find_model(name).path)
    features = rng.random((1, find_model(name).interface.features, 32, 32), np.float32)
    before = _run(network, features)
    places = order_features(network.graph)
    assert sorted(places) == list(range(features.shape[1])) != places
    in_order = np.empty_like(features)
    in_order[:, places] = features
    for found, expected in zip(_run(network, in_order), before, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4)


def test_features_that_are_taken_by_parts_stay_where_they_are():
    network = onnx.load(find_model("munet-x2").path)
    count = find_model("munet-x2").interface.features
    before = network.SerializeToString()
    assert order_features(network.graph) == list(range(count))
    assert network.SerializeToString() == before


def _run(network, features):
    return InferenceSession(network.SerializeToString()).run(None, {"features": features})
