"""From a model's name to what runs it: a network between stages, or a graph of all of them."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from pathlib import Path

from stillray.errors import InputError
from stillray.families.contract import Engine, Family
from stillray.families.frame_graph import FrameGraphModel
from stillray.families.registry import FAMILIES
from stillray.model_spec.loader import ModelSpec
from stillray.models.frame_session import FrameSession, device_of
from stillray.models.network import Network
from stillray.models.precision import chosen, quickest
from stillray.models.registry import (
    ModelInfo,
    find_frame_model,
    find_model,
    is_frame_graph,
    require_fit,
    steps_of,
)
from stillray.models.session import Provider, provider_names, read_checked

Providers = tuple[Provider, ...] | None


def model_of(model: str | os.PathLike[str] | ModelInfo) -> ModelInfo:
    """A model that is named, or the path of whose network or frame graph is given.

    Raises
    ------
    InputError
        There is none: the message says which there are, or how to make a frame graph. Or it is
        named by no text or path.
    """
    if isinstance(model, ModelInfo):
        return model
    if not isinstance(model, str | os.PathLike):
        raise InputError(
            f"model must be a name, the path of an .onnx file or a ModelInfo, got {model!r}"
        )
    return find_frame_model(model) if is_frame_graph(model) else find_model(model)


def family_of_model(
    model: ModelInfo,
    providers: Providers = None,
    families: Mapping[str, Callable[[ModelSpec], Family]] = FAMILIES,
) -> Family:
    """What decides and steps for a model.

    Parameters
    ----------
    model
        From `model_of`.
    providers
        That run it, of which a frame graph's stage tells.
    families
        What makes a family's model of its specification.

    Raises
    ------
    InputError
        The model is a frame graph that does not take frames, or gives no picture.
    """
    if model.ports is None:
        return families[model.family](model.spec)
    device, number = device_of(providers)
    memory = "main memory" if device == "cpu" else f"{device}:{number}"
    where = f"{', '.join(provider_names(providers))}, its state kept in {memory}"
    return FrameGraphModel(model.ports, where)


def engine_of_model(
    model: ModelInfo, threads: int, providers: Providers, network: Path | None = None
) -> Engine:
    """Where a model's graphs run.

    Parameters
    ----------
    model
        From `model_of`.
    threads, providers
        As `stillray.Denoiser` takes them.
    network
        From `network_path`; None for the model's own.

    Raises
    ------
    InputError
        Its file cannot be used, or a provider is not there.
    """
    if model.ports is not None:
        return FrameSession(model.path, threads=threads, providers=providers)
    steps, path = steps_of(model.family), network or model.path
    if path != model.path:
        path = quickest(path)
        require_fit(read_checked(path)[1], model.spec, path)
    return Network(path, threads=threads, providers=providers, steps=steps)


def network_path(model: ModelInfo, precision: str, providers: Providers = None) -> Path:
    """The file that runs for a model, see `stillray.models.precision.chosen`; of a frame graph its
    own.

    Raises
    ------
    InputError
        There is no such precision of it.
    """
    if model.ports is None or precision not in ("auto", "float32"):
        return chosen(model.path, precision, providers)
    return model.path
