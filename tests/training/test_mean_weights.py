from __future__ import annotations

import dataclasses
import json

import pytest

torch = pytest.importorskip("torch")

from safetensors import safe_open  # noqa: E402
from safetensors.torch import load_file, save_file  # noqa: E402

from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.checkpoint import CHECKPOINT, load_network, save  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.mean_weights import mean_weights  # noqa: E402
from stillray_training.start import STARTED_FROM, read_start  # noqa: E402


def run_of(spec, folder):
    torch.manual_seed(0)
    network = FAMILIES[spec.family].network(spec)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    folder.mkdir()
    save(folder / CHECKPOINT, spec, network, optimiser, network, 7)
    (folder / "data.json").write_text("[]")
    return folder


def metadata_of(path):
    with safe_open(path, framework="pt") as file:
        return file.metadata()


def plain():
    """`kpyr-5s` without the filters that its weights of before had not."""
    spec = load("kpyr-5s")
    decoder = dataclasses.replace(spec.decoder, finest_filters=(), filter_features=0)
    return dataclasses.replace(spec, decoder=decoder)


@pytest.fixture
def run(tmp_path):
    return run_of(plain(), tmp_path / "run")


@pytest.fixture
def before(tmp_path):
    return run_of(plain(), tmp_path / "before") / CHECKPOINT


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_mean_gives_a_share_to_each_model(run, before, tmp_path, share):
    tensors = {name: value + 1 for name, value in load_file(before).items()}
    save_file(tensors, before, metadata=metadata_of(before))
    mean_weights(run, str(before), share, tmp_path / "out")
    mixed, steps = load_network(plain(), tmp_path / "out" / CHECKPOINT)
    own, _ = load_network(plain(), run / CHECKPOINT)
    assert steps == 7
    for name, value in mixed.state_dict().items():
        wanted = own.state_dict()[name] + (1 - share)
        torch.testing.assert_close(value, wanted, rtol=1e-5, atol=1e-6)
    record = json.loads((tmp_path / "out" / STARTED_FROM).read_text())
    assert record["model"] == "kpyr-5s"
    assert record["share_of_its_weights"] == pytest.approx(1 - share)


def test_logits_that_the_model_before_does_not_give_stay_the_runs(before, tmp_path):
    spec = plain()
    decoder = dataclasses.replace(spec.decoder, finest_filters=(2,), filter_features=3)
    spec = dataclasses.replace(spec, decoder=decoder)
    run = run_of(spec, tmp_path / "run")
    mean_weights(run, str(before), 0.0, tmp_path / "out")
    mixed, _ = load_network(spec, tmp_path / "out" / CHECKPOINT)
    own, _ = load_network(spec, run / CHECKPOINT)
    earlier = read_start(before).weights["heads.0.weight"]
    got, whole = mixed.heads[0].weight, own.heads[0].weight
    torch.testing.assert_close(got[: len(earlier)], earlier)
    torch.testing.assert_close(got[len(earlier) :], whole[len(earlier) :])
    assert len(got) > len(earlier)


def test_a_share_out_of_range_is_refused(run, tmp_path):
    with pytest.raises(InputError, match=r"share must be in \[0, 1\], got 1.5"):
        mean_weights(run, "kpyr-5s", 1.5, tmp_path / "out")
