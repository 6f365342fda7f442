"""Model specifications: one TOML file a model, read strictly.

A spec says everything that turns buffers into a picture: inputs, transfer, network, decoder,
temporal accumulation and the training recipe. The same spec, as JSON, is embedded in the model's
.onnx file; the runtime reads nothing else.
"""

from __future__ import annotations

import dataclasses
import json
import tomllib
import types
import typing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stillray.model_spec.decoders import (
    BilateralGrids,
    CrossBilateral,
    FeatureFilters,
    FusedKernels,
    PyramidKernels,
)
from stillray.model_spec.networks import (
    BranchNetwork,
    FilterNetwork,
    GuideNetwork,
    ImportanceNetwork,
    PyramidNetwork,
)
from stillray.model_spec.planes import PIXEL_FILTER
from stillray.model_spec.rules import MAX_NAME, SpecError, brief, odd, one_of, within
from stillray.model_spec.stages import (
    Demodulate,
    Inputs,
    Lamps,
    Prefilter,
    RareLight,
    Relief,
    Temporal,
    Texture,
    ToldSamples,
    Transfer,
)
from stillray.model_spec.training import Training

FORMAT = 1
_MAX_CHARACTERS = 2**18  # of a specification
_MAX_TEXT = 500  # characters of one value
_MAX_LIST = 64  # values
_MAX_LOCAL_SIZE = 255  # pixels
BUFFERS = (
    "color", "albedo", "normal", "depth", "motion", "color_b", "jitter",
    "roughness", "specular_albedo",
)  # fmt: skip


@dataclass(frozen=True)
class Family:
    """What the tables of a specification hold in one family of models."""

    network: type
    decoder: type
    most_block: int = 2  # pixels, of the networks that know blocks
    weighs_past: bool = False  # the network itself, pixel by pixel: no rule bounds it beside edges


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """Everything about one model but its weights."""

    format: int
    name: str
    family: str
    summary: str
    aliases: tuple[str, ...]
    inputs: Inputs
    demodulate: Demodulate
    transfer: Transfer
    temporal: Temporal
    network: ImportanceNetwork | PyramidNetwork | GuideNetwork | FilterNetwork | BranchNetwork
    decoder: FusedKernels | PyramidKernels | BilateralGrids | CrossBilateral | FeatureFilters
    training: Training
    # Models that were exported before it was known have none.
    relief: Relief = Relief()  # noqa: RUF009  a value that nobody can change
    texture: Texture = Texture()  # noqa: RUF009  the same
    lamps: Lamps = Lamps()  # noqa: RUF009  the same
    rare_light: RareLight = RareLight()  # noqa: RUF009  the same
    prefilter: Prefilter = Prefilter()  # noqa: RUF009  the same
    told_samples: ToldSamples = ToldSamples()  # noqa: RUF009  the same
    # How it differs from the paper it follows, "what the paper says; here what is done". Prose:
    # no part of what a model is, and models that were exported before it was known lack it.
    differs: tuple[str, ...] = dataclasses.field(default=(), compare=False)

    @property
    def knows_samples(self) -> bool:
        """Whether its network learned what samples a pixel mean, and is told them."""
        return "samples" in self.network.features and self.training.still_share > 0

    @property
    def knows_filter(self) -> bool:
        """Whether its network or its resolve is told the renderer's pixel filter."""
        return PIXEL_FILTER in self.network.features or self.decoder.minds_filter

    @property
    def knows_past(self) -> bool:
        """Whether frames may have a past: otherwise each is denoised alone, whatever is asked."""
        return not self.training.alone

    @property
    def knows_jitter(self) -> bool:
        """Whether jitter is looked at: pictures then lie at the centres of their pixels."""
        return "jitter" in (*self.inputs.required, *self.inputs.optional)

    def __post_init__(self) -> None:
        if self.format != FORMAT:
            raise SpecError(f"format must be {FORMAT}, got {self.format}")
        one_of("family", self.family, FAMILIES)
        for name in (self.name, *self.aliases):
            _require_name(name)
        for name in self.inputs.required + self.inputs.optional:
            one_of("inputs", name, BUFFERS)
        family = FAMILIES[self.family]
        for key in ("network", "decoder"):
            kind = getattr(family, key)
            if not isinstance(getattr(self, key), kind):
                raise SpecError(
                    f"{key} of {self.family} must be {kind.__name__}, "
                    f"got {type(getattr(self, key)).__name__}"
                )
        within("network.block", getattr(self.network, "block", 1), 1, family.most_block)
        odd("transfer.local_size", (self.transfer.local_size,), _MAX_LOCAL_SIZE)
        within("demodulate.floor", self.demodulate.floor, 1e-6, 1)
        within("demodulate.black", self.demodulate.black, 0, self.demodulate.floor)
        within("demodulate.specular", self.demodulate.specular, 0, 1)
        within("transfer.middle", self.transfer.middle, 1e-6, 1e6)
        within("transfer.exposure_memory", self.transfer.exposure_memory, 0, 0.999)
        within("temporal.max_samples", self.temporal.max_samples, 1, 1e6)
        within("temporal.outlier_ratio", self.temporal.outlier_ratio, 1e-3, 1e9)
        within("temporal.normal_cosine", self.temporal.normal_cosine, -1, 1)
        within("temporal.albedo_samples", self.temporal.albedo_samples, 0, 1e6)
        within("temporal.depth_ratio", self.temporal.depth_ratio, 1e-6, 1e6)
        within("temporal.outlier_deviations", self.temporal.outlier_deviations, 0, 100)
        within("temporal.most_blur", self.temporal.most_blur, 0, 1e6)
        within("temporal.sharp_contrast", self.temporal.sharp_contrast or 1.0, 1, 1e6)
        # edges are those of some contrast
        bounded = self.temporal.sharp_contrast > 0 and not family.weighs_past
        within("temporal.edge_blur", self.temporal.edge_blur, 0, 1e6 if bounded else 0)
        for name in ("relief", "texture"):
            within(f"{name}.window", getattr(self, name).window, 0, 1e3)
        within("told_samples.share", self.told_samples.share, 1e-3, 1)
        if self.prefilter.albedo:
            _require_name(self.prefilter.albedo)

    def to_json(self) -> str:
        """The spec as JSON text, as it is embedded in a model file."""
        data = dataclasses.asdict(self)
        # as before they were known
        for name, unsaid in _UNSAID.items():
            if getattr(self, name) == unsaid:
                del data[name]
        return json.dumps(data, sort_keys=True)


_UNSAID = {
    "differs": (),
    "relief": Relief(),
    "texture": Texture(),
    "lamps": Lamps(),
    "rare_light": RareLight(),
    "prefilter": Prefilter(),
    "told_samples": ToldSamples(),
}
FAMILIES = {
    "weight-sharing-kernels": Family(ImportanceNetwork, FusedKernels),
    "kernel-pyramid": Family(PyramidNetwork, PyramidKernels),
    "multi-resolution-kernels": Family(PyramidNetwork, FusedKernels, most_block=1),
    "bilateral-grids": Family(GuideNetwork, BilateralGrids),
    "cross-regression": Family(FilterNetwork, CrossBilateral),
    "feature-filters": Family(BranchNetwork, FeatureFilters, weighs_past=True),
}


def parse(data: dict[str, Any]) -> ModelSpec:
    """Build a spec from nested dictionaries.

    Raises
    ------
    SpecError
        A key is unknown or missing, or a value breaks its rule.
    """
    hints = typing.get_type_hints(ModelSpec)
    # an unknown or missing family is reported with the other keys
    if isinstance(data, dict) and (family := FAMILIES.get(str(data.get("family")))):
        hints.update(network=family.network, decoder=family.decoder)
    elif isinstance(data, dict) and "family" in data:
        one_of("family", str(data["family"]), FAMILIES)
    return _build(ModelSpec, hints, data, "")


def load(name: str) -> ModelSpec:
    """Load the packaged spec of a model by name, ``load("wskp-3")``.

    Raises
    ------
    SpecError
        There is no such spec (the message lists those there are), or it breaks a rule.
    """
    folder = _specs()
    names = sorted(path.stem for path in folder.glob("*.toml"))
    if name not in names:
        raise SpecError(f"model must be one of {', '.join(names)}, got {name}")
    return parse(tomllib.loads((folder / f"{name}.toml").read_text()))


def _specs() -> Path:
    here = Path(__file__).parent
    installed = here / "specs"
    # the repository keeps them at its root; an installed package carries a copy
    return installed if installed.is_dir() else here.parents[2] / "models_spec"


def from_json(text: str) -> ModelSpec:
    """Read back what `ModelSpec.to_json` wrote.

    Raises
    ------
    SpecError
        It is not that, or too long.
    """
    if len(text) > _MAX_CHARACTERS:
        raise SpecError(f"a specification must have {_MAX_CHARACTERS} characters at most")
    try:
        data = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise SpecError(f"a specification must be JSON: {error}") from None
    return parse(data)


def _build(kind: type, hints: dict[str, Any], data: Any, path: str) -> Any:
    if not isinstance(data, dict):
        name = path.rstrip(".") or "a specification"
        raise SpecError(f"{name} must be a table, got {brief(data)}")
    if unknown := sorted(set(data) - set(hints)):
        known = ", ".join(hints)
        raise SpecError(f"unknown key {path}{unknown[0][:MAX_NAME]}; known keys: {known}")
    optional = {
        field.name for field in dataclasses.fields(kind) if field.default is not dataclasses.MISSING
    }
    if missing := [key for key in hints if key not in data and key not in optional]:
        raise SpecError(f"missing key {path}{missing[0]}")
    given = {key: hint for key, hint in hints.items() if key in data}
    return kind(**{key: _value(hint, data[key], path + key) for key, hint in given.items()})


def _value(hint: Any, value: Any, path: str) -> Any:
    if dataclasses.is_dataclass(hint):
        return _build(typing.cast(type, hint), typing.get_type_hints(hint), value, path + ".")
    if typing.get_origin(hint) is tuple:
        if not isinstance(value, list | tuple):
            raise SpecError(f"{path} must be a list, got {brief(value)}")
        if len(value) > _MAX_LIST:
            raise SpecError(f"{path} must have {_MAX_LIST} entries at most, got {len(value)}")
        return tuple(_value(typing.get_args(hint)[0], item, path) for item in value)
    # as integers beyond what floats hold are not turned into any
    if hint is float and type(value) is int and abs(value) < 2**53:
        return float(value)
    if isinstance(hint, types.UnionType) or type(value) is not hint:
        raise SpecError(f"{path} must be of type {hint.__name__}, got {brief(value)}")
    if hint is str and not (len(value) <= _MAX_TEXT and value.isprintable()):
        raise SpecError(
            f"{path} must be {_MAX_TEXT} printable characters at most, got {brief(value)}"
        )
    return value


def _require_name(name: str) -> None:
    # it becomes a file's name and a word in tables
    if not 1 <= len(name) <= MAX_NAME or set(name) & set("/\\") or name[0] in ".-":
        raise SpecError(
            f"name and aliases must be 1 to {MAX_NAME} characters without slashes, not beginning "
            f"with a dot or dash, got {brief(name)}"
        )
