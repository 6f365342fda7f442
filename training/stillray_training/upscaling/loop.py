"""Recurrent training of a model that denoises and upscales (Kazmierczyk et al. 2025, 4.2 and 4.3).

differs: the perceptual term is one minus structural similarity as displayed, since LPIPS is made of
weights that would have to be downloaded: it knows contrasts and edges, and not what textures look
like. References of few samples are made smooth by Open Image Denoise
(`stillray_training.targets`); the paper's have 8192 samples. Gradients reach
back over the frames that are learned from; those before (``warm_frames``) make pasts longer for
a third of the price.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path

import torch
from torch import Tensor, nn

from stillray.arrays.strips import Strips
from stillray.families.feature_filters import FeatureFiltersModel
from stillray.model_spec import ModelSpec
from stillray.model_spec.training import Training
from stillray_training.decoders.feature_filters import Remembered
from stillray_training.losses import (
    blur_error,
    displayed,
    dissimilarity,
    per_patch,
    slope_error,
    smape,
)
from stillray_training.machine import Batches, Machine
from stillray_training.networks.multi_branch import multi_branch_net
from stillray_training.run import Run, progress_bar, sequences_in
from stillray_training.upscaling.clip import Clip, load_clip
from stillray_training.upscaling.clips import ClipSampler, Sample
from stillray_training.upscaling.unroll import step as unrolled_step
from stillray_training.upscaling.unroll import warped

_MOST_GRADIENT = 1.0  # norm: recurrences have steep walls


def sequence_loss(
    network: nn.Module,
    batch: Sequence[Sample | Mapping[str, Tensor]],
    spec: ModelSpec,
    progress: float = 0.0,
) -> Tensor:
    """Mean loss over the last frames of a batch, as many as the recipe has; no gradient goes
    further back. Of a patch those frames count that have a reference.

    Parameters
    ----------
    network
        In training.
    batch
        Of `ClipSampler`, arrays or tensors.
    spec
        The model and its recipe.
    progress
        Part of the training that is done: the temporal term's weight doubles over it.
    """
    rules, names = FeatureFiltersModel(spec).rules, spec.network.features
    before: Remembered | None = None
    last: Mapping[str, Tensor] | None = None
    total = count = torch.zeros(())
    warm = len(batch) - spec.training.frames
    for index, sample in enumerate(batch):
        frame = {name: torch.as_tensor(array) for name, array in sample.items()}
        if index < warm:
            with torch.no_grad():
                _, before, _ = unrolled_step(network, frame, before, names, rules)
            last = frame
            continue
        image, before, recalled = unrolled_step(network, frame, before, names, rules)
        known, earlier, last = frame["known"].flatten(), last, frame
        if not known.any():  # of sequences with one reference, all but their last
            continue
        loss = frame_loss(image, before, frame, spec.training)
        if recalled is not None and earlier is not None:
            was = warped(earlier["wanted"], frame["positions"]) * frame["inside"]
            change = temporal_loss((image, recalled), (frame["wanted"], was), frame)
            weight = spec.training.steady_weight * (1 + progress)
            loss = loss + weight * earlier["known"].flatten() * change
        total, count = total + known * loss, count + known
    return (total / count).mean()


def frame_loss(
    image: Tensor, after: Remembered, frame: Mapping[str, Tensor], recipe: Training
) -> Tensor:
    """Spatial and perceptual loss of each patch, ``(n,)``: of the picture and both albedos."""
    exposed, wanted = image * frame["exposure"], frame["wanted"] * frame["exposure"]
    loss = smape(exposed, wanted, recipe.smape_epsilon)
    for albedo, name in ((after.albedo, "wanted_albedo"), (after.specular, "wanted_specular")):
        loss = loss + recipe.albedo_weight * per_patch((albedo[:, :3] - frame[name]).abs())
    shown, right = displayed(exposed), displayed(wanted)
    error = shown - right
    loss = loss + recipe.display_weight * per_patch(error.abs())
    loss = loss + recipe.squared_weight * per_patch(error.square())
    if recipe.slope_weight:
        loss = loss + recipe.slope_weight * slope_error(error)
    if recipe.blur_weight:
        loss = loss + recipe.blur_weight * blur_error(error)
    return loss + recipe.structure_weight * dissimilarity(shown, right)


def temporal_loss(
    images: tuple[Tensor, Tensor], wanted: tuple[Tensor, Tensor], frame: Mapping[str, Tensor]
) -> Tensor:
    """L1 of how a picture changes against how its reference does, of each patch, ``(n,)``.

    Parameters
    ----------
    images, wanted
        Radiance of this frame, and of the last at its pixels.
    frame
        Its exposure, and where the last frame is known.
    """

    def change(pair: tuple[Tensor, Tensor]) -> Tensor:
        now, was = (displayed(part * frame["exposure"]) for part in pair)
        return now - was

    return per_patch((change(images) - change(wanted)).abs() * frame["inside"])


def train_recurrent(
    spec: ModelSpec,
    data: list[Path],
    out: Path,
    *,
    start: str | Path | None = None,
    save_every: int = 200,
    network: Callable[[ModelSpec], nn.Module] = multi_branch_net,
    clips: Sequence[Clip] = (),
    machine: Machine | None = None,
) -> nn.Module:
    """Train until the recipe's last step; resumes from ``out`` if it holds a checkpoint.

    Parameters
    ----------
    spec
        The model and its recipe.
    data
        Folders of rendered sequences with a reference of every frame.
    out
        Folder for the checkpoint and the log; made if missing.
    start
        The same model to go on from, see `stillray_training.start`; None for random weights.
    save_every
        Steps between checkpoints.
    network
        Makes what learns.
    clips
        What `load_clips` gave for the same data, to several trainings; loaded here if there are
        none.
    machine
        What it runs on; None: this process and its processor.

    Raises
    ------
    InputError
        There are no finished sequences, one lacks what the model learns from, or the checkpoint
        belongs to another spec.
    """
    sequences = sequences_in(data)
    recipe, machine = spec.training, machine or Machine()
    torch.manual_seed(recipe.seed)
    learner = network(spec)
    run = Run(spec, learner, sequences, out, machine.device, machine.minutes)
    if start is not None:
        run.start_from(start)
    sampler = ClipSampler(list(clips) or load_clips(data, spec, machine), spec)
    batches = Batches(sampler.batch, recipe.steps, machine)
    with progress_bar() as progress:
        return run.finish(
            lambda step: sequence_loss(learner, batches(step), spec, run.done),
            progress,
            most_gradient=_MOST_GRADIENT,
            save_every=save_every,
        )


def load_clips(data: list[Path], spec: ModelSpec, machine: Machine | None = None) -> list[Clip]:
    """The clips of all sequences of some folders.

    Raises
    ------
    InputError
        There are no finished sequences, or one lacks what the model learns from.
    """
    sequences = sequences_in(data)
    loaded = (machine or Machine()).made(partial(load_clip, spec=spec, strips=Strips(1)), sequences)
    with progress_bar() as progress:
        return list(progress.track(loaded, total=len(sequences), description="load"))
