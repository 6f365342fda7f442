"""A training under way: what learns, how far it is, and the folder that it is resumed from."""

from __future__ import annotations

import copy
import dataclasses
import json
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import torch
from rich.progress import MofNCompleteColumn, Progress, TimeRemainingColumn
from torch import Tensor, nn

from stillray.errors import InputError
from stillray.model_spec import ModelSpec
from stillray_training.checkpoint import CHECKPOINT, restore, save
from stillray_training.examples import find_sequences
from stillray_training.loss_log import LOG, LOG_EVERY, forget_after, log_loss
from stillray_training.provenance import record_data
from stillray_training.schedule import follow, learning_rate, optimiser_of
from stillray_training.start import STARTED_FROM, start_from


class Run:
    """A training that stops and goes on at any step.

    Parameters
    ----------
    spec
        The model and its recipe.
    network
        What learns; takes the weights of the checkpoint in ``out``, if there is one.
    sequences
        What it learns from, for the record.
    out
        Folder for the checkpoint, the log and the records; made if missing.
    device
        Where it learns.
    minutes
        After which it is done, however many steps that were; none for all steps.

    Attributes
    ----------
    average
        The running mean of the weights, which is kept; the network itself if the recipe has none.
    step
        How many are done.
    dropped
        How many of those have changed nothing, since their gradient was not finite.

    Raises
    ------
    InputError
        The checkpoint belongs to another spec or optimiser.
    """

    def __init__(
        self,
        spec: ModelSpec,
        network: nn.Module,
        sequences: Sequence[Path],
        out: Path,
        device: torch.device | None = None,
        minutes: float = float("inf"),
    ) -> None:
        # before there are moments, which lie where their weights do
        self._spec, self._network, self._out = spec, network.to(device), out
        self._seconds, self._began = 60 * minutes, time.monotonic()
        self._optimiser = optimiser_of(network, spec.training)
        self.average = copy.deepcopy(network) if spec.training.average else network
        out.mkdir(parents=True, exist_ok=True)
        self.step = restore(out / CHECKPOINT, spec, network, self._optimiser, self.average)
        self.dropped = 0
        forget_after(out / LOG, self.step)
        record_data(out, sequences)

    def start_from(self, model: str | Path) -> None:
        """Take over the weights of a similar model, unless the run is past its beginning."""
        if self.step == 0:
            origin = start_from(model, self._network, self._spec)
            (self._out / STARTED_FROM).write_text(json.dumps(origin, indent=1))
            self.average.load_state_dict(self._network.state_dict())

    @property
    def done(self) -> float:
        """Part of the training that is done, of its steps or of its time, whichever is more."""
        of_time = (time.monotonic() - self._began) / self._seconds
        return min(max(self.step / self._spec.training.steps, of_time), 1.0)

    def finish(
        self,
        loss_at: Callable[[int], Tensor],
        progress: Progress,
        *,
        before: Callable[[int], None] = lambda step: None,
        most_gradient: float = float("inf"),
        save_every: int = 200,
    ) -> nn.Module:
        """All steps that are left; the network that is kept.

        Parameters
        ----------
        loss_at
            The loss of a step.
        progress
            Where the steps are shown.
        before
            What is done before each step.
        most_gradient
            Norm of the gradient beyond which it is made shorter.
        save_every
            Steps between checkpoints.
        """
        recipe = self._spec.training
        task = progress.add_task(self._spec.name, total=recipe.steps, completed=self.step)
        losses: list[Tensor] = []  # read at last: a device that is asked waits
        self._began = time.monotonic()
        while self.done < 1:
            before(self.step)
            losses.append(self._learn(loss_at(self.step), most_gradient))
            self.step += 1
            progress.advance(task)
            if self.step % LOG_EVERY == 0:
                seconds = time.monotonic() - self._began
                log_loss(self._out / LOG, self.step, float(torch.stack(losses).nanmean()), seconds)
                losses = []
            if self.step % save_every == 0:
                self._save()
        if self.step < recipe.steps:  # time has ended it: so many steps are the recipe
            recipe = dataclasses.replace(recipe, steps=self.step)
            self._spec = dataclasses.replace(self._spec, training=recipe)
            self._save()
        elif self.step % save_every:
            self._save()
        if self.dropped:
            progress.console.print(f"{self.dropped} steps were dropped: no finite gradient")
        return self.average

    def _learn(self, loss: Tensor, most_gradient: float) -> Tensor:
        """One step of the optimiser; the loss."""
        for group in self._optimiser.param_groups:
            group["lr"] = learning_rate(self.step, self.done, self._spec.training)
        self._optimiser.zero_grad()
        loss.backward()  # type: ignore[no-untyped-call]
        if most_gradient < float("inf"):
            norm = torch.nn.utils.clip_grad_norm_(self._network.parameters(), most_gradient)
            if not torch.isfinite(norm):  # one such step, and nothing is left of the weights
                self.dropped += 1
                return loss.new_full((), torch.nan)
        self._optimiser.step()
        if self.average is not self._network:
            decay = min(self._spec.training.average, self.step / (self.step + 10))
            follow(self.average, self._network, decay)
        return loss.detach()

    def _save(self) -> None:
        path = self._out / CHECKPOINT
        save(path, self._spec, self._network, self._optimiser, self.average, self.step)


def sequences_in(data: Sequence[Path]) -> list[Path]:
    """All finished sequences of some folders.

    Raises
    ------
    InputError
        There are none.
    """
    sequences = [path for folder in data for path in find_sequences(folder)]
    if not sequences:
        raise InputError(
            f"data must hold finished sequences, got {', '.join(map(str, data))}; stillray-gather "
            "makes them of renders of your own"
        )
    return sequences


def progress_bar() -> Progress:
    """Steps done, of all, and the time that is left; nothing stays on a terminal's end."""
    return Progress(
        *Progress.get_default_columns()[:3],
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        transient=not sys.stderr.isatty(),
    )
