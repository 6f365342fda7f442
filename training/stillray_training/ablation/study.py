"""Trains and scores the variants of the study; what is finished is not done again."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.progress import Progress
from safetensors import safe_open

from stillray.errors import InputError
from stillray.model_spec.loader import from_json
from stillray_training.ablation.variants import Variant
from stillray_training.checkpoint import CHECKPOINT
from stillray_training.examples import STILL
from stillray_training.patch_training import load_all, train


def folder_of(variant: Variant, out: Path) -> Path:
    """Where a variant's checkpoint and log lie."""
    name = "".join(c if c.isalnum() or c == "-" else "_" for c in variant.name)
    return out / (name if variant.seed == 1 else f"{name}-seed-{variant.seed}")


def steps_done(variant: Variant, out: Path) -> int:
    """Steps that a variant has been trained for.

    Raises
    ------
    InputError
        Its checkpoint is of another specification or recipe.
    """
    path = folder_of(variant, out) / CHECKPOINT
    if not path.is_file():
        return 0
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    # not by the text, which lacks what specifications did not know when it was written
    if from_json(metadata["spec"]) != variant.spec:
        raise InputError(f"{path}: the checkpoint must be of the study as it is now: remove it")
    return int(metadata["step"])


def is_finished(variant: Variant, out: Path) -> bool:
    """Whether a variant has been trained for all of its steps."""
    return steps_done(variant, out) >= variant.spec.training.steps


def train_all(variants: Sequence[Variant], data: list[Path], out: Path) -> None:
    """Train every variant that is not finished, all of a seed on the same patches.

    Parameters
    ----------
    variants
        They read the same features of frames that are prepared alike. A seed changes the weights
        that a training begins with and the patches it draws, not the examples that patches are of.
    data
        Folders of rendered sequences.
    out
        Folder of the study; a folder in it for every variant.

    Raises
    ------
    InputError
        There are no sequences, or a checkpoint is of another study, or variants for many samples
        are asked for and no sequence comes in blocks of samples.
    """
    pending = [variant for variant in variants if not is_finished(variant, out)]
    if not pending:
        return
    with Progress(transient=not sys.stderr.isatty()) as progress:
        # what is prepared depends on tables that all variants share, and on the first one's seed
        examples = load_all(data, pending[0].with_seed(1).spec, progress)
    if any(variant.stills for variant in pending) and all(one.kind != STILL for one in examples):
        raise InputError(
            "data must hold sequences of several blocks of samples for variants of many samples, "
            f"got none in {', '.join(map(str, data))}"
        )
    for variant in pending:
        print(f"{variant.name}, seed {variant.seed}", file=sys.stderr, flush=True)
        train(
            variant.spec,
            data,
            folder_of(variant, out),
            family=variant.family,
            examples=examples,
        )
