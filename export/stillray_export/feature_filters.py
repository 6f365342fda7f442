"""Export of models that denoise and upscale at once: see `stillray_export.to_onnx`.

Their whole graph takes a frame and its past at the picture's pixels, and gives the picture and
what is remembered of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime as ort
import torch
from torch import Tensor, nn

from stillray.arrays.strips import Strips
from stillray.families import feature_reconstruction as runtime
from stillray.families.feature_filters import FeatureFiltersModel
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec
from stillray.models.precision import int8_path, pairs_path
from stillray.models.registry import WHOLE_SUFFIX, require_fit
from stillray.models.session import checked
from stillray_export.parity import (
    IMAGE_TOLERANCE,
    SIZES,
    check_networks,
    note,
    random_features,
)
from stillray_training.decoders import feature_filters as twin
from stillray_training.networks.fuse import fuse
from stillray_training.onnx_graph import (
    axes_of,
    example_features,
    metadata_of,
    network_graph,
    to_model,
)

#: What the whole graph takes beside the features, and its planes; and what it gives.
FRAME = {"color": 3, "albedo": 3, "specular": 3}
PAST = {"past_light": 4, "past_albedo": 4, "past_specular": 4, "past_output": 4}
EXPOSURE = "exposure"  # last of the inputs, one number: 1 / radiance
RESULTS = ("image", "light", "albedo_mean", "specular_mean")


class WholeUpscale(nn.Module):
    """Network and reconstruction in one graph."""

    def __init__(self, network: nn.Module, spec: ModelSpec) -> None:
        super().__init__()
        self.network = network
        self.rules = FeatureFiltersModel(spec).rules

    def forward(self, features: Tensor, *arrays: Tensor) -> tuple[Tensor, ...]:
        """``(n, features, h, w)``, arrays of `FRAME` and `PAST`, `EXPOSURE`: to `RESULTS`."""
        *images, exposure = arrays
        color, albedo, specular = images[:3]
        frame = twin.Enlarged(color, albedo, specular, exposure)
        past = twin.Remembered(*images[3:])
        image, kept = twin.reconstruct(frame, past, self.network(features), self.rules)
        return (image, *kept)


def export(network: nn.Module, spec: ModelSpec, provenance: dict[str, Any], out: Path) -> Path:
    """Write both graphs of a model; see `stillray_export.to_onnx.export`."""
    fused = fuse(network)
    provenance = {
        **provenance,
        "parameters": sum(parameter.numel() for parameter in fused.parameters()),
    }
    alone = network_graph(fused, spec, provenance).SerializeToString()
    whole = whole_graph(fused, spec, provenance)
    require_fit(checked(alone, spec.name)[1], spec, spec.name)
    check(network, fused, alone, whole, spec)
    path = out / f"{spec.name}.onnx"
    for data, target in ((alone, path), (whole, out / f"{spec.name}{WHOLE_SUFFIX}.onnx")):
        with atomic_path(target) as temporary:
            temporary.write_bytes(data)
    for integers in (int8_path(path), pairs_path(path)):
        integers.unlink(missing_ok=True)  # they were of the weights before
    return path


def whole_graph(fused: nn.Module, spec: ModelSpec, provenance: dict[str, Any]) -> bytes:
    """The serialised graph of network and reconstruction."""
    features = example_features(spec)
    planes = {**FRAME, **PAST}
    arrays = [torch.ones(1, count, *features.shape[2:]) for count in planes.values()]
    axes = axes_of(spec)
    exposure = torch.ones(1, 1, 1, 1)
    return to_model(
        WholeUpscale(fused, spec).eval(),
        (features, *arrays, exposure),
        ["features", *planes, EXPOSURE],
        list(RESULTS),
        (axes, (*(axes for _ in arrays), {})),
        metadata_of(spec, provenance),
    ).SerializeToString()


def check(
    network: nn.Module, fused: nn.Module, alone: bytes, whole: bytes, spec: ModelSpec
) -> dict[str, float]:
    """Compare every form of a model; see `stillray_export.parity.check`.

    Returns
    -------
    dict
        Form to its worst relative error.

    Raises
    ------
    ParityError
        A form is beyond its tolerance.
    """
    sessions = [
        ort.InferenceSession(graph, providers=["CPUExecutionProvider"]) for graph in (alone, whole)
    ]
    worst: dict[str, float] = {}
    model = FeatureFiltersModel(spec)
    for index, size in enumerate(SIZES):
        height, width = (-(-pixels // model.alignment) * model.alignment for pixels in size)
        rng = np.random.default_rng(index)
        features = random_features(rng, spec, height, width)
        bound = model.rules.filters.logit_bound
        given = check_networks(network, fused, sessions[0], features, bound, worst)
        arrays = random_arrays(rng, height, width)
        for scale in (1.0, 1e3):  # 1e3: logits far beyond the bound
            planes = [(part * scale).astype(np.float32) for part in given]
            results = decoded(arrays, planes, spec)
            if scale == 1.0:
                results["whole graph"] = sessions[1].run(None, {"features": features, **arrays})
            wanted = results.pop("oracle")
            for name, parts in results.items():
                for part, expected in zip(parts, wanted, strict=True):
                    note(worst, name, part, expected, IMAGE_TOLERANCE, np.abs(expected) + 1e-6)
    return worst


def random_arrays(rng: np.random.Generator, height: int, width: int) -> dict[str, np.ndarray]:
    """A frame and a past, ``(1, c, h, w)`` float32 by name, with a firefly and places without."""

    def of(count: int) -> tuple[int, int, int, int]:
        return (1, count, height, width)

    arrays = {"color": rng.lognormal(0, 2, of(3))}
    arrays |= {name: rng.uniform(0, 1, of(3)) for name in ("albedo", "specular")}
    arrays |= {name: rng.uniform(0, 1, of(4)) for name in PAST}
    for name in PAST:
        arrays[name][:, 3] *= 32 * (rng.random((height, width)) < 0.8)
    arrays["color"][:, :, 0, 0] = 1e5
    arrays[EXPOSURE] = rng.lognormal(0, 1, (1, 1, 1, 1))
    return {name: value.astype(np.float32) for name, value in arrays.items()}


def decoded(
    arrays: Mapping[str, np.ndarray], planes: Sequence[np.ndarray], spec: ModelSpec
) -> dict[str, list[np.ndarray]]:
    """The same planes through each decoder; ``oracle`` is the PyTorch one in float64."""

    def in_torch(kind: torch.dtype) -> list[np.ndarray]:
        given = {name: torch.from_numpy(value).to(kind) for name, value in arrays.items()}
        color, albedo, specular = (given[name] for name in FRAME)
        frame = twin.Enlarged(color, albedo, specular, given[EXPOSURE])
        past = twin.Remembered(*(given[name] for name in PAST))
        maps = [torch.from_numpy(part).to(kind) for part in planes]
        image, kept = twin.reconstruct(frame, past, maps, FeatureFiltersModel(spec).rules)
        return [part.numpy() for part in (image, *kept)]

    image = {
        name: np.ascontiguousarray(arrays[name][0].transpose(1, 2, 0)) for name in (*FRAME, *PAST)
    }
    light, albedo, specular, output = (image[name] for name in PAST)
    exposure = float(arrays[EXPOSURE].item())
    found, kept = runtime.reconstruct(
        runtime.Enlarged(**{name: image[name] for name in FRAME}, exposure=exposure),
        runtime.Past(runtime.Accumulated(light, albedo, specular), output),
        [part[0] for part in planes],
        FeatureFiltersModel(spec).rules,
        Strips(1),
        runtime.Accumulated.empty((output.shape[0], output.shape[1])),
    )
    parts = (found, kept.light, kept.albedo, kept.specular)
    return {
        "oracle": in_torch(torch.float64),
        "torch decoder": in_torch(torch.float32),
        "runtime decoder": [part.transpose(2, 0, 1)[None] for part in parts],
    }
