from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training import patch_training, run  # noqa: E402
from stillray_training.examples import STILL, find_sequences, load_examples  # noqa: E402
from stillray_training.patches import PatchSampler  # noqa: E402
from stillray_training.redrawn import Redrawn, draw_of  # noqa: E402
from stillray_training.rendered import read_rendered  # noqa: E402
from stillray_training.simulate.sequence import write  # noqa: E402
from tests.conftest import clean_color, make_frame  # noqa: E402

SIZE = (40, 48)
COUNTS = (1, 2, 4)


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """Three sequences of one frame and three blocks, each with noise of its own."""
    folder = tmp_path_factory.mktemp("data")
    for number in range(3):
        sequence = folder / f"room-{number:04d}-0"
        sequence.mkdir()
        files = ["frame_0000", *(f"block_{index:02d}" for index in range(len(COUNTS)))]
        for place, name in enumerate(files):
            frame = make_frame(*SIZE, 10 * number + place)
            layers = ("color", "albedo", "normal", "depth", "motion")
            write(sequence / f"{name}.exr", {layer: getattr(frame, layer) for layer in layers})
        write(sequence / "ref_0000.exr", {"color": clean_color(*SIZE)})
        record = {"options": {"spp": 1, "blocks": list(COUNTS)}}
        (sequence / "sequence.json").write_text(json.dumps(record))
    return folder


@pytest.fixture
def small():
    spec = load("wskp-3s")
    recipe = dataclasses.replace(
        spec.training, steps=8, batch=2, patch=32, alone=True, still_share=0.8, redraw_every=2,
        shadow_share=0.5,
    )  # fmt: skip
    return dataclasses.replace(spec, training=recipe)


def loaded(data, spec, draw=0):
    return [
        example
        for path in find_sequences(data)
        for example in load_examples(path, spec, Strips(1), draw)
    ]


def sampler_of(data, spec):
    examples = loaded(data, spec)
    every = spec.training.redraw_every
    load = lambda path, draw: load_examples(path, spec, Strips(1), draw)  # noqa: E731
    return PatchSampler(examples, spec, Redrawn(examples, every, load))


@pytest.mark.parametrize(("every", "sequences"), [(1, 1), (1, 4), (3, 1), (3, 5)])
def test_sequences_take_turns_in_being_drawn(every, sequences):
    drawn, turn = [0] * sequences, 0
    for step in range(40):
        if step and step % every == 0:
            drawn[turn] += 1
            turn = (turn + 1) % sequences
        found = [draw_of(place, step, every, sequences) for place in range(sequences)]
        assert found == drawn
    assert draw_of(0, 10**6, 0, sequences) == 0


def test_another_drawing_is_of_the_same_kinds_and_has_other_noise(data, small):
    path = find_sequences(data)[0]
    first, again, second = (load_examples(path, small, Strips(1), draw) for draw in (0, 0, 1))
    for one, same, other in zip(first, again, second, strict=True):
        assert one.kind == other.kind
        assert np.array_equal(one.mean, same.mean)
    stills = [
        [(one.spp, float(one.mean.mean())) for one in examples if one.kind == STILL]
        for examples in (first, second)
    ]
    assert not set(stills[0]) & set(stills[1])
    # what is painted is drawn anew as well
    shadowed = [
        not np.allclose(
            read_rendered(path, small.training, draw=draw).reference, clean_color(*SIZE), atol=0.01
        )
        for draw in range(8)
    ]
    assert any(shadowed)
    assert not all(shadowed)


def test_what_a_step_sees_depends_on_the_step_alone(data, small):
    whole, late = (sampler_of(data, small) for _ in range(2))
    once = PatchSampler(loaded(data, small), small)
    differ = 0
    for step in range(8):
        found, fixed = whole.batch(step), once.batch(step)
        if step % 3 == 2:
            np.testing.assert_array_equal(late.batch(step).features, found.features)
        differ += not np.array_equal(found.features, fixed.features)
    assert differ
    np.testing.assert_array_equal(whole.batch(0).features, once.batch(0).features)


def test_a_training_that_is_taken_up_again_sees_the_same(data, small, tmp_path, monkeypatch):
    monkeypatch.setattr(run, "learning_rate", lambda step, _, __: 1e-3)  # else by the steps in all
    half = dataclasses.replace(small, training=dataclasses.replace(small.training, steps=5))
    twice = [data, data]
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # sums in one order
    try:
        whole = patch_training.train(small, twice, tmp_path / "whole", save_every=8)
        patch_training.train(half, twice, tmp_path / "parts", save_every=5)
        resumed = patch_training.train(small, twice, tmp_path / "parts", save_every=8)
    finally:
        torch.set_num_threads(threads)
    for one, other in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_a_sequence_that_changes_meanwhile_is_refused_by_name(data, small):
    examples = loaded(data, small)
    redrawn = Redrawn(examples, 2, lambda path, draw: examples[:3])
    with pytest.raises(InputError, match=r"room-0000-0: must stay as it is"):
        redrawn.at(0, 2)


def test_previous_outputs_and_redrawn_frames_exclude_each_other(small):
    with pytest.raises(InputError, match=r"training.redraw_every must be 0 .* got 2"):
        dataclasses.replace(small.training, history_from=5)
