"""The models that come with stillray, and any other .onnx file made by its export."""

from __future__ import annotations

import json
import os
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from numbers import Integral
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.model_spec.loader import ModelSpec, from_json, load
from stillray.model_spec.network_outputs import network_outputs
from stillray.model_spec.network_weights import network_weights
from stillray.model_spec.rules import SpecError
from stillray.models.frame_graph import (
    FRAME_SUFFIX,
    SPATIAL_SUFFIX,
    Ports,
    find_frame_graph,
    read_frame_graph,
)
from stillray.models.network_graph import Interface, Planes
from stillray.models.precision import INT8_SUFFIX, PAIRS_SUFFIX
from stillray.models.session import read_checked

SPEC_KEY = "stillray.spec"
PROVENANCE_KEY = "stillray.provenance"
_MAX_PROVENANCE = 2**20  # characters
_MAX_SCORE = 1e12


#: What runs unless another model is named, in Python and on the command line.
DEFAULT_MODEL = "high"


@dataclass(frozen=True, kw_only=True)
class ModelInfo:
    """What there is to know about a model without loading it for inference."""

    name: str
    family: str
    summary: str
    aliases: tuple[str, ...]
    path: Path
    parameters: int
    size_bytes: int
    inputs: tuple[str, ...]
    optional_inputs: tuple[str, ...]
    scores: dict[str, float]  # on the validation scenes, mean of the last frames
    provenance: dict[str, Any]
    spec: ModelSpec
    interface: Interface  # of its network
    ports: Ports | None = None  # of a frame graph: what it takes and gives; None for a network
    operators: Mapping[str, int] = field(default_factory=dict)  # of a frame graph: nodes of each


def list_models() -> list[ModelInfo]:
    """The models that come with stillray, by name.

    Examples
    --------
    >>> import stillray
    >>> [model.name for model in stillray.list_models()]
    ['kpyr-5', 'kpyr-5s', 'nbg-2x1', 'nbg-2x3', 'nbg-7x3', 'wskp-3', 'wskp-3s', 'wskp-6',
     'wskp-mr']
    """
    return [_fitting(read_model(path)) for path in _files().values()]


def qualities() -> dict[str, str]:
    """Quality to the name of the model that gives it, without opening any."""
    return {quality: model for quality, model in _named().items() if isinstance(model, str)}


def for_single_frames(name: str, *, guided: bool = True) -> str:
    """The model to take for a quality where every frame is denoised alone; other names as given.

    Parameters
    ----------
    name
        A quality, or a model's name.
    guided
        Whether frames have albedo or normals.
    """
    return str(_named()["alone" if guided else "color"].get(name, name))


def _named() -> dict[str, Any]:
    return tomllib.loads((_folder() / "qualities.toml").read_text(encoding="utf-8"))


#: Files of the whole denoise as one graph, for engines that embed ONNX Runtime themselves.
WHOLE_SUFFIX = ".whole"


def find_model(name: str | os.PathLike[str]) -> ModelInfo:
    """A model by name, quality (``"fast"``, ``"balanced"``, ``"high"``) or path of an .onnx file.

    Raises
    ------
    InputError
        There is no such model: the message lists those there are. Or its file cannot be used.
    """
    path = Path(name)
    if path.suffix == ".onnx":
        return _fitting(read_model(path))
    files, aliases = _files(), qualities()
    wanted = aliases.get(str(name), str(name))
    if packaged := files.get(wanted) or _files(UNLISTED).get(wanted):
        return _fitting(read_model(packaged))
    raise InputError(
        f"model must be one of {', '.join([*files, *aliases])} or the path of an .onnx file, "
        f"got {name}"
    )


def differences(model: ModelInfo) -> tuple[str, ...]:
    """How a model differs from the paper it follows, a sentence each.

    The packaged specification of its name says so, if the file is of the same one otherwise: this
    is prose, and may be put right after a file was exported. Else the file itself says it.
    """
    try:
        packaged = load(model.name)
    except SpecError:
        return model.spec.differs
    return packaged.differs if packaged == model.spec else model.spec.differs


def steps_of(family: str) -> dict[str, Path]:
    """Graphs of learning that come with stillray for the models of a family, by name."""
    path = _folder() / "steps" / f"{family}.onnx"
    return {"train_step": path} if path.is_file() else {}


def _folder() -> Path:
    return Path(str(resources.files("stillray.models")))


#: Folder of models that are found by their name and not listed: those on trial, and what stands for
#: a quality where frames have no past.
UNLISTED = "unlisted"


def unlisted_models() -> list[str]:
    """Names of the models that are found by name and not listed."""
    return sorted(_files(UNLISTED))


def _files(folder: str = "") -> dict[str, Path]:
    """Packaged models by name."""
    paths = sorted((_folder() / folder).glob("*.onnx"))
    others = (WHOLE_SUFFIX, FRAME_SUFFIX, SPATIAL_SUFFIX, INT8_SUFFIX, PAIRS_SUFFIX)
    return {path.stem: path for path in paths if not path.stem.endswith(others)}


def read_model(path: Path) -> ModelInfo:
    """Read the specification and provenance that a model file carries; nothing is run.

    Raises
    ------
    InputError
        The file is missing, is not ONNX, or holds what `stillray-export` does not write.
    """
    for suffix in (INT8_SUFFIX, PAIRS_SUFFIX):
        if path.name.endswith(f"{suffix}.onnx"):
            floats = path.name.removesuffix(f"{suffix}.onnx")
            raise InputError(
                f"{path}: is the network of {floats}.onnx in integers; that is the model"
            )
    for suffix in (WHOLE_SUFFIX, FRAME_SUFFIX, SPATIAL_SUFFIX):
        if path.name.endswith(f"{suffix}.onnx"):
            raise InputError(
                f"{path}: is for engines that embed ONNX Runtime; the model is "
                f"{path.name.removesuffix(f'{suffix}.onnx')}.onnx"
            )
    file, interface = read_checked(path)
    spec, provenance = _told(path, file.metadata)
    return _info(path, len(file.data), interface, spec, provenance)


def find_frame_model(name: str | os.PathLike[str]) -> ModelInfo:
    """The model of a frame graph, by the graph's path; nothing of it is run.

    It is called by its model's name and ``.frame``, since it cannot do all that the model can.

    Raises
    ------
    InputError
        There is no such file: the message says how to make it. Or it is no frame graph.
    """
    path = find_frame_graph(str(name))
    file = read_frame_graph(path)
    spec, provenance = _told(path, file.metadata)
    # of the network within, its specification tells
    planes = tuple(Planes(*each) for each in network_outputs(spec))
    interface = Interface(
        features=len(spec.network.features), outputs=planes, multiplications=float("nan")
    )
    info = _info(path, file.size_bytes, interface, spec, provenance)
    return replace(
        info, name=f"{spec.name}{FRAME_SUFFIX}", ports=file.ports, operators=file.operators
    )


def is_frame_graph(name: str | os.PathLike[str]) -> bool:
    """Whether a model is named by the path of a frame graph."""
    return os.fspath(name).endswith(f"{FRAME_SUFFIX}.onnx")


def _told(path: Path, metadata: Mapping[str, str]) -> tuple[ModelSpec, dict[str, Any]]:
    """The specification and the provenance that a file carries."""
    for key in (SPEC_KEY, PROVENANCE_KEY):
        if key not in metadata:
            raise InputError(f"{path}: not a stillray model: no {key} in its metadata")
    try:
        spec = from_json(metadata[SPEC_KEY])
    except SpecError as error:
        raise InputError(f"{path}: its specification cannot be used: {error}") from None
    try:
        provenance = _provenance(metadata[PROVENANCE_KEY])
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: its provenance cannot be used: {error}") from None
    return spec, provenance


def _info(
    path: Path, size: int, interface: Interface, spec: ModelSpec, provenance: dict[str, Any]
) -> ModelInfo:
    return ModelInfo(
        name=spec.name,
        family=spec.family,
        summary=spec.summary,
        aliases=spec.aliases,
        path=path,
        parameters=provenance["parameters"],
        size_bytes=size,
        inputs=spec.inputs.required,
        optional_inputs=spec.inputs.optional,
        scores=provenance.get("scores", {}),
        provenance=provenance,
        spec=spec,
        interface=interface,
    )


def _provenance(text: str) -> dict[str, Any]:
    """What a model was made of; `ValueError` where a part that is relied on is not as it must be.

    What the training wrote beside that may be anything.
    """
    if len(text) > _MAX_PROVENANCE:
        raise ValueError(f"it has more than {_MAX_PROVENANCE} characters")
    provenance = json.loads(text)
    if not isinstance(provenance, dict):
        raise ValueError("it must be a table")
    parameters, scores = provenance.get("parameters"), provenance.get("scores", {})
    if type(parameters) is not int or not 0 <= parameters < 2**53:
        raise ValueError("parameters must be a count")
    if not isinstance(scores, dict) or not all(
        name.isprintable() and type(value) in (int, float) and abs(value) < _MAX_SCORE
        for name, value in scores.items()
    ):
        raise ValueError(f"scores must be numbers below {_MAX_SCORE:g} by printable names")
    return provenance


def _fitting(info: ModelInfo) -> ModelInfo:
    require_fit(info.interface, info.spec, info.path)
    return info


def require_fit(interface: Interface, spec: ModelSpec, origin: Path | str) -> None:
    """Raise `InputError` where a network is not what its specification describes.

    Parameters
    ----------
    interface
        What the network takes and gives.
    spec
        The specification beside it.
    origin
        What the message calls them.
    """
    features = len(spec.network.features)
    if interface.features != features:
        raise InputError(
            f"{origin}: its network must take the {features} features of its specification, "
            f"takes {interface.features}"
        )
    weights = network_weights(spec)
    if list(interface.weights) != weights:
        raise InputError(
            f"{origin}: the weights that its network takes must be the {len(weights)} of its "
            f"specification, takes {len(interface.weights)} or others"
        )
    wanted = network_outputs(spec)
    given = [(planes.count, planes.reduction) for planes in interface.outputs]
    if given != wanted:
        raise InputError(
            f"{origin}: its network must give what its specification asks for, (planes, "
            f"reduction) {wanted}, gives {given[:8]}"
        )


def with_overrides(
    info: ModelInfo,
    *,
    kernels: int | None = None,
    max_samples: float | None = None,
    ensemble: int | None = None,
) -> ModelInfo:
    """A model with other settings than it was trained with, for `stillray.Denoiser`.

    Parameters
    ----------
    info
        The model.
    kernels
        How many of its fused kernels to use, the smallest first; weight-sharing kernels only.
    max_samples
        Samples that a pixel's history counts as at most, 1 or more: how long it remembers.
    ensemble
        Views of a frame whose pictures are averaged, 1 to 4; pyramids of kernels only. Each
        takes about as long as the first.

    Raises
    ------
    InputError
        The model has not so many kernels or no ensemble, or the history is too short; or it is a
        frame graph, whose settings are in its nodes.
    """
    if info.ports is not None:
        raise InputError(f"model must be a network to have other settings, got {info.path}")
    spec = info.spec
    if kernels is not None:
        sizes = spec.decoder.fused_sizes
        if not 1 <= kernels <= len(sizes):
            raise InputError(
                f"kernels must be 1 to the {len(sizes)} that {info.name} fuses, got {kernels}"
            )
        spec = replace(spec, decoder=spec.decoder.with_kernels(sizes[:kernels]))
    if max_samples is not None:
        if max_samples < 1:
            raise InputError(f"max_samples must be 1 or more, got {max_samples:g}")
        spec = replace(spec, temporal=replace(spec.temporal, max_samples=float(max_samples)))
    if ensemble is not None:
        most = spec.decoder.most_ensemble
        whole = isinstance(ensemble, Integral) and not isinstance(ensemble, bool)
        if not whole or not 1 <= ensemble <= most:
            rule = f"an integer from 1 to {most}" if most > 1 else "1"
            raise InputError(f"ensemble must be {rule} with {info.name}, got {ensemble!r}")
        spec = replace(spec, decoder=spec.decoder.with_ensemble(int(ensemble)))
    return replace(info, spec=spec)
