"""Files of a model whose specification says more than it did."""

import dataclasses
import shutil
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("torch")
onnx = pytest.importorskip("onnx")

from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.models.precision import int8_path, is_made_of, pairs_path  # noqa: E402
from stillray.models.registry import SPEC_KEY, WHOLE_SUFFIX, find_model  # noqa: E402
from stillray.pipeline.denoiser import Denoiser  # noqa: E402
from stillray_export.restate import main, restate  # noqa: E402
from tests.conftest import make_frame  # noqa: E402

NAME = "kpyr-5"


@pytest.fixture
def former(tmp_path):
    """A model's files as they were before its specification knew of one rule."""
    packaged = find_model(NAME).path
    for path in packaged.parent.glob(f"{NAME}.*"):
        shutil.copy(path, tmp_path)
    spec = load(NAME)
    rules = dataclasses.replace(spec.temporal, most_blur=0.0, max_samples=3.0)
    decoder = dataclasses.replace(spec.decoder, resolve_tone=0.5, sharp_recall=False)
    before = dataclasses.replace(spec, temporal=rules, decoder=decoder, differs=("old; here new",))
    path = tmp_path / packaged.name
    for file in (path, path.with_name(f"{NAME}{WHOLE_SUFFIX}.onnx"), *integers_of(path)):
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
