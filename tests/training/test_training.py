from __future__ import annotations

import contextlib
import csv
import dataclasses
import json
import shutil

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.io.exr.new_file import write_channels  # noqa: E402
from stillray.io.exr.read import read_exr  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.models.registry import list_models  # noqa: E402
from stillray.pixel_filter import filter_spread  # noqa: E402
from stillray.stages.features import filter_feature  # noqa: E402
from stillray_training import patch_training, patches, provenance, run, train  # noqa: E402
from stillray_training.checkpoint import CHECKPOINT  # noqa: E402
from stillray_training.examples import (  # noqa: E402
    NOISY,
    QUIET,
    STARTS,
    STILL,
    Runtime,
    find_sequences,
    load_examples,
)
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.losses import (  # noqa: E402
    blur_error,
    displayed,
    dissimilarity,
    filmic,
    slope_error,
    smape,
)
from stillray_training.networks.repvgg import without_branches  # noqa: E402
from stillray_training.patches import PatchSampler  # noqa: E402
from stillray_training.peers.oidn import open_image_denoise  # noqa: E402
from stillray_training.rendered import read_rendered  # noqa: E402
from stillray_training.simulate.sequence import write  # noqa: E402
from stillray_training.start import STARTED_FROM, start_from  # noqa: E402
from stillray_training.targets import (  # noqa: E402
    make_target,
    make_targets,
    read_filter,
    read_target,
)
from tests.conftest import clean_color, make_frame  # noqa: E402


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """One tiny finished sequence, and one that was cut off."""
    folder = tmp_path_factory.mktemp("data")
    for name, finished in (("room-0000-0", True), ("room-0001-0", False)):
        sequence = folder / name
        sequence.mkdir()
        for index in range(3):
            frame = make_frame(40, 48, index)
            layers = {
                "": ("RGB", frame.color), "albedo.": ("RGB", frame.albedo),
                "normal.": ("XYZ", frame.normal), "depth.": ("Z", frame.depth[..., None]),
                "motion.": ("XY", frame.motion),
            }  # fmt: skip
            write_channels(
                sequence / f"frame_{index:04d}.exr",
                {
                    prefix + channel: image[..., place]
                    for prefix, (channels, image) in layers.items()
                    for place, channel in enumerate(channels)
                },
            )
        truth = clean_color(40, 48)
        write_channels(sequence / "ref_0002.exr", {c: truth[..., i] for i, c in enumerate("RGB")})
        if finished:
            record = {"options": {"spp": 1}}
            (sequence / "sequence.json").write_text(json.dumps(record))
    return folder


@pytest.fixture
def small():
    spec = load("wskp-3s")
    recipe = dataclasses.replace(spec.training, steps=30, batch=2, patch=32, learning_rate=5e-3)
    return dataclasses.replace(spec, training=recipe)


def test_only_finished_sequences_are_learned_from(data):
    assert [path.name for path in find_sequences(data)] == ["room-0000-0"]


def test_examples_hold_one_sample_a_few_and_more(data, small):
    examples = load_examples(find_sequences(data)[0], small, Strips(1))
    held = [float(np.median(example.mean[..., 3])) for example in examples]
    assert len(held) == len(STARTS) + 1
    assert held[0] <= 1 < held[1]
    assert [example.kind for example in examples] == [NOISY] * len(STARTS) + [QUIET]
    assert [example.frames for example in examples[: len(STARTS)]] == list(STARTS)
    assert held[-1] <= 1


@pytest.fixture
def blocks(data, tmp_path):
    """A sequence with two more blocks, of 3 and 12 samples, whose samples are the last frame's."""
    sequence = tmp_path / "room-0000-0"
    shutil.copytree(find_sequences(data)[0], sequence)
    last = sorted(sequence.glob("frame_*.exr"))[-1]
    for index in range(2):
        shutil.copy(last, sequence / f"block_0002_{index:02d}.exr")
    record = json.loads((sequence / "sequence.json").read_text())
    record["options"]["blocks"] = [3, 12]
    (sequence / "sequence.json").write_text(json.dumps(record))
    return sequence


def test_blocks_give_frames_of_more_samples(blocks, small):
    examples = load_examples(blocks, small, Strips(1))
    last = sorted(blocks.glob("frame_*.exr"))[-1]
    still = [each for each in examples if each.kind == STILL and each.frames == 1]
    quiet = [example for example in examples if example.kind == QUIET]
    assert {example.spp for example in still} <= {1.0, 3.0, 4.0, 12.0, 13.0, 15.0, 16.0}
    assert all(32 <= example.spp <= 4096 for example in quiet)
    # one sample and no past is the hardest of all: it has its share
    alone = []
    for seed in range(20):
        spec = dataclasses.replace(small, training=dataclasses.replace(small.training, seed=seed))
        drawn = load_examples(blocks, spec, Strips(1))
        alone += [each.spp for each in drawn if each.kind == STILL and each.frames == 1]
    assert 0.25 < np.mean(np.array(alone) < 2) < 0.65
    for example in quiet:
        light = example.sample[..., :3] * example.demodulation_albedo
        off = np.median(np.abs(light - example.reference))
        noise = np.median(np.abs(read_exr(last).color - example.reference))
        assert off < 0.75 * noise
    # what network and feature see: samples that are told count, in half of the patches
    recipe = dataclasses.replace(small.training, still_share=1.0)
    sampler = PatchSampler(examples, dataclasses.replace(small, training=recipe))
    planes = [sampler.batch(step).features for step in range(4)]
    assert np.concatenate(planes)[:, small.network.features.index("samples")].max() > 0.7


def test_a_network_that_asks_is_told_the_filter_in_three_of_four_patches(blocks, small):
    network = dataclasses.replace(
        small.network, features=(*small.network.features[:-1], "pixel_filter")
    )
    spec = dataclasses.replace(small, network=network)
    assert read_filter(blocks) is None
    record = json.loads((blocks / "sequence.json").read_text())
    (blocks / "sequence.json").write_text(json.dumps(record | {"integrator": {}}))
    examples = load_examples(blocks, spec, Strips(1))
    box = filter_feature(filter_spread("box"))  # what the simulator renders with
    assert {filter_feature(e.filter_spread) for e in examples if e.kind != STILL} == {box}
    sampler = PatchSampler(examples, spec)
    planes = np.concatenate([sampler.batch(step).features[:, -1] for step in range(60)])
    assert all(np.ptp(plane) == 0 for plane in planes)
    told = planes[:, 0, 0] != 0
    assert 0.6 < told.mean() < 0.9
    assert planes.min() == np.float32(box)


def test_a_model_of_single_frames_never_sees_a_past(blocks, small):
    kinds = []
    for seed in range(6):
        recipe = dataclasses.replace(small.training, seed=seed, alone=True)
        examples = load_examples(blocks, dataclasses.replace(small, training=recipe), Strips(1))
        kinds.append(sorted(each.kind for each in examples))
        for each in examples:
            assert each.frames == 1
            assert not each.previous.any()
            # a pixel holds this frame's sample and nothing else
            np.testing.assert_array_equal(each.mean, each.sample)
    assert set(kinds[0]) == {"noisy", "still", "quiet"}
    assert all(each == kinds[0] for each in kinds)


def test_blocks_give_pasts_whose_light_changes_or_not(blocks, small):
    examples = []
    for seed in range(4):
        spec = dataclasses.replace(small, training=dataclasses.replace(small.training, seed=seed))
        examples += [each for each in load_examples(blocks, spec, Strips(1)) if each.frames > 1]
    lit = [each for each in examples if each.kind == STILL]
    assert len(lit) == 12
    truth = clean_color(40, 48)
    changes, held, looked_up = [], [], []
    for each in lit:
        assert 2 <= each.spp <= 256
        shade = each.reference / truth
        np.testing.assert_allclose(shade[..., 0], shade[..., 2], rtol=1e-3)
        # frame and reference are under the same light
        light = each.sample[..., :3] * each.demodulation_albedo
        assert 0.8 < light.mean() / each.reference.mean() < 1.2
        assert (each.previous[4:-4, 4:-4, 3] == 1).all()
        looked_up.append((each.previous[..., 3] < 1).any())
        off = np.abs(np.log((each.previous[..., :3] + 1e-3) / (each.reference + 1e-3)))
        changes.append(np.median(off.max()))
        held.append(each.mean[..., 3].max() / each.sample[..., 3].max())
    assert 2 <= sum(looked_up) <= 10  # as of a camera that moves, or not
    assert np.ptp(changes) > 0.3
    assert max(held) > 2.5  # of a past that holds


def test_looks_between_pixels_blur_an_edge_where_it_is(small):
    output = np.ones((20, 24, 4), np.float32)
    output[:, :12, :3] = (0.1, 0.2, 0.3)
    with contextlib.closing(Runtime(small, Strips(1))) as runtime:
        once, often = (
            runtime.looked_up(output, times, np.random.default_rng(3)) for times in (1, 3)
        )
    row, dark = once[10, :, :3], output[10, 0, :3]
    assert (np.diff(row[3:-3], axis=0) > -1e-6).all()  # no ringing
    np.testing.assert_allclose(row[3:10], np.tile(dark, (7, 1)), atol=1e-6)
    np.testing.assert_allclose(row[14:-3], 1, atol=1e-6)
    slopes = [np.diff(image[10, :, 1]).max() for image in (output, once, often)]
    assert slopes[0] > 1.05 * slopes[1] > 1.1 * slopes[2]
    assert once[..., 3].min() < 1  # what came from beside the frame


def test_patches_have_more_edges_where_two_are_compared(data, small, monkeypatch):
    examples = load_examples(find_sequences(data)[0], small, Strips(1))

    def slopes(share):
        monkeypatch.setattr(patches, "BUSIER", share)
        batches = [PatchSampler(examples, small).batch(step) for step in range(40)]
        return np.mean([np.abs(np.diff(np.log(b.reference + 0.05))).mean() for b in batches])

    assert slopes(1.0) > slopes(0.0)


def test_a_target_takes_the_place_of_the_reference(data, small, tmp_path):
    sequence = tmp_path / "room-0000-0"
    shutil.copytree(find_sequences(data)[0], sequence)
    pytest.importorskip("pyoidn")
    truth = clean_color(40, 48)
    noisy = truth * np.random.default_rng(0).uniform(0.7, 1.3, truth.shape)
    write(sequence / "ref_0002.exr", {"color": noisy.astype(np.float32)})
    before = read_target(sequence)[0]
    bias = make_target(sequence)
    after = read_target(sequence)[0]
    assert abs(bias) < 0.05
    assert np.abs(after - truth).mean() < 0.5 * np.abs(before - truth).mean()


def test_noise_of_features_is_not_in_a_target(tmp_path):
    pytest.importorskip("pyoidn")
    height, width, rng = 64, 72, np.random.default_rng(0)
    truth = clean_color(height, width)
    noise = rng.normal(0, 0.1, (height, width, 3)).astype(np.float32)
    features = {
        "albedo": np.clip(0.5 + noise, 0, 1),
        "normal": np.float32([0, 0, 1]) + noise,
    }
    write(tmp_path / "ref_0000.exr", {"color": truth * (1 + noise[::-1]), **features})
    make_targets(tmp_path)
    frame = read_exr(tmp_path / "ref_0000.exr")
    taken_for_clean = open_image_denoise(
        frame.color, frame.albedo, frame.normal, "high", clean_features=True
    )
    target = read_exr(tmp_path / "target_0000.exr").color
    error, with_noise = (np.abs(image - truth).mean() for image in (target, taken_for_clean))
    assert error < 0.5 * with_noise


def test_quiet_patches_come_as_often_as_asked(data, small):
    examples = load_examples(find_sequences(data)[0], small, Strips(1))
    for share, expected in ((0.0, False), (1.0, True)):
        recipe = dataclasses.replace(small.training, quiet_share=share)
        sampler = PatchSampler(examples, dataclasses.replace(small, training=recipe))
        batch = sampler.batch(1)
        noise = np.abs(batch.irradiance * batch.divisor - batch.reference)
        assert (np.median(noise) < 0.1 * batch.reference.mean()) == expected


def test_a_batch_depends_on_seed_and_step_only(data, small):
    examples = load_examples(find_sequences(data)[0], small, Strips(1))
    first, again = (PatchSampler(examples, small).batch(5) for _ in range(2))
    np.testing.assert_array_equal(first.features, again.features)
    other = PatchSampler(examples, small).batch(6)
    assert not np.array_equal(first.features, other.features)
    assert first.features.shape == (2, 8, 32, 32)


def test_a_share_of_batches_is_of_small_patches(data, small):
    examples = load_examples(find_sequences(data)[0], small, Strips(1))

    def sizes(share, patch):
        recipe = dataclasses.replace(small.training, small_share=share, patch=patch)
        sampler = PatchSampler(examples, dataclasses.replace(small, training=recipe))
        batches = [sampler.batch(step) for step in range(120)]
        shapes = {array.shape[2:] for batch in batches for array in (batch.features, batch.new)}
        assert shapes == {batch.reference.shape[2:] for batch in batches}
        return [batch.features.shape[2] for batch in batches]

    assert set(sizes(0.0, 40)) == {40}
    assert set(sizes(1.0, 40)) == {32, 40}  # none is larger than the recipe's
    assert 10 <= sizes(0.5, 40).count(32) <= 30  # a third of half of them, some more or fewer


def test_augmentation_keeps_target_and_input_together(data, small):
    # the mean of many noisy samples is the reference, whatever the turn, order, gain and albedo
    examples = load_examples(find_sequences(data)[0], small, Strips(1))
    examples = [example for example in examples if example.kind != QUIET]  # some have fireflies
    ratios = []
    for step in range(20):
        batch = PatchSampler(examples, small).batch(step)
        radiance = (batch.irradiance * batch.divisor).mean((2, 3))
        ratios.append(radiance / batch.reference.mean((2, 3)))
    np.testing.assert_allclose(np.mean(ratios, axis=(0, 1)), 1, atol=0.1)


@pytest.fixture
def one_thread():
    """Sums in one order: of several threads on a busy machine they are not always the same."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(before)


def test_training_lowers_the_loss_and_resumes_where_it_stopped(data, small, tmp_path, one_thread):
    whole = patch_training.train(small, [data], tmp_path / "whole", save_every=10)
    half = dataclasses.replace(small, training=dataclasses.replace(small.training, steps=20))
    # the learning rate follows the recipe's length: keep it, stop early
    original = run.learning_rate
    try:
        run.learning_rate = lambda step, _, __: original(
            step, step / small.training.steps, small.training
        )
        patch_training.train(half, [data], tmp_path / "parts", save_every=10)
        resumed = patch_training.train(small, [data], tmp_path / "parts", save_every=10)
    finally:
        run.learning_rate = original
    for one, other in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(one, other)
    with (tmp_path / "parts" / "log.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [int(row["step"]) for row in rows] == sorted({int(row["step"]) for row in rows})
    examples = load_examples(find_sequences(data)[0], small, Strips(1))
    batch = PatchSampler(examples, small).batch(999)
    torch.manual_seed(small.training.seed)
    before = patch_training.reconstruct_loss(FAMILIES[small.family].network(small), batch, small)
    assert patch_training.reconstruct_loss(whole, batch, small) < before


@pytest.mark.parametrize(
    "key",
    [
        "display_weight",
        "squared_weight",
        "structure_weight",
        "slope_weight",
        "blur_weight",
        "smape_weight",
        "filmic_weight",
        "mean_weight",
    ],
)
def test_a_weight_adds_its_part_of_the_loss(data, small, key):
    network = FAMILIES[small.family].network(small)
    batch = PatchSampler(load_examples(find_sequences(data)[0], small, Strips(1)), small).batch(3)

    def loss(weight):
        recipe = dataclasses.replace(small.training, **{key: weight})
        spec = dataclasses.replace(small, training=recipe)
        return float(patch_training.reconstruct_loss(network, batch, spec))

    exposed = torch.from_numpy(batch.exposure)
    outputs = network(torch.from_numpy(batch.features))
    take = {
        field.name: torch.from_numpy(getattr(batch, field.name))
        for field in dataclasses.fields(batch)
    }
    image = FAMILIES[small.family].radiance(outputs, take, small) * exposed
    reference = torch.from_numpy(batch.reference) * exposed
    shown, wanted = displayed(image), displayed(reference)
    part = {
        "display_weight": (shown - wanted).abs().mean(),
        "squared_weight": ((shown - wanted) ** 2).mean(),
        "structure_weight": dissimilarity(shown, wanted),
        "slope_weight": slope_error(shown - wanted),
        "blur_weight": blur_error(shown - wanted),
        "smape_weight": smape(image, reference, small.training.smape_epsilon),
        "filmic_weight": (filmic(image) - filmic(reference)).abs().mean(),
        "mean_weight": (shown - wanted).mean((2, 3)).abs(),
    }[key]
    assert loss(3.0) - loss(0.0) == pytest.approx(3 * float(part.mean()), rel=1e-4)


def examples_seen(monkeypatch, data, out, *, steps, renewed_every):
    """What `kpyr-5` draws its patches from at each step, its outputs renewed every so many."""
    spec = load("kpyr-5")
    recipe = dataclasses.replace(
        spec.training, steps=steps, batch=1, patch=32,
        history_from=renewed_every, history_every=renewed_every,
    )  # fmt: skip
    seen = []
    original = patch_training.PatchSampler.batch
    monkeypatch.setattr(
        patch_training.PatchSampler,
        "batch",
        lambda self, step: seen.append(list(self._examples)) or original(self, step),
    )
    patch_training.train(dataclasses.replace(spec, training=recipe), data, out, save_every=steps)
    return seen


def test_a_recurrent_model_learns_from_its_own_previous_outputs(data, tmp_path, monkeypatch):
    found = examples_seen(monkeypatch, [data], tmp_path, steps=4, renewed_every=2)
    seen = [examples[1] for examples in found]
    valid = [example.previous[..., 3].mean() for example in seen]
    assert valid[0] == valid[1] == 0
    assert valid[2] > 0.9
    # after one renewal of an untrained network, the output is near the accumulated radiance
    assert np.isfinite(seen[3].previous).all()
    assert (tmp_path / patch_training.PREVIOUS).is_file()


def test_data_that_is_named_twice_has_previous_outputs_twice(data, tmp_path, monkeypatch):
    """The first of both kept none, and was learned from as if it had no past."""
    last = examples_seen(monkeypatch, [data, data], tmp_path, steps=2, renewed_every=1)[-1]
    half = len(last) // 2
    recurrent = 0
    for first, second in zip(last[:half], last[half:], strict=True):
        assert (first.sequence, first.frames, first.kind) == (
            second.sequence, second.frames, second.kind,
        )  # fmt: skip
        assert np.array_equal(first.previous, second.previous)
        recurrent += bool(first.previous[..., 3].any())
    assert recurrent


def test_a_checkpoint_of_another_network_is_refused(data, small, tmp_path):
    short = dataclasses.replace(small, training=dataclasses.replace(small.training, steps=1))
    patch_training.train(short, [data], tmp_path, save_every=1)
    with pytest.raises(InputError, match="checkpoint must be of wskp-3s"):
        patch_training.train(without_branches(short), [data], tmp_path)


def test_a_checkpoint_of_another_optimiser_is_refused(data, small, tmp_path):
    def with_optimiser(name):
        recipe = dataclasses.replace(small.training, steps=1, optimiser=name)
        return dataclasses.replace(small, training=recipe)

    patch_training.train(with_optimiser("muon"), [data], tmp_path, save_every=1)
    with pytest.raises(InputError, match="must be of optimiser adam, got muon"):
        patch_training.train(with_optimiser("adam"), [data], tmp_path)
    with pytest.raises(InputError, match="optimiser must be one of adam, muon, got sgd"):
        with_optimiser("sgd")


def test_an_empty_data_folder_is_refused(small, tmp_path):
    with pytest.raises(InputError, match="data must hold finished sequences"):
        patch_training.train(small, [tmp_path], tmp_path / "out")


def credited(folder, name, licence):
    asset = {"name": name, "title": "A Chair", "author": "A. Nyone", "licence": licence,
             "source": "https://example.org/chair"}  # fmt: skip
    folder.mkdir()
    (folder / "sequence.json").write_text(json.dumps({"assets": [asset]}))
    return folder


def test_provenance_credits_the_assets_in_the_data(small, tmp_path):
    sequences = [credited(tmp_path / "interior-0000-0", "chair", "CC BY 4.0"), tmp_path / "old-0-0"]
    (tmp_path / "data.json").write_text(json.dumps(["interior-0000-0"]))
    (tmp_path / provenance.ASSETS).write_text(json.dumps(provenance.assets_of(sequences)))
    (tmp_path / "log.csv").write_text("step,loss\n1,0.5\n")
    credits = provenance.collect(tmp_path, small, 40)["credits"]
    assert credits["chair"] == '"A Chair" by A. Nyone (https://example.org/chair), CC BY 4.0'
    assert "interior.py" in credits["interior"]


@pytest.mark.parametrize("licence", ["CC BY-NC 4.0", "CC BY-SA 4.0", "proprietary"])
def test_assets_under_other_licences_train_no_model(tmp_path, licence):
    with pytest.raises(InputError, match="under CC0 or CC BY, got chair"):
        provenance.assets_of([credited(tmp_path / "interior-0000-0", "chair", licence)])


def test_provenance_counts_scenes_and_credits_them(small, tmp_path):
    (tmp_path / "data.json").write_text(json.dumps(["room-0000-0", "room-0001-2", "tire-0000-0"]))
    (tmp_path / "log.csv").write_text("step,loss,seconds\n20,0.5,1\n40,0.3,2\n")
    about = provenance.collect(tmp_path, small, 40)
    assert about["data"] == {"room": 2, "tire": 1}
    assert "HorusZ" in about["credits"]["tire"]
    assert about["training_loss"] == pytest.approx(0.4)


def test_renders_of_ones_own_are_told_apart_and_train_no_model_that_ships():
    credits = provenance.credits_of({"room", "show"})
    assert credits["show"] == provenance.UNSTATED
    assert "Apache-2.0" in credits["room"]
    for model in list_models():
        assert provenance.UNSTATED not in json.dumps(model.provenance)
        assert provenance.UNSTATED not in provenance.credits_of(set(model.provenance["data"]))


@pytest.mark.parametrize(
    ("missing", "message"),
    [
        ("frame_*.exr", "must hold frames, frame_0000"),
        ("ref_*.exr", r"must hold a reference, ref_0007\.exr"),
    ],
)
def test_a_sequence_that_lacks_files_is_refused_in_a_line(data, tmp_path, missing, message):
    sequence = tmp_path / "room-0-0"
    shutil.copytree(data / "room-0000-0", sequence)
    for path in sequence.glob(missing):
        path.unlink()
    with pytest.raises(InputError, match=message):
        load_examples(sequence, load("wskp-3s"), Strips(1))


def test_a_sequence_smaller_than_a_patch_is_refused_in_a_line(data):
    spec = load("wskp-3s")
    examples = load_examples(data / "room-0000-0", spec, Strips(1))
    with pytest.raises(InputError, match=r"room-0000-0: must have 128 x 128 pixels or more"):
        PatchSampler(examples, spec)


def test_a_folder_that_is_not_there_is_one_line(small, tmp_path):
    with pytest.raises(InputError, match="data must be a folder of sequences"):
        patch_training.train(small, [tmp_path / "gone"], tmp_path / "out")


def test_another_model_s_weights_are_taken_over_by_the_names_of_features(data, small, tmp_path):
    short = dataclasses.replace(
        small,
        network=dataclasses.replace(small.network, identity=False),
        training=dataclasses.replace(small.training, steps=1),
    )
    first = patch_training.train(short, [data], tmp_path / "first", save_every=1)
    names = short.network.features
    turned = dataclasses.replace(
        short,
        network=dataclasses.replace(short.network, features=(*names[:0:-1], "sample.luminance")),
    )
    second = FAMILIES[turned.family].network(turned)
    origin = start_from(tmp_path / "first" / CHECKPOINT, second, turned)
    assert origin == {"model": "wskp-3s", "steps": 1}
    (tmp_path / "first" / STARTED_FROM).write_text('{"model": "older", "steps": 7}')
    origin = start_from(tmp_path / "first" / CHECKPOINT, second, turned)
    assert origin["started_from"] == {"model": "older", "steps": 7}
    planes = torch.rand(1, len(names), 10, 6)
    planes[:, 0] = 0  # what the second does not read
    unread = torch.rand(1, 1, 10, 6)  # what the first did not read has no weight yet
    again = torch.cat([planes[:, 1:].flip(1), unread], 1)
    torch.testing.assert_close(second(again), first(planes))
    # an identity adds each feature to a channel of its own
    mixed = dataclasses.replace(
        turned, network=dataclasses.replace(turned.network, features=names[::-1], identity=True)
    )
    with pytest.raises(InputError, match="start must read the features of wskp-3s in their order"):
        start_from(
            tmp_path / "first" / CHECKPOINT,
            FAMILIES[mixed.family].network(mixed),
            mixed,
        )


def test_a_deeper_guide_net_starts_as_the_shallow_one_and_learns_with_all_its_layers(
    data, tmp_path
):
    shallow, deep = (
        dataclasses.replace(spec, training=dataclasses.replace(spec.training, steps=1, patch=32))
        for spec in (load("nbg-2x3"), load("nbg-7x3"))
    )
    first = patch_training.train(shallow, [data], tmp_path / "first", save_every=1)
    second = FAMILIES[deep.family].network(deep)
    start_from(tmp_path / "first" / CHECKPOINT, second, deep)
    planes = torch.rand(1, len(shallow.network.features), 9, 7)
    torch.testing.assert_close(second(planes), first(planes))
    sampler = PatchSampler(load_examples(find_sequences(data)[0], deep, Strips(1)), deep)
    patch_training.reconstruct_loss(second, sampler.batch(0), deep).backward()
    added = [weight.grad for name, weight in second.leave.named_parameters() if weight.ndim == 4]
    assert all(gradient[:, deep.network.width :].abs().sum() > 0 for gradient in added)


def test_weights_that_do_not_fit_are_refused(data, small, tmp_path):
    short = dataclasses.replace(small, training=dataclasses.replace(small.training, steps=1))
    patch_training.train(short, [data], tmp_path, save_every=1)
    wide = dataclasses.replace(small, network=dataclasses.replace(small.network, widths=(16, 20)))
    network = FAMILIES[wide.family].network(wide)
    with pytest.raises(InputError, match=r"start must have weights that fit wskp-3s.*blocks"):
        start_from(tmp_path / CHECKPOINT, network, wide)


@pytest.mark.parametrize(
    ("model", "error"),
    [
        # single frames, and sequences: each finds that there is nothing to train on
        ("wskp-3s", "data must hold finished sequences"),
        ("munet-x2", "data must hold finished sequences"),
        ("online", "got online, which learns as it denoises"),
    ],
)
def test_the_command_trains_every_family_but_the_one_that_learns_by_itself(model, error, tmp_path):
    with pytest.raises(InputError, match=error):
        train.main(model, [tmp_path], tmp_path / "run")


@pytest.mark.parametrize(
    "share",
    [
        "lamp_share", "window_share", "shadow_share", "tail_share", "defocus_share", "glint_share",
        "texture_share", "leaf_share", "page_share", "mixture_share", "sheen_share",
    ],
)  # fmt: skip
def test_what_is_painted_is_the_same_with_the_blocks_of_a_sequence_and_without(data, small, share):
    recipe = dataclasses.replace(small.training, **{share: 1.0})
    sequence = find_sequences(data)[0]
    plain = read_rendered(sequence, small.training)
    whole, part = (read_rendered(sequence, recipe, with_blocks=each) for each in (True, False))
    for own, other in zip(whole.frames, part.frames, strict=True):
        np.testing.assert_array_equal(own.color, other.color)
    np.testing.assert_array_equal(whole.reference, part.reference)
    assert np.any(whole.reference != plain.reference)
    assert len(part.blocks) == 1


def test_a_sequence_has_the_same_lamps_with_a_window_and_without(data, small):
    sequence = find_sequences(data)[0]
    lamps, windows, both = (
        read_rendered(sequence, dataclasses.replace(small.training, **shares)).reference
        for shares in (
            {"lamp_share": 1.0}, {"window_share": 1.0}, {"lamp_share": 1.0, "window_share": 1.0},
        )
    )  # fmt: skip
    plain = read_rendered(sequence, small.training).reference
    shines = np.any(lamps != plain, axis=-1)
    np.testing.assert_array_equal(both[~shines], windows[~shines])
    assert np.any(both[shines] != windows[shines])


def test_albedo_can_be_what_is_learned(blocks, small):
    """Its noise is the input, the mean of all samples what it is to become."""
    rng = np.random.default_rng(3)
    truth = read_exr(sorted(blocks.glob("frame_*.exr"))[-1]).albedo
    for path in (*blocks.glob("block_*.exr"), *sorted(blocks.glob("frame_*.exr"))):
        frame = read_exr(path)
        noisy = np.clip(truth + rng.normal(0, 0.1, truth.shape), 0, 1).astype(np.float32)
        names = ("color", "normal", "depth", "motion")
        write(path, {name: getattr(frame, name) for name in names} | {"albedo": noisy})
    recipe = dataclasses.replace(small.training, layer="albedo", alone=True, quiet_share=0.3)
    examples = load_examples(blocks, dataclasses.replace(small, training=recipe), Strips(1))
    assert {each.kind for each in examples} == {NOISY, STILL, QUIET}
    single = examples[0]
    # nothing to divide by
    assert (single.remodulation_albedo == 1).all()
    assert (single.demodulation_albedo == 1).all()
    last, *more = (read_exr(path).albedo for path in (path, *sorted(blocks.glob("block_*.exr"))))
    np.testing.assert_allclose(single.mean[..., :3], last, atol=1e-3)
    mean = (last + 3 * more[0] + 12 * more[1]) / 16
    np.testing.assert_allclose(single.reference, mean, atol=1e-3)
    for each in examples:
        assert each.mean[..., :3].max() <= 1.2  # nowhere a firefly
        assert np.abs(each.mean[..., :3] - truth).mean() < 0.15


def test_a_reference_with_albedo_is_what_albedo_is_to_become(blocks, small):
    sure = np.full((40, 48, 3), 0.25, np.float32)
    write(blocks / "ref_0002.exr", {"color": clean_color(40, 48), "albedo": sure})
    recipe = dataclasses.replace(small.training, layer="albedo", alone=True)
    examples = load_examples(blocks, dataclasses.replace(small, training=recipe), Strips(1))
    np.testing.assert_allclose(examples[0].reference, sure, rtol=1e-3)


def test_an_albedo_has_a_target_of_its_own(blocks, small):
    color = clean_color(40, 48)
    for name, albedo in (("ref_0002.exr", 0.25), ("target_0002.exr", 0.5)):
        write(blocks / name, {"color": color, "albedo": np.full_like(color, albedo)})
    recipe = dataclasses.replace(small.training, layer="albedo", alone=True)
    examples = load_examples(blocks, dataclasses.replace(small, training=recipe), Strips(1))
    np.testing.assert_allclose(examples[0].reference, 0.5, rtol=1e-3)
