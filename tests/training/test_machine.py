"""What a training runs on: other processes prepare the same batches, in the same order."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors import safe_open
from safetensors.torch import load_file

from stillray.errors import InputError
from stillray.model_spec import from_json
from stillray_training.checkpoint import CHECKPOINT
from stillray_training.machine import Batches, Machine
from stillray_training.upscaling import loop
from tests.training.test_upscaling import render, small


def drawn(step: int) -> list[dict[str, np.ndarray]]:
    """A batch of odd sizes, which differs from step to step."""
    rng = np.random.default_rng(step)
    return [
        {"a": rng.random((2, 3, 5), np.float32), "b": rng.random((1 + step % 3, 1), np.float32)}
        for _ in range(2)
    ]


@pytest.mark.parametrize("workers", [0, 2])
def test_batches_come_as_they_were_drawn_in_order(workers: int) -> None:
    batches = Batches(drawn, 9, Machine(workers=workers))
    for step in range(2, 9):
        found = batches(step)
        for ours, theirs in zip(found, drawn(step), strict=True):
            assert list(ours) == list(theirs)
            for name, array in theirs.items():
                np.testing.assert_array_equal(ours[name].numpy(), array)


def test_what_has_changed_is_drawn_anew_once_the_batches_are_forgotten() -> None:
    level = [1.0]
    batches = Batches(
        lambda step: {"x": np.float32([step * level[0]])}, 40, Machine(workers=2)
    )  # fmt: skip
    assert batches(3)["x"].item() == 3
    level[0] = 10.0
    batches.forget()
    assert batches(4)["x"].item() == 40


def test_other_processes_do_the_work() -> None:
    machine = Machine(workers=2)
    assert os.getpid() not in set(machine.made(lambda _: os.getpid(), range(4)))
    assert list(machine.made(lambda item: item * "x", [3, 1, 2])) == ["xxx", "x", "xx"]


@pytest.mark.parametrize("workers", [0, 2])
def test_what_is_refused_is_told_alike(workers: int) -> None:
    def refuse(item: int) -> int:
        if item == 2:
            raise InputError("item must not be 2, got 2")
        return item

    made = Machine(workers=workers).made(refuse, range(4))
    assert [next(made), next(made)] == [0, 1]
    with pytest.raises(InputError) as refusal:
        next(made)
    assert str(refusal.value) == "item must not be 2, got 2"


def test_a_training_with_workers_gives_the_same_weights(tmp_path: Path) -> None:
    render(tmp_path / "data" / "plane-0-0")
    spec = small(steps=2, batch=2, patch=16, frames=2)
    for workers in (0, 2):
        out = tmp_path / str(workers)
        loop.train_recurrent(spec, [tmp_path / "data"], out, machine=Machine(workers=workers))
    alone, helped = (load_file(tmp_path / part / CHECKPOINT) for part in ("0", "2"))
    for name, weights in alone.items():
        torch.testing.assert_close(helped[name], weights, rtol=0, atol=0)


def test_a_training_is_done_when_its_time_is_over(tmp_path: Path) -> None:
    render(tmp_path / "data" / "plane-0-0")
    spec = small(steps=10**9, batch=1, patch=16, frames=2)
    began = time.monotonic()
    machine = Machine(minutes=0.01)
    loop.train_recurrent(spec, [tmp_path / "data"], tmp_path / "run", machine=machine)
    assert time.monotonic() - began < 60
    with safe_open(tmp_path / "run" / CHECKPOINT, framework="pt") as file:
        told = file.metadata()
    # so many steps are the recipe that made it
    assert from_json(told["spec"]).training.steps == int(told["step"]) > 0


def test_a_step_without_a_finite_gradient_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    render(tmp_path / "data" / "plane-0-0")
    spec = small(steps=4, batch=1, patch=16, frames=2, average=0.9)
    right, calls = loop.sequence_loss, iter(range(4))

    def wrong_once(*given: Any) -> torch.Tensor:
        # infinite: 1 / 0
        return right(*given) / (next(calls) != 2)

    monkeypatch.setattr(loop, "sequence_loss", wrong_once)
    loop.train_recurrent(spec, [tmp_path / "data"], tmp_path / "run")
    weights = load_file(tmp_path / "run" / CHECKPOINT)
    assert all(torch.isfinite(value).all() for value in weights.values())


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("cpu", -1), "workers must be 0 or more, got -1"),
        (("cpu", 0, 0.0), "minutes must be above 0, got 0"),
        (("abacus", 0), "device must be one that PyTorch finds here, cpu or cuda, got abacus"),
    ],
)
def test_what_cannot_be_is_refused_in_a_line(given: tuple[object, ...], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Machine.named(*given)  # type: ignore[arg-type]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is such a device here")
def test_a_device_that_is_not_there_is_refused() -> None:
    with pytest.raises(InputError, match="got cuda: "):
        Machine.named("cuda", 0)
