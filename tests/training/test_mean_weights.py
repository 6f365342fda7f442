from __future__ import annotations

import json

import pytest

torch = pytest.importorskip("torch")

from stillray.errors import InputError  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.checkpoint import CHECKPOINT, load_network, save  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.mean_weights import mean_weights  # noqa: E402
from stillray_training.start import STARTED_FROM, read_start  # noqa: E402


@pytest.fixture
def run(tmp_path):
    spec = load("kpyr-5s")
    torch.manual_seed(0)
    network = FAMILIES[spec.family].network(spec)
    optimiser = torch.optim.Adam(network.parameters(), lr=1e-3)
    folder = tmp_path / "run"
    folder.mkdir()
    save(folder / CHECKPOINT, spec, network, optimiser, network, 7)
    (folder / "data.json").write_text("[]")
    return folder


@pytest.mark.parametrize("share", [0.0, 0.25, 1.0])
def test_the_mean_gives_a_share_to_each_model(run, tmp_path, share):
    mean_weights(run, "kpyr-5s", share, tmp_path / "out")
    spec = load("kpyr-5s")
    mixed, steps = load_network(spec, tmp_path / "out" / CHECKPOINT)
    own, _ = load_network(spec, run / CHECKPOINT)
    other = read_start("kpyr-5s").weights
    assert steps == 7
    for name, value in mixed.state_dict().items():
        wanted = share * own.state_dict()[name] + (1 - share) * other[name]
        torch.testing.assert_close(value, wanted, rtol=1e-5, atol=1e-6)
    record = json.loads((tmp_path / "out" / STARTED_FROM).read_text())
    assert record["model"] == "kpyr-5s"
    assert record["share_of_its_weights"] == pytest.approx(1 - share)


def test_a_share_out_of_range_is_refused(run, tmp_path):
    with pytest.raises(InputError, match=r"share must be in \[0, 1\], got 1.5"):
        mean_weights(run, "kpyr-5s", 1.5, tmp_path / "out")
