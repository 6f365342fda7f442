"""Training on patches of single frames; see `stillray_training.train` for what it leaves.

A model that looks at its last output learns on outputs of its own, which are renewed every so many
steps.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import torch
from rich.progress import Progress
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from stillray.arrays.strips import Strips
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray_training.examples import (
    NOISY,
    Example,
    Remembered,
    load_examples,
    remembered,
)
from stillray_training.families import FAMILIES, Family
from stillray_training.losses import (
    blur_error,
    displayed,
    dissimilarity,
    excess,
    filmic,
    mean_error,
    per_patch,
    slope_error,
    smape,
    unsteadiness,
)
from stillray_training.machine import Batches, Machine
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import network_graph
from stillray_training.patches import Batch, PatchSampler
from stillray_training.redrawn import Redrawn, draw_of
from stillray_training.run import Run, progress_bar, sequences_in

PREVIOUS = "previous.onnx"  # the model whose outputs are the previous ones of a recurrence
_USUAL_ERROR = 0.25  # mean error as displayed of a patch of one sample a pixel
_QUIETEST = 0.01  # and what is added to it, so that a patch without noise does not count alone


def reconstruct_loss(
    network: nn.Module,
    batch: Batch | Mapping[str, Tensor],
    spec: ModelSpec,
    family: Family | None = None,
) -> Tensor:
    """Error of the re-modulated result against the reference, both exposed."""
    family = family or FAMILIES[spec.family]
    arrays = vars(batch) if isinstance(batch, Batch) else batch
    take = {name: torch.as_tensor(array) for name, array in arrays.items()}
    # channels last: the processor's convolutions of 16 channels run a third faster
    features = take["features"].contiguous(memory_format=torch.channels_last)
    halves = spec.training.bfloat16 and Machine(features.device).has_bfloat16
    with torch.autocast(features.device.type, torch.bfloat16, enabled=halves):
        outputs = network(features)
    outputs = tree_map(Tensor.float, outputs)
    image = family.radiance(outputs, take, spec) * take["exposure"]
    reference = take["reference"] * take["exposure"]
    recipe = spec.training
    shown, wanted = displayed(image), displayed(reference)
    error = shown - wanted
    loss = recipe.smape_weight * smape(image, reference, recipe.smape_epsilon)
    loss = loss + recipe.display_weight * per_patch(error.abs())
    loss = loss + recipe.squared_weight * per_patch(error.square())
    if recipe.filmic_weight:
        # Meng et al. 2020, eq. 14
        loss = loss + recipe.filmic_weight * per_patch((filmic(image) - filmic(reference)).abs())
    if recipe.structure_weight:
        loss = loss + recipe.structure_weight * dissimilarity(shown, wanted)
    if recipe.slope_weight:
        loss = loss + recipe.slope_weight * slope_error(error)
    if recipe.blur_weight:
        loss = loss + recipe.blur_weight * blur_error(error)
    if recipe.mean_weight:
        loss = loss + recipe.mean_weight * mean_error(error)
    if recipe.steady_weight:
        before = displayed(take["previous"] * take["exposure"])
        change = unsteadiness(shown, wanted, before, take["valid"])
        loss = loss + recipe.steady_weight * change
    if recipe.hinge_weight or recipe.quiet_power:
        given = displayed(take["irradiance"] * take["divisor"] * take["exposure"])
        before = (given - wanted).abs()
        loss = loss + recipe.hinge_weight * excess(error.abs(), before)
        before = per_patch(before)
        # 1 for the noise of one sample a pixel
        loss = loss * ((before + _QUIETEST) / _USUAL_ERROR) ** -recipe.quiet_power
    return loss.mean()


def train(
    spec: ModelSpec,
    data: list[Path],
    out: Path,
    *,
    start: str | Path | None = None,
    save_every: int = 200,
    family: Family | None = None,
    examples: Sequence[Example] = (),
    machine: Machine | None = None,
) -> nn.Module:
    """Train until the recipe's last step; resumes from ``out`` if it holds a checkpoint.

    Parameters
    ----------
    spec
        The model and its recipe.
    data
        Folders of rendered sequences.
    out
        Folder for the checkpoint and the log; made if missing.
    start
        A similar model to start from, see `stillray_training.start`; None for random weights.
    save_every
        Steps between checkpoints.
    family
        Network and reconstruction; None for those of the spec's family.
    examples
        What `load_all` gave for the same data, to several trainings that see it alike; loaded here
        if there are none.
    machine
        What it runs on; None: this process and its processor.

    Raises
    ------
    InputError
        There are no finished sequences, or the checkpoint belongs to another spec.
    """
    sequences = sequences_in(data)
    family = family or FAMILIES[spec.family]
    recipe, machine = spec.training, machine or Machine()
    torch.manual_seed(recipe.seed)
    network = family.network(spec)
    run = Run(spec, network, sequences, out, machine.device, machine.minutes)
    if start is not None:
        run.start_from(start)
    with progress_bar() as progress:
        # a list of its own: previous outputs are this model's
        examples = list(examples) or load_all(data, spec, progress, machine, run.step)
        past = _Past(examples, sequences, out / PREVIOUS, machine)
        resumed = recipe.history_from and run.step > recipe.history_from
        if resumed and (run.step - recipe.history_from) % recipe.history_every:
            past.refresh(progress)
        redrawn = None
        if recipe.redraw_every:
            load = partial(_redraw, spec=spec)
            redrawn = Redrawn(examples, recipe.redraw_every, load)
        sampler = PatchSampler(examples, spec, redrawn)
        batches = Batches(lambda step: vars(sampler.batch(step)), recipe.steps, machine)

        def renew(step: int) -> None:
            since = step - recipe.history_from
            if recipe.history_from and since >= 0 and since % recipe.history_every == 0:
                _export_for_previous_output(run.average, spec, out / PREVIOUS)
                past.refresh(progress)
                batches.forget()

        return run.finish(
            lambda step: reconstruct_loss(network, batches(step), spec, family),
            progress,
            before=renew,
            save_every=save_every,
        )


def load_all(
    data: list[Path],
    spec: ModelSpec,
    progress: Progress,
    machine: Machine | None = None,
    step: int = 0,
) -> list[Example]:
    """The examples of all sequences of some folders, as they are drawn at a step.

    Raises
    ------
    InputError
        There are no finished sequences.
    """
    sequences = sequences_in(data)
    once = list(dict.fromkeys(sequences))  # what is named twice takes memory once
    loading = progress.add_task("load", total=len(once))
    loaded: dict[Path, list[Example]] = {}
    every = spec.training.redraw_every
    drawn = [(path, draw_of(turn, step, every, len(once))) for turn, path in enumerate(once)]
    made = (machine or Machine()).made(lambda each: _redraw(*each, spec=spec), drawn)
    for sequence, examples in zip(once, made, strict=True):
        loaded[sequence] = examples
        progress.advance(loading)
    return [example for sequence in sequences for example in loaded[sequence]]


def _redraw(sequence: Path, draw: int, *, spec: ModelSpec) -> list[Example]:
    return load_examples(sequence, spec, Strips(1), draw)


def _export_for_previous_output(network: nn.Module, spec: ModelSpec, path: Path) -> None:
    """Write the network as it is now, so that a resumed run sees the same previous outputs."""
    with atomic_path(path) as temporary:
        here = copy.deepcopy(network).cpu()
        temporary.write_bytes(network_graph(fuse(here), spec, {}).SerializeToString())


class _Past:
    """Gives examples what a model remembers: one step of a recurrence, unrolled.

    Gradients stop at the previous output, which grows old until it is renewed; in return the
    recurrence costs nothing a step, and is as long as the sequence.

    Parameters
    ----------
    examples
        Of all sequences; those with a past are replaced.
    sequences
        Where they are from.
    model
        The file of the model that remembers.
    machine
        Who runs it.
    """

    def __init__(
        self, examples: list[Example], sequences: list[Path], model: Path, machine: Machine
    ) -> None:
        self._examples, self._model, self._machine = examples, model, machine
        self._once = list(dict.fromkeys(sequences))  # data may be named twice, to count twice
        self._places: dict[tuple[Path, int], list[int]] = {}
        for index, example in enumerate(examples):
            if example.kind == NOISY:
                self._places.setdefault((example.sequence, example.frames), []).append(index)

    def refresh(self, progress: Progress) -> None:
        """Run the model as it is in its file over all sequences."""
        task = progress.add_task("the past", total=len(self._once))
        share = -(-len(self._once) // max(self._machine.workers, 1))
        parts = [self._once[at : at + share] for at in range(0, len(self._once), share)]
        for part, of_part in zip(parts, self._machine.made(self._remembered, parts), strict=True):
            for sequence, of_sequence in zip(part, of_part, strict=True):
                for frames, found in of_sequence.items():
                    for at in self._places[sequence, frames]:
                        self._examples[at] = dataclasses.replace(
                            self._examples[at], **found._asdict()
                        )
                progress.advance(task)
        progress.remove_task(task)

    def _remembered(self, sequences: list[Path]) -> list[dict[int, Remembered]]:
        with Denoiser(self._model, threads=1) as denoiser:
            return [remembered(sequence, denoiser, Strips(1)) for sequence in sequences]
