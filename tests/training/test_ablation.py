from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("skimage")
pytest.importorskip("matplotlib")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.families import box_filter as kernels  # noqa: E402
from stillray.families.registry import kernels_of  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.model_spec.decoders import FusedKernels  # noqa: E402
from stillray.model_spec.networks import ImportanceNetwork, PyramidNetwork  # noqa: E402
from stillray.stages.prepare import prepare  # noqa: E402
from stillray_training.ablation import __main__ as command  # noqa: E402
from stillray_training.ablation import claims, measure, results, study, variants  # noqa: E402
from stillray_training.ablation.page import write_page  # noqa: E402
from stillray_training.ablation.study import folder_of  # noqa: E402
from stillray_training.checkpoint import CHECKPOINT  # noqa: E402
from stillray_training.peers.kernel_prediction import KernelPredictionNet  # noqa: E402
from stillray_training.peers.kernel_predictor import KernelPredictor  # noqa: E402
from tests.conftest import make_frame  # noqa: E402

DATA = Path(__file__).parents[1] / "data"
STUDY = {variant.name: variant for variant in variants.study()}


def tiny(name, steps=20):
    """A variant of the study with a network and a recipe of next to nothing."""
    variant = STUDY[name]
    recipe = dataclasses.replace(variant.spec.training, steps=steps, batch=1, patch=24)
    if isinstance(variant.spec.network, PyramidNetwork):
        network = dataclasses.replace(variant.spec.network, widths=(4, 4, 4))
    else:
        network = dataclasses.replace(variant.spec.network, widths=(4,), kernel_sizes=(5, 5))
    sizes = (3, 5) if name == "KP-fusion" else variant.spec.decoder.kernel_sizes[:1]
    decoder = dataclasses.replace(variant.spec.decoder, kernel_sizes=sizes)
    spec = dataclasses.replace(variant.spec, training=recipe, network=network, decoder=decoder)
    return dataclasses.replace(variant, spec=spec)


def test_what_is_told_of_a_shipped_model_is_no_part_of_a_variant():
    # else a study that was trained would have to be trained again for a sentence
    assert load("wskp-6").differs
    assert all("differs" not in json.loads(one.spec.to_json()) for one in STUDY.values())


def test_variants_differ_in_what_is_compared_and_in_nothing_else():
    base = STUDY[variants.BASE].spec
    assert len(STUDY) == len(variants.study())
    assert len({folder_of(variant, Path()) for variant in STUDY.values()}) == len(STUDY)
    for name, variant in STUDY.items():
        spec = variant.spec
        for table in ("inputs", "demodulate", "transfer", "temporal"):
            assert getattr(spec, table) == getattr(base, table), name
        if name != variants.PAPER_INPUT:
            assert spec.network.features == base.network.features
        stills = {"still_share": 1.0, "quiet_share": 0.0} if variant.stills else {}
        assert spec.training == dataclasses.replace(base.training, **stills), name
        assert variant.stills == name.endswith(", 64 samples")
        assert spec.training.patch % kernels_of(spec).looks.alignment == 0, name


@pytest.mark.parametrize(
    ("name", "blocks", "sizes"),
    [
        ("wskp-6", 6, (3, 5, 7, 9, 11, 13)), ("wskp-3", 3, (3, 5, 7, 9, 11, 13)), ("KP", 6, (13,)),
        ("KP-1", 2, (13,)), ("KP-2", 5, (7,)), ("3 fused kernels", 6, (3, 5, 7)),
        ("one 11x11 kernel", 6, (11,)), ("6 kernels of 13x13", 6, (13,) * 6),
        ("KP, no branches", 6, (13,)), ("KP-fusion", 6, (3, 5, 7, 9, 11, 13)),
        ("8 fused kernels", 6, tuple(range(3, 18, 2))),
        ("10 fused kernels", 6, tuple(range(3, 22, 2))),
    ],
)  # fmt: skip
def test_variants_are_those_of_the_paper(name, blocks, sizes):
    spec = STUDY[name].spec
    assert isinstance(spec.network, ImportanceNetwork)
    assert isinstance(spec.decoder, FusedKernels)
    assert len(spec.network.widths) + 1 == blocks
    assert spec.decoder.kernel_sizes == sizes
    network = STUDY[name].family.network(spec)
    outputs = network(torch.zeros(1, len(spec.network.features), 3, 4)).shape[1]
    # a weight of each kernel, and a share of each where there are several
    predicted = sum(size**2 for size in sizes) + (len(sizes) if len(sizes) > 1 else 0)
    assert outputs == (predicted if name.startswith("KP") else 2 * len(sizes))
    plain = name.endswith("no branches")
    assert spec.network.branches == ((5,) if plain else (5, 3, 1))
    assert spec.network.identity != plain


@pytest.mark.parametrize(
    ("name", "sizes", "planes"), [("wskp-mr", (3, 5), [5, 5, 4]), ("MR-KP", (5,), [26, 26, 25])]
)
def test_multi_resolution_variants_differ_in_their_kernels_alone(name, sizes, planes):
    variant, ours = STUDY[name], load("wskp-mr")
    assert variant.spec.network == ours.network
    assert variant.spec.decoder == dataclasses.replace(ours.decoder, kernel_sizes=sizes)
    network = variant.family.network(variant.spec)
    logits = network(torch.zeros(1, len(ours.network.features), 8, 12))
    assert [level.shape[1] for level in logits] == planes


def test_mr_kp_of_one_layer_has_a_convolution_and_a_head_a_level():
    variant = STUDY[variants.ONE_LAYER]
    network = variant.family.network(variant.spec)
    # into each level, up from each coarser one, and a head a level
    assert sum(isinstance(one, torch.nn.Conv2d) for one in network.modules()) == 3 + 2 + 3
    logits = network(torch.zeros(1, len(variant.spec.network.features), 8, 12))
    assert [level.shape[1] for level in logits] == [26, 26, 25]


def test_seeds_are_told_apart_by_their_numbers_and_folders_alone():
    twice = variants.study(seeds=2, steps=7)
    once = variants.study(steps=7)
    first, second = twice[: len(once)], twice[len(once) :]
    assert first == once
    assert len({folder_of(one, Path()) for one in twice}) == len(twice)
    for one, other in zip(first, second, strict=True):
        assert (one.name, one.seed, other.seed) == (other.name, 1, 2)
        assert one.spec.training.steps == 7
        recipe = dataclasses.replace(one.spec.training, seed=one.spec.training.seed + 1)
        assert other.spec == dataclasses.replace(one.spec, training=recipe)


def test_what_tables_and_claims_name_is_in_the_study():
    named = {name for comparison in variants.COMPARISONS for name in comparison.variants}
    named |= {name for claim in claims.CLAIMS for name in (claim.of, claim.to)}
    assert named == set(STUDY)
    assert set(variants.TIMED) < named
    asked = {name for claim in claims.CLAIMS if claim.times for name in (claim.of, claim.to)}
    assert asked <= set(variants.TIMED)


def test_predicted_kernels_run_as_a_user_runs_a_model(rng, tmp_path):
    # a network that answers with one tap: every pixel becomes its neighbour, times its own albedo
    variant = tiny("KP-2")
    network = variant.family.network(variant.spec)
    assert isinstance(network, KernelPredictionNet)
    size = variant.spec.decoder.kernel_sizes[0]
    row, column = 1, 5
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
        bias = network.blocks[-1].branches()[0].bias
        bias.fill_(-30)
        bias[row * size + column] = 30
    height, width = 75, 41  # three strips
    light = rng.uniform(1, 2, (height, width, 1)).astype(np.float32)
    albedo = rng.uniform(0.2, 0.9, (height, width, 3)).astype(np.float32)
    frame = Frame(color=light * albedo, albedo=albedo)
    measure.export(variant, network, tmp_path / "network.onnx")
    with measure.open_stream(variant, tmp_path / "network.onnx", temporal=False) as stream:
        assert isinstance(stream, KernelPredictor)
        image = stream.denoise(frame)
        assert {"network", "reconstruct"} <= set(stream.last_timings)
    down, right = row - size // 2, column - size // 2
    inner = (slice(3, height - 3), slice(3, width - 3))
    there = np.roll(light, (-down, -right), (0, 1))
    # what the other taps keep: 48 of exp(-24)
    np.testing.assert_allclose(image[inner], (there * albedo)[inner], rtol=1e-5)


def test_predicted_kernels_without_preference_are_a_box_over_accumulated_light(tmp_path):
    variant = tiny("KP-2")
    network = variant.family.network(variant.spec)
    with torch.no_grad():
        for parameter in network.parameters():
            parameter.zero_()
    history = None
    measure.export(variant, network, tmp_path / "network.onnx")
    with measure.open_stream(variant, tmp_path / "network.onnx") as stream:
        for seed in range(3):
            frame = make_frame(20, 31, seed, shift=1.0)
            image = stream.denoise(frame)
            prepared = prepare(frame, variant.spec, history, Strips(1))
            history = prepared.history
    flat = np.zeros((2, 20, 31), np.float32)
    box = kernels.filter_rows(history.mean, flat, slice(0, 20), variant.spec.decoder)
    # float32 sums of 49 products
    np.testing.assert_allclose(image, box * prepared.remodulation_albedo, rtol=1e-4, atol=1e-6)


def test_one_command_trains_scores_times_and_reports(tmp_path, monkeypatch):
    def small(seeds=1, steps=20):
        once = [tiny("wskp-6", steps), tiny("KP-fusion", steps)]
        return [one.with_seed(seed) for seed in range(1, seeds + 1) for one in once]

    monkeypatch.setattr(command, "study", small)
    out, report = tmp_path / "out", tmp_path / "page.md"
    given = {"out": out, "data": [DATA], "validation": DATA, "height": 20, "width": 30}
    given |= {"seeds": 2, "steps": 20, "only": ["wskp-6"]}
    command.main(**given, rounds=2, report=report, pictures=tmp_path / "pictures")
    page = report.read_text()
    assert re.search(r"\| wskp-6 \| [\d.]+ ± [\d.]+ \| ", page)
    assert "Accumulation on and off" in page
    assert "2 seeds each" in page
    written = re.search(r"`(python -m stillray_training\.ablation [^`]*)`", page).group(1)
    assert "--seeds 2 --steps 20 --rounds 2 --height 20 --width 30 --only wskp-6 " in written
    assert "KP-fusion" not in page
    # of the first seed, with accumulation and without
    assert len(list((tmp_path / "pictures").glob("room-*.png"))) == 2
    given["only"] = None
    command.main(**given, rounds=2, report=report)
    found = results.read_results(small(2), out)
    assert found.size == (20, 30)
    assert set(found.mean("KP-fusion")) == set(found.mean("wskp-6")) <= set(measure.METRICS)
    assert found.mean("wskp-6")["psnr"].seeds == 2
    assert found.mean("wskp-6")["psnr"].deviation > 0
    assert set(found.milliseconds["KP-fusion"]) == {"network", "reconstruct", "both"}
    assert found.ratios["wskp-6"] == {"network": 1, "reconstruct": 1, "both": 1}
    # what is done is not done again
    files = [
        folder_of(one, out) / name for one in small(2) for name in (CHECKPOINT, measure.SCORES)
    ]
    before = [path.stat().st_mtime_ns for path in files]
    command.main(**given)
    assert [path.stat().st_mtime_ns for path in files] == before
    # other weights are scored anew
    given["steps"] = 40
    with pytest.raises(InputError, match="study as it is now"):
        command.main(**given)
    (folder_of(small()[0], out) / CHECKPOINT).unlink()
    command.main(**given | {"seeds": 1, "only": ["wskp-6"]})
    after = [path.stat().st_mtime_ns for path in files]
    changed = [True, True] + [False] * 6
    assert [old != new for old, new in zip(before, after, strict=True)] == changed
    with pytest.raises(InputError, match="only must be one of wskp-6; KP-fusion, got KP"):
        command.main(**given | {"only": ["KP"]})


def test_many_samples_are_scored_on_stills_without_a_past(monkeypatch):
    seen = []

    class Stream:
        temporal = False

        class model:  # noqa: N801
            name = "KP, 64 samples"

        def reset(self):
            pass

        def denoise(self, frame):
            seen.append(frame)
            return frame.color

    frame = make_frame(16, 20)

    class Case:
        name = "room"

        def read(self):
            return [frame], [frame.color]

    asked = {}

    def cases(folder, **given):
        asked.update(given)
        return [Case()]

    monkeypatch.setattr(measure, "find_cases", cases)
    scores = measure.score_stills(Stream(), Path())
    assert asked == {"kinds": ("stills",), "counts": (64,)}
    assert seen == [frame]
    assert scores["room"]["psnr"] == np.inf


def test_many_samples_need_data_that_has_them(tmp_path, monkeypatch):
    monkeypatch.setattr(study, "load_all", lambda *given: [])
    with pytest.raises(InputError, match="several blocks of samples"):
        study.train_all([STUDY["wskp-mr, 64 samples"]], [DATA], tmp_path)


def found(scores, times=None):
    """Results of one scene and one part; scores are of one seed, or a list of several."""
    times = times or {}
    scores = {name: psnr if isinstance(psnr, list) else [psnr] for name, psnr in scores.items()}
    return results.Results(
        scores={
            name: {seed: {"room": {"psnr": value}} for seed, value in enumerate(psnr, start=1)}
            for name, psnr in scores.items()
        },
        one_frame={},
        losses=dict.fromkeys(scores, 0.1),
        milliseconds={
            name: {"network": ms, "reconstruct": 1.0, "both": ms + 1} for name, ms in times.items()
        },
        ratios={name: {"both": ms} for name, ms in times.items()},
        size=(720, 1280),
        rounds=3,
        machine={"processor": "abacus", "threads": "2"},
        load=7.0,
    )


@pytest.mark.parametrize(
    ("paper", "here", "apart", "said"),
    [
        (-0.7, -0.4, 0.1, "holds"),
        (-0.7, 0.4, 0.1, "does not hold"),
        (-0.7, -0.05, 0.1, "seeds differ as much"),
        (None, 0.4, 0.1, "holds"),
        (None, -0.4, 0.1, "does not hold"),
        (-0.01, 0.1, 0.03, "holds"),
        (-0.01, 0.1, 0.1, "seeds differ as much"),
        (-0.01, 0.4, 0.05, "does not hold"),
        (-0.01, -0.4, 0.05, "does not hold"),
    ],
)
def test_a_finding_holds_when_seeds_leave_no_other(paper, here, apart, said):
    claim = claims.Claim(text="", of="KP", to="wskp-6", paper=paper)
    # three seeds, whose levels differ by far more than their differences do
    levels = [29.0, 30.0, 31.5]
    ours = found(
        {"wskp-6": levels, "KP": [levels[index] + here + apart * (index - 1) for index in range(3)]}
    )
    value = claims.measured(claim, ours)
    assert value.mean == pytest.approx(here)
    assert value.deviation == pytest.approx(apart)
    # Student's t of two degrees of freedom, 95 %: 4.303 standard errors
    assert claims.uncertainty(value) == pytest.approx(4.303 * apart / 3**0.5, rel=1e-3)
    assert claims.verdict(claim, value) == said


def test_of_one_seed_nothing_is_concluded():
    claim = claims.Claim(text="", of="KP", to="wskp-6", paper=-0.7)
    ours = found({"wskp-6": 30.0, "KP": 25.0})
    assert claims.verdict(claim, claims.measured(claim, ours)) == "one seed alone"
    # seeds are compared with themselves: of what only one has, none is
    ours = found({"wskp-6": [30.0, 31.0], "KP": [29.0]})
    assert claims.measured(claim, ours).mean == pytest.approx(-1)


def test_quantiles_are_those_of_student():
    stats = pytest.importorskip("scipy.stats")
    for seeds in range(2, claims.MOST_SEEDS + 1):
        value = results.Value(mean=0.0, deviation=seeds**0.5, seeds=seeds)
        expected = stats.t.ppf(0.975, seeds - 1)
        assert claims.uncertainty(value) == pytest.approx(expected, abs=0.006)


@pytest.mark.parametrize(
    ("here", "said"), [(0.5, "holds"), (0.3, "less than that"), (0.9, "more than that")]
)
def test_times_hold_when_their_ratio_is_near(here, said):
    claim = claims.Claim(text="", of="KP", to="wskp-6", paper=0.46, times=True)
    ours = found({}, {"KP": here * 2, "wskp-6": 2.0})
    assert claims.verdict(claim, claims.measured(claim, ours)) == said


def test_the_page_says_what_is_missing(tmp_path):
    three = {"wskp-6": [25.0, 25.2, 25.1], "wskp-3": [24.0, 24.1, 24.2]}
    ours = found(three, {"wskp-6": 1.0})
    write_page(variants.study(seeds=4), ours, tmp_path / "page.md", "the command")
    page = (tmp_path / "page.md").read_text()
    missing = next(line for line in page.splitlines() if line.startswith("Not finished"))
    assert "KP-1 (4 of 4 seeds)" in missing
    assert "wskp-3 (1 of 4 seeds)" in missing
    # differences -1.0, -1.1 and -0.9: a deviation of 0.1
    row = "| wskp-3 is below wskp-6 (table 1) | -0.69 | -1.00 ± 0.25 | 0 of 1 | holds |"
    assert row in page
    assert "| wskp-3 | 24.10 ± 0.10 |" in page
    assert "KP-1 is below" not in page
    assert "One kernel" not in page
    assert "About 7 programs" in page
    assert not (tmp_path / "page.png").exists()


def test_the_page_shows_numbers_of_kernels_once_there_are_two(tmp_path):
    ours = found({"wskp-6": 25.0, "one 3x3 kernel": 24.0}, {"wskp-6": 1.0, "one 3x3 kernel": 0.9})
    write_page(variants.study(), ours, tmp_path / "page.md", "the command")
    page = (tmp_path / "page.md").read_text()
    assert "page.png" in page
    assert (tmp_path / "page.png").stat().st_size > 1000
    assert "are above one of 3x3 (figure 9) |  | +1.00 | 1 of 1 | one seed alone |" in page
    assert "abacus, 2 threads" in page


def test_results_without_the_base_or_times_are_bad_input(tmp_path):
    with pytest.raises(InputError, match="wskp-6"):
        results.read_results(variants.study(), tmp_path)
    folder = folder_of(STUDY["wskp-6"], tmp_path)
    folder.mkdir()
    scores = {"checkpoint": "", "loss": 0.1, "scenes": {"room": {"psnr": 25.0}}}
    (folder / measure.SCORES).write_text(json.dumps(scores))
    with pytest.raises(InputError, match="times"):
        results.read_results(variants.study(), tmp_path)
