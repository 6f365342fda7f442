"""Training on patches of single frames; see `stillray_training.train` for what it leaves.

A model that looks at its last output learns on outputs of its own, which are renewed every so many
steps.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path

import torch
from rich.progress import Progress
from torch import Tensor, nn
from torch.utils._pytree import tree_map

from stillray.arrays.strips import Strips
from stillray.io.exr.read_write import atomic_path
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray_training.examples import NOISY, Example, load_examples, remembered
from stillray_training.families import FAMILIES, Family
from stillray_training.losses import (
    blur_error,
    displayed,
    dissimilarity,
    excess,
    filmic,
    per_patch,
    slope_error,
    smape,
    unsteadiness,
)
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import network_graph
from stillray_training.patches import Batch, PatchSampler
from stillray_training.run import Run, progress_bar, sequences_in

#: Whether the processor multiplies bfloat16 itself; where it does not, a step takes far longer.
HAS_BFLOAT16 = any(
    torch.cpu.get_capabilities().get(name) for name in ("avx512_bf16", "amx_bf16", "bf16")
)
PREVIOUS = "previous.onnx"  # the model whose outputs are the previous ones of a recurrence
_USUAL_ERROR = 0.25  # mean error as displayed of a patch of one sample a pixel
_QUIETEST = 0.01  # and what is added to it, so that a patch without noise does not count alone


def reconstruct_loss(
    network: nn.Module, batch: Batch, spec: ModelSpec, family: Family | None = None
) -> Tensor:
    """Error of the re-modulated result against the reference, both exposed."""
    family = family or FAMILIES[spec.family]
    take = {
        field.name: torch.from_numpy(getattr(batch, field.name))
        for field in dataclasses.fields(batch)
    }
    # channels last: the processor's convolutions of 16 channels run a third faster
    features = take["features"].contiguous(memory_format=torch.channels_last)
    with torch.autocast("cpu", torch.bfloat16, enabled=spec.training.bfloat16 and HAS_BFLOAT16):
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

    Raises
    ------
    InputError
        There are no finished sequences, or the checkpoint belongs to another spec.
    """
    sequences = sequences_in(data)
    family = family or FAMILIES[spec.family]
    recipe = spec.training
    torch.manual_seed(recipe.seed)
    network = family.network(spec)
    run = Run(spec, network, sequences, out)
    if start is not None:
        run.start_from(start)
    with progress_bar() as progress:
        # a list of its own: previous outputs are this model's
        examples = list(examples) or load_all(data, spec, progress)
        resumed = recipe.history_from and run.step > recipe.history_from
        if resumed and (run.step - recipe.history_from) % recipe.history_every:
            _refresh_past(examples, sequences, out / PREVIOUS, progress)
        sampler = PatchSampler(examples, spec)

        def renew(step: int) -> None:
            since = step - recipe.history_from
            if recipe.history_from and since >= 0 and since % recipe.history_every == 0:
                _export_for_previous_output(run.average, spec, out / PREVIOUS)
                _refresh_past(examples, sequences, out / PREVIOUS, progress)

        return run.finish(
            lambda step: reconstruct_loss(network, sampler.batch(step), spec, family),
            progress,
            before=renew,
            save_every=save_every,
        )


def load_all(data: list[Path], spec: ModelSpec, progress: Progress) -> list[Example]:
    """The examples of all sequences of some folders.

    Raises
    ------
    InputError
        There are no finished sequences.
    """
    sequences = sequences_in(data)
    loading = progress.add_task("load", total=len(sequences))
    loaded: dict[Path, list[Example]] = {}  # what is named twice takes memory once
    examples: list[Example] = []
    for sequence in sequences:
        if sequence not in loaded:
            loaded[sequence] = load_examples(sequence, spec, Strips(1))
        examples += loaded[sequence]
        progress.advance(loading)
    return examples


def _export_for_previous_output(network: nn.Module, spec: ModelSpec, path: Path) -> None:
    """Write the network as it is now, so that a resumed run sees the same previous outputs."""
    with atomic_path(path) as temporary:
        temporary.write_bytes(network_graph(fuse(network), spec, {}).SerializeToString())


def _refresh_past(
    examples: list[Example], sequences: list[Path], model: Path, progress: Progress
) -> None:
    """Give every example what a model remembers: one step of a recurrence, unrolled.

    Gradients stop at the previous output, which grows old until it is renewed; in return the
    recurrence costs nothing a step, and is as long as the sequence.
    """
    once = list(dict.fromkeys(sequences))  # data may be named twice, so that it counts twice
    task = progress.add_task("the past", total=len(once))
    places: dict[tuple[str, int], list[int]] = {}
    for index, example in enumerate(examples):
        if example.kind == NOISY:
            places.setdefault((example.sequence, example.frames), []).append(index)
    with Denoiser(model, threads=1) as denoiser:
        for sequence in once:
            for frames, found in remembered(sequence, denoiser, Strips(1)).items():
                for at in places[sequence.name, frames]:
                    examples[at] = dataclasses.replace(examples[at], **found._asdict())
            progress.advance(task)
    progress.remove_task(task)
