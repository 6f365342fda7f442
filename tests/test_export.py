from __future__ import annotations

import warnings

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.export import parity, to_onnx  # noqa: E402
from stillray.export.fuse import fuse  # noqa: E402
from stillray.models_spec import load  # noqa: E402
from stillray.registry import WHOLE_SUFFIX, find_model, list_models, read_model  # noqa: E402
from stillray.training.networks.importance import ImportanceNet  # noqa: E402


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    torch.manual_seed(3)
    folder = tmp_path_factory.mktemp("models")
    network = ImportanceNet(load("wskp-3"))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        path = to_onnx.export(network, load("wskp-3"), {"steps": 0, "scores": {"psnr": 1}}, folder)
    return network, path


def test_exported_file_carries_its_spec_and_provenance(exported):
    _, path = exported
    info = read_model(path)
    assert info.spec == load("wskp-3")
    assert info.scores == {"psnr": 1}
    assert info.parameters == sum(p.numel() for p in fuse(exported[0]).parameters())
    assert b"/site-packages/" not in path.read_bytes()


def test_both_graphs_agree_with_the_network_at_every_size(exported):
    network, path = exported
    whole = path.with_name(f"wskp-3{WHOLE_SUFFIX}.onnx")
    worst = parity.check(
        network, fuse(network), path.read_bytes(), whole.read_bytes(), load("wskp-3")
    )
    assert set(worst) == {
        "branches logits",
        "merged logits",
        "fused logits",
        "onnx logits",
        "torch decoder",
        "runtime decoder",
        "whole graph",
    }


def test_parity_fails_loudly_when_one_weight_is_off(exported):
    network, path = exported
    whole = path.with_name(f"wskp-3{WHOLE_SUFFIX}.onnx")
    wrong = fuse(network)
    wrong[2].weight.data[3, 2, 1, 1] += 0.01
    with pytest.raises(parity.ParityError, match="fused logits must agree"):
        parity.check(network, wrong, path.read_bytes(), whole.read_bytes(), load("wskp-3"))


@pytest.mark.parametrize("name", ["wskp-3", "wskp-6"])
def test_committed_whole_graph_agrees_with_the_committed_network(name):
    import onnxruntime as ort

    path = find_model(name).path
    whole = path.with_name(f"{name}{WHOLE_SUFFIX}.onnx")
    rng = np.random.default_rng(0)
    features = rng.uniform(0, 1, (1, 12, 33, 18)).astype(np.float32)
    irradiance = rng.lognormal(0, 1, (1, 3, 33, 18)).astype(np.float32)
    samples = rng.uniform(0.1, 8, (1, 1, 33, 18)).astype(np.float32)
    logits = ort.InferenceSession(str(path)).run(None, {"features": features})[0]
    image = ort.InferenceSession(str(whole)).run(
        None, {"features": features, "irradiance": irradiance, "samples": samples}
    )[0]
    decoded = parity.decoded(irradiance, samples, logits, find_model(name).spec)
    np.testing.assert_allclose(image, decoded["runtime decoder"], rtol=parity.IMAGE_TOLERANCE)


def test_committed_models_hold_the_specs_of_this_source():
    for info in list_models():
        assert info.spec == load(info.name)
        assert {"data", "steps", "seed", "date", "scores"} <= set(info.provenance)
