from __future__ import annotations

import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.model_spec import load  # noqa: E402
from stillray.models.precision import int8_path, pairs_path  # noqa: E402
from stillray.models.registry import WHOLE_SUFFIX, find_model, list_models, read_model  # noqa: E402
from stillray.models.session import open_session  # noqa: E402
from stillray_export import parity, to_onnx  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402

#: What models are made smaller by: graphs are exported one operator at a time, and a level of a
#: pyramid takes seconds. All kinds of planes stay; the files of whole models are compared below.
SMALLER = {
    "wskp-3s": ({}, {"kernel_sizes": (3, 5)}),
    "kpyr-5": (
        {
            "widths": (8, 12),
            "encoder_blocks": (0, 1),
            "decoder_blocks": (1,),
            "concatenate": (True,),
        },
        {
            "kernel_sizes": (3,),
            "finest_neighbours": (2,),
            "finest_filters": (2, 1),
            "filter_features": 2,
        },
    ),
    "kpyr-5s": (
        {"widths": (8,), "encoder_blocks": (1,), "decoder_blocks": (), "concatenate": ()},
        {"finest_filters": (2,)},
    ),
    "nbg-2x3": ({}, {}),
    # all levels and both ways to meet a skip; a block on the way down and one on the way up
    "wskp-mr": (
        {"widths": (8, 8, 12), "encoder_blocks": (1, 0, 0), "decoder_blocks": (0, 1)},
        {"kernel_sizes": (5,)},
    ),
}


@pytest.fixture(scope="module", params=SMALLER)
def exported(request, tmp_path_factory):
    torch.manual_seed(3)
    folder = tmp_path_factory.mktemp("models")
    spec = load(request.param)
    network, decoder = SMALLER[spec.name]
    spec = replace(
        spec, network=replace(spec.network, **network), decoder=replace(spec.decoder, **decoder)
    )
    network = FAMILIES[spec.family].network(spec)
    for path_of in (int8_path, pairs_path):
        path_of(folder / f"{spec.name}.onnx").write_bytes(b"of the weights before")
    found = []
    check = parity.check  # many seconds a model, and the export does it: what it finds is kept
    with warnings.catch_warnings(), pytest.MonkeyPatch.context() as patch:
        warnings.simplefilter("ignore")
        patch.setattr(parity, "check", lambda *forms: found.append(check(*forms)) or found[-1])
        path = to_onnx.export(network, spec, {"steps": 0, "scores": {"psnr": 1}}, folder)
    (worst,) = found
    return SimpleNamespace(spec=spec, network=network, path=path, worst=worst)


def test_exported_file_carries_its_spec_and_provenance(exported):
    info = read_model(exported.path)
    assert info.spec == exported.spec
    assert info.scores == {"psnr": 1}
    assert info.parameters == sum(p.numel() for p in fuse(exported.network).parameters())
    assert b"/site-packages/" not in exported.path.read_bytes()


def test_networks_in_integers_of_the_weights_before_are_gone(exported):
    assert not int8_path(exported.path).exists()
    assert not pairs_path(exported.path).exists()


def test_both_graphs_agree_with_the_network_at_every_size(exported):
    assert set(exported.worst) == {
        "branches logits",
        "merged logits",
        "fused logits",
        "onnx logits",
        "torch decoder",
        "runtime decoder",
        "whole graph",
    }


def test_exported_logits_are_clipped_as_the_decoder_would(exported):
    spec, network, path = exported.spec, exported.network, exported.path
    bound = getattr(spec.decoder, "logit_bound", None)
    if bound is None:
        pytest.skip("the decoder has no bound")
    rng = np.random.default_rng(1)
    shape = (1, len(spec.network.features), 16, 32)
    features = rng.uniform(-1e3, 1e3, shape).astype(np.float32)
    with torch.no_grad():
        outputs = fuse(network)(torch.from_numpy(features))
    wanted = [outputs] if isinstance(outputs, torch.Tensor) else outputs
    got = open_session(path, threads=1).run(None, {"features": features})
    assert max(level.abs().max() for level in wanted) > 2 * bound
    for logits, level in zip(got, wanted, strict=True):
        np.testing.assert_allclose(logits, level.clamp(-bound, bound), atol=0.01)


def test_parity_fails_loudly_when_one_weight_is_off(exported):
    spec, network, path = exported.spec, exported.network, exported.path
    whole = path.with_name(f"{spec.name}{WHOLE_SUFFIX}.onnx")
    wrong = fuse(network)
    convolution = [part for part in wrong.modules() if isinstance(part, torch.nn.Conv2d)][1]
    convolution.weight.data[3, 2, 1, 1] += 0.01
    with pytest.raises(parity.ParityError, match="fused logits must agree"):
        parity.check(network, wrong, path.read_bytes(), whole.read_bytes(), spec)


def test_forms_may_round_as_the_trained_network_does_and_not_much_more(exported, monkeypatch):
    spec, network, path = exported.spec, exported.network, exported.path
    whole = path.with_name(f"{spec.name}{WHOLE_SUFFIX}.onnx")
    forms = (network, fuse(network), path.read_bytes(), whole.read_bytes(), spec)
    monkeypatch.setattr(parity, "NETWORK_TOLERANCE", 0.0)
    parity.check(*forms)
    monkeypatch.setattr(parity, "ROUNDING", 0.01)
    with pytest.raises(parity.ParityError, match="logits must agree"):
        parity.check(*forms)
    monkeypatch.setattr(parity, "MOST_ROUNDING", 1e-12)
    with pytest.raises(parity.ParityError, match="branches logits must agree"):
        parity.check(*forms)


@pytest.mark.parametrize("name", [info.name for info in list_models()])
def test_committed_whole_graph_agrees_with_the_committed_network(name):
    import onnxruntime as ort

    path = find_model(name).path
    whole = path.with_name(f"{name}{WHOLE_SUFFIX}.onnx")
    spec = find_model(name).spec
    rng = np.random.default_rng(0)
    features = rng.uniform(0, 1, (1, len(spec.network.features), 32, 48)).astype(np.float32)
    arrays = parity.random_arrays(rng, 32, 48)
    logits = ort.InferenceSession(str(path)).run(None, {"features": features})
    given = {key: arrays[key] for key in FAMILIES[spec.family].inputs}
    (image,) = ort.InferenceSession(str(whole)).run(None, {"features": features, **given})
    decoded = parity.decoded(arrays, logits, spec)
    unit = parity.image_unit(arrays, decoded["oracle"], spec)
    assert (np.abs(image - decoded["runtime decoder"]) <= parity.IMAGE_TOLERANCE * unit).all()


def test_committed_models_hold_the_specs_of_this_source():
    for info in list_models():
        assert info.spec == load(info.name)
        assert {"data", "steps", "seed", "date", "scores"} <= set(info.provenance)


def test_rules_and_prose_are_todays_and_the_recipe_is_the_one_followed():
    now = load("kpyr-5")
    recipe = replace(now.training, steps=7)
    rules = replace(now.temporal, max_samples=3.0)
    trained = replace(now, temporal=rules, training=recipe, differs=("old; here new",))
    found = to_onnx.as_specified_now(trained)
    assert found == replace(now, training=recipe)
    assert found.differs == now.differs
    wider = replace(now.network, widths=(16, 32, 48, 64, 98))
    for other in (
        replace(trained, network=wider),
        replace(trained, name="kpyr-9"),
    ):
        assert to_onnx.as_specified_now(other) is other
