from __future__ import annotations

import dataclasses
import json
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
from stillray.model_spec.loader import FusedKernels, ImportanceNetwork, PyramidNetwork  # noqa: E402
from stillray.stages.prepare import prepare  # noqa: E402
from stillray_training.ablation import __main__ as command  # noqa: E402
from stillray_training.ablation import claims, measure, results, variants  # noqa: E402
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
    decoder = dataclasses.replace(
        variant.spec.decoder, kernel_sizes=variant.spec.decoder.kernel_sizes[:1]
    )
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
        assert spec.network.features == base.network.features
        seed = base.training.seed + (name == variants.OTHER_SEED)
        assert spec.training == dataclasses.replace(base.training, seed=seed), name
        assert spec.training.patch % kernels_of(spec).looks.alignment == 0, name


@pytest.mark.parametrize(
    ("name", "blocks", "sizes"),
    [
        ("wskp-6", 6, (3, 5, 7, 9, 11, 13)), ("wskp-3", 3, (3, 5, 7, 9, 11, 13)), ("KP", 6, (13,)),
        ("KP-1", 2, (13,)), ("KP-2", 5, (7,)), ("3 fused kernels", 6, (3, 5, 7)),
        ("one 11x11 kernel", 6, (11,)), ("6 kernels of 13x13", 6, (13,) * 6),
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
    assert outputs == (sizes[0] ** 2 if name.startswith("KP") else 2 * len(sizes))


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
    small = [tiny("wskp-6"), tiny("MR-KP")]
    monkeypatch.setattr(command, "study", lambda: small)
    out, report = tmp_path / "out", tmp_path / "page.md"
    steps = {"out": out, "data": [DATA], "validation": DATA, "height": 20, "width": 30}
    command.main(**steps, rounds=2, report=report, pictures=tmp_path / "pictures")
    page = report.read_text()
    assert "| wskp-6 | " in page
    assert "| MR-KP | " in page
    assert "Accumulation on and off" in page
    assert len(list((tmp_path / "pictures").glob("room-*.png"))) == 3
    found = results.read_results(small, out)
    assert found.size == (20, 30)
    assert set(found.mean("MR-KP")) == set(found.mean("wskp-6")) <= set(measure.METRICS)
    assert set(found.milliseconds["MR-KP"]) == {"network", "reconstruct", "both"}
    assert found.ratios["wskp-6"] == {"network": 1, "reconstruct": 1, "both": 1}
    # what is done is not done again
    files = [folder_of(one, out) / name for one in small for name in (CHECKPOINT, measure.SCORES)]
    before = [path.stat().st_mtime_ns for path in files]
    command.main(**steps)
    assert [path.stat().st_mtime_ns for path in files] == before
    # other weights are scored anew
    small[0] = tiny("wskp-6", steps=40)
    with pytest.raises(InputError, match="study as it is now"):
        command.main(**steps)
    (folder_of(small[0], out) / CHECKPOINT).unlink()
    command.main(**steps)
    after = [path.stat().st_mtime_ns for path in files]
    changed = [True, True, False, False]
    assert [old != new for old, new in zip(before, after, strict=True)] == changed


def found(scores, times=None):
    """Results of one scene and one part."""
    times = times or {}
    return results.Results(
        scores={name: {"room": {"psnr": psnr}} for name, psnr in scores.items()},
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
    ("paper", "here", "said"),
    [
        (-0.7, -0.4, "holds"),
        (-0.7, 0.4, "does not hold"),
        (-0.7, -0.05, "another seed changes as much"),
        (None, 0.4, "holds"),
        (None, -0.4, "does not hold"),
        (-0.01, 0.15, "holds"),
        (-0.01, 0.4, "does not hold"),
        (-0.01, -0.4, "does not hold"),
    ],
)
def test_a_finding_holds_when_ours_has_its_sign_and_is_more_than_noise(paper, here, said):
    claim = claims.Claim(text="", of="KP", to="wskp-6", paper=paper)
    ours = found({"KP": 30 + here, "wskp-6": 30.0, variants.OTHER_SEED: 30.1})
    noise = claims.spread(ours)
    assert noise == pytest.approx(0.1)
    assert claims.verdict(claim, claims.measured(claim, ours), noise) == said


@pytest.mark.parametrize(
    ("here", "said"), [(0.5, "holds"), (0.3, "less than that"), (0.9, "more than that")]
)
def test_times_hold_when_their_ratio_is_near(here, said):
    claim = claims.Claim(text="", of="KP", to="wskp-6", paper=0.46, times=True)
    ours = found({}, {"KP": here * 2, "wskp-6": 2.0})
    assert claims.verdict(claim, claims.measured(claim, ours), 0.1) == said


def test_the_page_says_what_is_missing(tmp_path):
    ours = found({"wskp-6": 25.0, "wskp-3": 24.0}, {"wskp-6": 1.0})
    write_page(variants.study(), ours, tmp_path / "page.md", "the command")
    page = (tmp_path / "page.md").read_text()
    missing = next(line for line in page.splitlines() if line.startswith("Not finished"))
    assert "KP-1" in missing
    assert "wskp-3" not in missing
    assert "| wskp-3 is below wskp-6 (table 1) | -0.69 | -1.00 | 0 of 1 | holds |" in page
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
    assert "six fused kernels are above one of 3x3 (figure 9) |  | +1.00 | 1 of 1 | holds |" in page
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
