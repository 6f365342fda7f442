"""Taking over the weights of a similar model, so that training goes on from what it knows."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import onnx
import torch
from onnx import numpy_helper
from safetensors import safe_open
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.nn import functional as F

from stillray.errors import InputError
from stillray.model_spec import ModelSpec, from_json
from stillray.models.registry import ModelInfo, find_model
from stillray_training.families import network_of
from stillray_training.networks.repvgg import RepVGGBlock

_FURTHER_OUT = 2.0  # what a new filter's logit of the pixel itself is above that of its model
STARTED_FROM = "started_from.json"  # beside a checkpoint: the model whose weights were taken over


@dataclass(frozen=True)
class Start:
    """A model to start from.

    Attributes
    ----------
    features
        What its network reads, in order.
    planes
        What the planes of its network's heads are for, by the names of the heads, where told.
    weights
        By name, as a network in training holds them.
    origin
        Name and steps of the model, and of what that was started from in its turn; for a model
        that was exported its data and their credits too. Goes into the provenance.
    """

    features: tuple[str, ...]
    planes: Mapping[str, list[str]]
    weights: Mapping[str, Tensor]
    origin: dict[str, Any]


def read_start(source: str | Path) -> Start:
    """The weights of a checkpoint, of an exported model, or of one that comes with stillray.

    Parameters
    ----------
    source
        Path of a checkpoint or of an ``.onnx`` file, or the name of a packaged model. A checkpoint
        has the branches of RepVGG blocks; an exported model has them added up, and gives all to
        the largest.

    Raises
    ------
    InputError
        There is no such file or model, or it is none of stillray's.
    """
    path = Path(source)
    if path.is_file() and path.suffix != ".onnx":
        return _of_checkpoint(path)
    try:
        return _of_model(source)
    except InputError as error:
        raise InputError(
            f"start must be a checkpoint, an .onnx file or a packaged model, got {source}: {error}"
        ) from None


def _of_checkpoint(path: Path) -> Start:
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    before = from_json(metadata["spec"])
    origin = {"model": before.name, "steps": int(metadata["step"])}
    earlier = path.parent / STARTED_FROM
    if earlier.is_file():
        origin["started_from"] = json.loads(earlier.read_text())
    tensors = load_file(path)
    # their mean over steps, where it was kept
    prefix = "average." if any(name.startswith("average.") for name in tensors) else "network."
    weights = {
        name.removeprefix(prefix): value
        for name, value in tensors.items()
        if name.startswith(prefix)
    }
    planes = getattr(network_of(before), "planes", {})
    return Start(before.network.features, planes, weights, origin)


def _of_model(source: str | Path) -> Start:
    info = find_model(source)
    network = network_of(info.spec)
    unfuse(
        network,
        {
            # the export clips logits in a module around the network
            tensor.name.removeprefix("network."): torch.tensor(numpy_helper.to_array(tensor))
            for tensor in onnx.load(info.path).graph.initializer
        },
    )
    weights = network.state_dict()
    planes = getattr(network, "planes", {})
    return Start(info.spec.network.features, planes, weights, origin_of(info))


def origin_of(info: ModelInfo) -> dict[str, Any]:
    """What a provenance tells of a model whose weights were taken over."""
    known = ("steps", "data", "credits", "started_from")
    about = {key: info.provenance[key] for key in known if key in info.provenance}
    return {"model": info.name, **about}


def unfuse(network: nn.Module, fused: Mapping[str, Tensor]) -> None:
    """Fill a network for training with the weights of one that was fused.

    `stillray_training.networks.fuse` did that.

    Parameters
    ----------
    network
        Overwritten: it then computes what the fused network does.
    fused
        Weights by their names there.

    Raises
    ------
    InputError
        A weight is missing.
    """

    def taken(name: str) -> tuple[Tensor, Tensor]:
        try:
            return fused[f"{name}.weight"], fused[f"{name}.bias"]
        except KeyError as error:
            raise InputError(
                f"its graph must hold the weights of its spec, lacks {error}"
            ) from None

    within: tuple[str, ...] = ()  # convolutions that are branches of a block
    with torch.no_grad():
        for name, module in network.named_modules():
            if isinstance(module, RepVGGBlock):
                within += (f"{name}.",)
                # a ReLU makes a sequence of the one convolution
                module.unfuse(*taken(f"{name}.0" if module.activation else name))
            elif isinstance(module, nn.Conv2d) and not name.startswith(within):
                assert module.bias is not None
                for parameter, value in zip((module.weight, module.bias), taken(name), strict=True):
                    parameter.copy_(value)


def start_from(source: str | Path, network: nn.Module, spec: ModelSpec) -> dict[str, Any]:
    """Take over the weights of a similar model: features by name, planes that are new stay random.

    Parameters
    ----------
    source
        See `read_start`. A model of the same family and widths, or of a kernel pyramid of lesser
        ones (the planes that are new begin at random, and unread by the others); it may have read
        other features, which are matched by name (those that it did not read begin with weights of
        0), have given other logits (those of a kernel pyramid are matched by what they are for,
        those of a filter that is new begin near those of the next, of other families new ones are
        appended), fewer blocks of a width that an identity spans (new ones begin as that identity),
        and fewer layers in its dense block (what new ones add begins with weights of 0). Where the
        first block has an identity, features stay in their places.
    network, spec
        What is to be trained.

    Returns
    -------
    dict
        The model that was taken over, see `Start.origin`.

    Raises
    ------
    InputError
        The weights do not fit.
    """
    start = read_start(source)
    features = start.features
    heads = getattr(network, "planes", {})
    reads_more: Mapping[str, int] = getattr(network, "reads_more", {})
    state = network.state_dict()
    reads_features = str(getattr(network, "reads_features", ""))
    if features != spec.network.features and not _matches_features(network, reads_features):
        raise InputError(
            f"start must read the features of {spec.name} in their order, whose network takes them "
            f"by their places, got {', '.join(features)}"
        )
    for name, given in start.weights.items():
        value, target = given, state.get(name, torch.empty(0))
        if not (reads_features and name.startswith(reads_features)):
            value = _among_more(value, target, reads_more, name)
        head = name.rpartition(".")[0]
        if head in heads and head in start.planes and value.shape[1:] == target.shape[1:]:
            ours, theirs = heads[head], start.planes[head]
            for plane, use in zip(target, ours, strict=True):
                like, more = (use, 0.0) if use in theirs else _filter_like(use, theirs)
                if like is not None:
                    plane.copy_(value[theirs.index(like)])
                    if value.ndim == 1:  # a bias
                        plane += more
            continue
        fits = len(value) <= len(target)
        if fits and reads_features and name.startswith(reads_features) and value.ndim == 4:
            # where blocks of pixels are read as one, every feature is several planes
            each = target.shape[1] // len(spec.network.features)
            fits = value.shape[1] == each * len(features) and value.shape[2:] == target.shape[2:]
            if fits:
                read = [features.index(f) if f in features else -1 for f in spec.network.features]
                matched = value.unflatten(1, (len(features), each))[:, read]
                matched[:, [index < 0 for index in read]] = 0
                value = matched.flatten(1, 2)
        if not fits or value.shape[1:] != target.shape[1:]:
            raise InputError(
                f"start must have weights that fit {spec.name}, {source} does not: {name}"
            )
        target[: len(value)] = value
    for name, module in network.named_modules():
        if isinstance(module, RepVGGBlock) and module.identity:
            parts = [f"{name}.{part}" for part, _ in module.named_parameters()]
            if not any(part in start.weights for part in parts):
                for part in parts:
                    state[part].zero_()
    network.load_state_dict(state)
    return start.origin


def _among_more(value: Tensor, target: Tensor, reads_more: Mapping[str, int], name: str) -> Tensor:
    """A convolution that reads more planes than it did: those that are new weigh 0.

    Parameters
    ----------
    value, target
        Kernels ``(out, in, k, k)``, as they were and of the shape that is asked for; anything else
        is given back as it is.
    reads_more
        Which may, by the beginning of the name, and how many maps of planes they read as one.
    name
        Of the kernels.
    """
    if value.ndim != 4 or value.shape[2:] != target.shape[2:]:
        return value
    maps = next((count for begins, count in reads_more.items() if name.startswith(begins)), 0)
    more = (target.shape[1] - value.shape[1]) // maps if maps else 0
    if more <= 0:
        return value
    return F.pad(value.unflatten(1, (maps, -1)), (0, 0, 0, 0, 0, more)).flatten(1, 2)


def _filter_like(use: str, known: list[str]) -> tuple[str | None, float]:
    """The known filter that is nearest to a new one, and what is added to the new one's bias.

    A pass further out looks for what looks alike as the next one does, and takes less of it.
    """
    asked = re.fullmatch(r"filters: (\d+) (.+)", use)
    if asked is None:
        return None, 0.0
    far, who = int(asked[1]), asked[2]
    others = [other for other in known if re.fullmatch(rf"filters: \d+ {who}", other)]
    nearest = min(others, key=lambda other: abs(int(other.split()[1]) - far), default=None)
    return nearest, _FURTHER_OUT if who.startswith("itself") else 0.0


def _matches_features(network: nn.Module, reads_features: str) -> bool:
    """Whether features enter by one layer without an identity, which may take them in any order."""
    if not reads_features:
        return False
    entry = network.get_submodule(reads_features.rstrip("."))
    return not (isinstance(entry, RepVGGBlock) and entry.identity)
