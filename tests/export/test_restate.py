"""Files of a model whose specification says more than it did."""

import dataclasses
import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")
ort = pytest.importorskip("onnxruntime")

from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.models.precision import int8_path, is_made_of, pairs_path  # noqa: E402
from stillray.models.registry import SPEC_KEY, WHOLE_SUFFIX, find_model  # noqa: E402
from stillray.pipeline.denoiser import Denoiser  # noqa: E402
from stillray_export import parity  # noqa: E402
from stillray_export.restate import main, restate  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from tests.conftest import make_frame  # noqa: E402

NAME = "kpyr-5"


@pytest.fixture
def former(tmp_path):
    """A model's files as they were before its specification knew of one rule of the past."""
    return as_before(tmp_path, NAME)


def as_before(folder, name, **reconstruction):
    packaged = find_model(name).path
    for path in packaged.parent.glob(f"{name}.*"):
        shutil.copy(path, folder)
    spec = load(name)
    rules = dataclasses.replace(spec.temporal, most_blur=0.0, max_samples=3.0)
    decoder = dataclasses.replace(spec.decoder, **reconstruction)
    before = dataclasses.replace(spec, temporal=rules, decoder=decoder, differs=("old; here new",))
    path = folder / packaged.name
    for file in (path, path.with_name(f"{name}{WHOLE_SUFFIX}.onnx"), *integers_of(path)):
        model = onnx.load(file)
        told = {entry.key: entry.value for entry in model.metadata_props}
        onnx.helper.set_model_props(model, {**told, SPEC_KEY: before.to_json()})
        onnx.save(model, file)
    return path


def test_files_say_what_is_specified_today_and_give_the_pictures_of_it(former):
    packaged = find_model(NAME)
    assert restate(former) == [
        former, former.with_name(f"{NAME}{WHOLE_SUFFIX}.onnx"), *integers_of(former)
    ]  # fmt: skip
    anew = find_model(former)
    assert anew.spec.temporal == load(NAME).temporal
    assert anew.spec.decoder == load(NAME).decoder
    assert anew.spec.differs == load(NAME).differs
    assert anew.provenance == packaged.provenance
    frames = [make_frame(24, 33, seed) for seed in range(3)]
    for precision in ("float32", "int8"):
        pictures = []
        for path in (packaged.path, former):
            with Denoiser(path, threads=1, precision=precision) as denoiser:
                pictures.append([denoiser.denoise(frame) for frame in frames][-1])
        np.testing.assert_array_equal(*pictures)


def test_rules_of_the_reconstruction_go_into_the_whole_graph_too(tmp_path):
    """Which does all of it: with metadata alone it would go on by those before."""
    name, rng = "kpyr-5s", np.random.default_rng(3)
    former = as_before(tmp_path, name, filter_tone=0.5, resolve_tone=0.5, sharp_recall=False)
    whole = former.with_name(f"{name}{WHOLE_SUFFIX}.onnx")
    packaged = find_model(name).path.with_name(whole.name)
    onnx.save(with_half_of_all_constants(whole), whole)
    restate(former)
    assert find_model(former).spec.decoder == load(name).decoder
    spec, images = load(name), []
    given = parity.random_arrays(rng, 32, 48)
    names = FAMILIES[spec.family].inputs
    features = parity.random_features(rng, spec, 32, 48)
    for path in (packaged, whole):
        inputs = {"features": features, **{each: given[each] for each in names}}
        (image,) = ort.InferenceSession(str(path)).run(None, inputs)
        images.append(image)
    unit = parity.image_unit(given, images[0], spec)
    assert (np.abs(images[1] - images[0]) <= parity.IMAGE_TOLERANCE * unit).all()


def with_half_of_all_constants(path):
    model = onnx.load(path)
    for tensor in model.graph.initializer:
        if tensor.data_type == onnx.TensorProto.FLOAT:
            half = onnx.numpy_helper.to_array(tensor) / 2
            tensor.CopyFrom(onnx.numpy_helper.from_array(half, tensor.name))
    return model


def integers_of(path):
    found = [file for file in (int8_path(path), pairs_path(path)) if file.is_file()]
    assert found
    return found


def test_networks_in_integers_are_of_the_new_file(former):
    restate(former)
    files = [former, *integers_of(former)]
    assert all(is_made_of(path, source) for source, path in pairwise(files))


def test_a_model_that_says_it_already_is_left_alone(former):
    main(str(former))
    with pytest.raises(InputError, match="model must say something else"):
        restate(former)


def test_scores_alone_can_be_told_anew(former, monkeypatch):
    main(str(former))
    scores = {"psnr": 29.5, "bias": 0.8}
    monkeypatch.setattr("stillray_export.restate.scores_of", lambda path, validation: scores)
    files = restate(former, Path("validation"))
    assert find_model(files[0]).scores == scores
    files = [former, *integers_of(former)]
    assert all(is_made_of(path, source) for source, path in pairwise(files))
