from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from stillray.errors import InputError  # noqa: E402
from stillray.families.pyramid_logits import logit_names  # noqa: E402
from stillray.models.registry import find_model  # noqa: E402
from stillray.models.session import open_session  # noqa: E402
from stillray_training.families import FAMILIES, network_of  # noqa: E402
from stillray_training.start import start_from  # noqa: E402


@pytest.mark.parametrize(
    "name", ["kpyr-5", "fast", "wskp-3s", "wskp-6", "wskp-mr", "nbg-7x3", "munet-x2"]
)
def test_training_goes_on_from_what_a_packaged_model_computes(name):
    info = find_model(name)
    network = network_of(info.spec)
    origin = start_from(name, network, info.spec)
    assert origin["model"] == info.name
    assert origin["steps"] == info.provenance["steps"]
    assert origin["credits"] == info.provenance["credits"]
    shape = (1, len(info.spec.network.features), 32, 48)
    features = np.random.default_rng(1).random(shape, np.float32)
    wanted = open_session(info.path, threads=1).run(None, {"features": features})
    with torch.no_grad():
        found = network(torch.from_numpy(features))
    found = [found] if isinstance(found, torch.Tensor) else found
    bound = getattr(info.spec.decoder, "logit_bound", None)
    for one, other in zip(found, wanted, strict=True):
        clipped = one if bound is None else one.clamp(-bound, bound)
        np.testing.assert_allclose(clipped.numpy(), other, rtol=0, atol=2e-4)


def test_features_that_enter_in_two_places_stay_where_they_are():
    info = find_model("munet-x2")
    network = info.spec.network
    other = dataclasses.replace(network, radiance=network.radiance[1:] + network.radiance[:1])
    spec = dataclasses.replace(info.spec, network=other)
    with pytest.raises(InputError, match="must read the features of munet-x2 in their order"):
        start_from("munet-x2", network_of(spec), spec)


def test_a_packaged_model_starts_a_deeper_one():
    shallow, deep = find_model("nbg-2x3"), find_model("nbg-7x3")
    first, second = (FAMILIES[info.family].network(info.spec) for info in (shallow, deep))
    start_from("nbg-2x3", first, shallow.spec)
    origin = start_from(str(shallow.path), second, deep.spec)
    assert origin["model"] == "nbg-2x3"
    features = torch.rand(1, len(shallow.spec.network.features), 16, 24)
    torch.testing.assert_close(second(features), first(features))


def test_a_packaged_model_starts_one_with_more_blocks_and_filters():
    info = find_model("kpyr-5")
    known = info.spec.decoder
    distances = (*known.finest_filters, 16)
    deeper = dataclasses.replace(
        info.spec.network,
        decoder_blocks=tuple(count + 1 for count in info.spec.network.decoder_blocks),
    )
    decoder = dataclasses.replace(known, finest_filters=distances)
    spec = dataclasses.replace(info.spec, network=deeper, decoder=decoder)
    first, second = (FAMILIES[info.family].network(each) for each in (info.spec, spec))
    start_from("kpyr-5", first, info.spec)
    start_from("kpyr-5", second, spec)
    features = torch.rand(1, len(info.spec.network.features), 32, 48)
    finest, *coarser = second(features)
    wanted, *others = first(features)
    torch.testing.assert_close(finest[:, : wanted.shape[1]], wanted)
    torch.testing.assert_close(coarser, others)
    # the new filter takes what the next, 8 apart, does, and less of it
    names = logit_names(0, deeper.resolutions, known)
    at = [names.index(f"filters: 8 {who}") for who in ("others", "itself")]
    like = wanted[:, at] + torch.tensor([0.0, 2.0])[None, :, None, None]
    torch.testing.assert_close(finest[:, wanted.shape[1] :], like)


@pytest.mark.parametrize("name", ["kpyr-5", "kpyr-5s", "kpyr-5-still"])
def test_a_packaged_model_starts_a_wider_one(name):
    """It gives the same pictures, and what is new can be learned from: its gradients are not 0."""
    info = find_model(name)
    narrow = info.spec.network
    widths = (narrow.widths[0], *(width + 8 * at for at, width in enumerate(narrow.widths[1:], 1)))
    spec = dataclasses.replace(info.spec, network=dataclasses.replace(narrow, widths=widths))
    first, second = (network_of(each) for each in (info.spec, spec))
    start_from(name, first, info.spec)
    start_from(name, second, spec)
    features = torch.rand(1, len(narrow.features), 32, 48)
    pictures = second(features)
    for found, wanted in zip(pictures, first(features), strict=True):
        torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)  # sums in another order
    sum(logits.square().mean() for logits in pictures).backward()
    read = second.enter[2].weight.grad[: narrow.widths[2], narrow.widths[1] :]
    assert read.abs().amax(dim=(0, 2, 3)).median() > 0  # a ReLU may close a random one
    with pytest.raises(InputError, match=f"start must have weights that fit {name}"):
        start_from(name, network_of(_narrower(spec)), _narrower(spec))


def _narrower(spec):
    widths = tuple(width // 2 for width in spec.network.widths)
    return dataclasses.replace(spec, network=dataclasses.replace(spec.network, widths=widths))


@pytest.mark.parametrize(("name", "pixels"), [("kpyr-5", 1), ("kpyr-5s", 4)])
def test_a_packaged_model_starts_one_with_other_logits_by_what_they_are_for(name, pixels):
    """Logits of the finest level lie elsewhere where it has kernels, and neighbours before them."""
    info = find_model(name)
    decoder = dataclasses.replace(
        info.spec.decoder, kernel_sizes=(3, 5), finest_kernels=True, finest_neighbours=(3,)
    )
    spec = dataclasses.replace(info.spec, decoder=decoder)
    levels = spec.network.resolutions
    first, second = (network_of(each) for each in (info.spec, spec))
    start_from(name, first, info.spec)
    start_from(name, second, spec)
    features = torch.rand(1, len(spec.network.features), 32, 48)
    for level, (found, wanted) in enumerate(zip(second(features), first(features), strict=True)):
        ours, theirs = (logit_names(level, levels, each.decoder) for each in (spec, info.spec))
        planes = pixels if level == 0 else 1
        assert level or ours != theirs
        kept = [use for use in theirs if use in ours]
        assert {"pool: to the coarser", "blend: 5"} & set(kept)
        for use in kept:
            at, there = planes * ours.index(use), planes * theirs.index(use)
            torch.testing.assert_close(
                found[:, at : at + planes], wanted[:, there : there + planes], msg=use
            )


def test_what_is_no_start_is_refused_by_name(tmp_path):
    info = find_model("wskp-3s")
    network = FAMILIES[info.family].network(info.spec)
    with pytest.raises(InputError, match=r"start must be a checkpoint.*got nothing.*wskp-3s"):
        start_from("nothing", network, info.spec)
    model = onnx.load(info.path)
    for part in model.graph.initializer:
        part.name = part.name.replace("blocks.1", "others.1")
    for node in model.graph.node:
        node.input[:] = [name.replace("blocks.1", "others.1") for name in node.input]
    onnx.save(model, tmp_path / "other.onnx")
    with pytest.raises(InputError, match=r"must hold the weights of its spec, lacks.*blocks\.1"):
        start_from(tmp_path / "other.onnx", network, info.spec)
