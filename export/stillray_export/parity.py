"""Parity of all forms of a model, checked before anything is written.

branches = fused = ONNX Runtime; decoder in PyTorch = decoder of the runtime = whole graph; each
against float64. Sizes are odd where the family allows, inputs random with fireflies, logits
extreme.
"""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence

import cv2
import numpy as np
import onnxruntime as ort
import torch
from torch import Tensor, nn

from stillray.arrays.strips import Strips
from stillray.families.registry import kernels_of
from stillray.model_spec import ModelSpec
from stillray.stages.state import Filterable
from stillray_training.decoders.boxes import BoxMean
from stillray_training.families import FAMILIES
from stillray_training.networks.repvgg import by_branches

SIZES = ((33, 18), (1, 1), (3, 5), (64, 97))  # height, width; rounded up to what the family takes
#: Channels of the arrays that decoders take.
CHANNELS = {
    "irradiance": 3, "samples": 1, "new": 3, "worth": 1, "divisor": 3, "previous": 3, "valid": 1,
    "exposure": 1,
}  # fmt: skip
SCALARS = {"exposure"}  # one number a frame
# Sums of a few hundred float32 products, in other orders: relative to the largest value. Rounding
# grows with depth: no form need be much more exact than float32 makes the network as trained.
NETWORK_TOLERANCE = 2e-5
#: Times that, a form may be as far off.
ROUNDING = 3.0
#: As trained, a network further off cannot be computed in float32.
MOST_ROUNDING = 2e-4
# A logit's error of 1e-5 moves an importance by as much, and the result by no more.
IMAGE_TOLERANCE = 2e-4


class ParityError(RuntimeError):
    """Two forms of one model disagree: the message names them, the size and the error."""


def check(
    network: nn.Module, fused: nn.Module, alone: bytes, whole: bytes, spec: ModelSpec
) -> dict[str, float]:
    """Compare every form of a model on every size.

    Parameters
    ----------
    network
        As trained, with branches.
    fused
        One convolution a block.
    alone, whole
        The serialised ONNX graphs.
    spec
        The model's specification.

    Returns
    -------
    dict
        Step name to the worst relative error found.

    Raises
    ------
    ParityError
        A step is beyond its tolerance.
    """
    worst: dict[str, float] = {}
    sessions = [
        ort.InferenceSession(graph, providers=["CPUExecutionProvider"]) for graph in (alone, whole)
    ]
    family = FAMILIES[spec.family]
    multiple = kernels_of(spec).looks.alignment
    bound = getattr(spec.decoder, "logit_bound", None)
    for index, size in enumerate(SIZES):
        height, width = (-(-pixels // multiple) * multiple for pixels in size)
        rng = np.random.default_rng(index)
        features = random_features(rng, spec, height, width)
        arrays = random_arrays(rng, height, width)
        given = check_networks(network, fused, sessions[0], features, bound, worst)
        for scale in (1.0, 1e4):  # 1e4: logits far beyond the bound
            logits = [(level * scale).astype(np.float32) for level in given]
            images = decoded(arrays, logits, spec)
            if scale == 1.0:
                feed = {"features": features, **{name: arrays[name] for name in family.inputs}}
                images["whole graph"] = sessions[1].run(None, feed)[0]
            expected = images.pop("oracle")
            unit = image_unit(arrays, expected, spec)
            for name, image in images.items():
                note(worst, name, image, expected, IMAGE_TOLERANCE, unit)
    return worst


def check_networks(
    network: nn.Module,
    fused: nn.Module,
    session: ort.InferenceSession,
    features: np.ndarray,
    bound: float | None,
    worst: dict[str, float],
) -> list[np.ndarray]:
    """Compare all forms of a network on the same features.

    Parameters
    ----------
    network, fused
        As trained, with branches; and one convolution a block.
    session
        Of the graph that holds the network alone.
    features : (1, planes, h, w) float32
        Its input.
    bound
        That the graph clips its outputs to; None for none.
    worst
        Form to its worst relative error, written.

    Returns
    -------
    list of (1, planes, h, w) float32
        What the graph gave.

    Raises
    ------
    ParityError
        A form is beyond its tolerance.
    """
    given = torch.from_numpy(features)
    exact = copy.deepcopy(network).double()
    with torch.no_grad(), by_branches(exact), by_branches(network):
        oracle = _listed(exact(given.double()))
        forms = {"branches logits": _listed(network(given))}
    with torch.no_grad():
        forms["merged logits"] = _listed(network(given))
        forms["fused logits"] = _listed(fused(given))
    forms["onnx logits"] = session.run(None, {"features": features})
    for name, values in forms.items():
        for value, expected in zip(values, oracle, strict=True):
            unit = np.abs(expected).max() + 1e-30
            if name == "onnx logits" and bound is not None:
                expected = np.clip(expected, -bound, bound)
            tolerance = MOST_ROUNDING
            if name != "branches logits":
                tolerance = max(NETWORK_TOLERANCE, ROUNDING * worst["branches logits"])
            note(worst, name, value, expected, tolerance, unit)
    return forms["onnx logits"]


def random_features(
    rng: np.random.Generator, spec: ModelSpec, height: int, width: int
) -> np.ndarray:
    """What a network reads, ``(1, planes, h, w)`` float32 in [-1, 1]."""
    shape = (1, len(spec.network.features), height, width)
    return rng.uniform(-1, 1, shape).astype(np.float32)


def image_unit(arrays: Mapping[str, np.ndarray], image: np.ndarray, spec: ModelSpec) -> np.ndarray:
    """What errors of an image are relative to, ``(1, 3, h, w)``.

    Images hold fireflies beside dark pixels: every pixel answers for itself, and for the share of
    its brightest neighbour that rounding may move to it.
    """
    unit = np.abs(image) + 1e-6
    if leak := FAMILIES[spec.family].leak:
        size = 2 * kernels_of(spec).looks.reach + 1
        for plane, target in zip(arrays["irradiance"][0], unit[0], strict=True):
            target += leak * cv2.dilate(plane, np.ones((size, size), np.uint8))
    return unit


def shape_of(name: str, height: int, width: int) -> tuple[int, int, int, int]:
    """Of what decoders take by that name."""
    return (1, CHANNELS[name], *((1, 1) if name in SCALARS else (height, width)))


def random_arrays(rng: np.random.Generator, height: int, width: int) -> dict[str, np.ndarray]:
    """What decoders take, ``(1, c, h, w)`` float32 by name, with a firefly."""

    def of(name: str) -> tuple[int, int, int, int]:
        return shape_of(name, height, width)

    arrays = {
        "irradiance": rng.lognormal(0, 2, of("irradiance")),
        "samples": rng.uniform(0.01, 16, of("samples")),
        "new": rng.lognormal(0, 3, of("new")),
        "worth": rng.uniform(1e-6, 1, of("worth")),
        "divisor": rng.uniform(0.1, 1, of("divisor")),
        "previous": rng.lognormal(0, 2, of("previous")),
        "valid": rng.uniform(0, 1, of("valid")),
        "exposure": rng.lognormal(0, 2, of("exposure")),
    }
    arrays["irradiance"][:, :, 0, 0] = 1e5
    return {name: value.astype(np.float32) for name, value in arrays.items()}


def decoded(
    arrays: Mapping[str, np.ndarray], logits: Sequence[np.ndarray], spec: ModelSpec
) -> dict[str, np.ndarray]:
    """The same logits through each decoder; ``oracle`` is the PyTorch one in float64."""
    family = FAMILIES[spec.family]

    def in_torch(kind: torch.dtype) -> np.ndarray:
        batch = {name: torch.from_numpy(value).to(kind) for name, value in arrays.items()}
        maps = [torch.from_numpy(level).to(kind) for level in logits]
        outputs = maps if len(maps) > 1 else maps[0]
        return family.decode(outputs, batch, spec, BoxMean.apply).numpy()

    runtime = _in_runtime(arrays, [level[0] for level in logits], spec)
    return {
        "oracle": in_torch(torch.float64),
        "torch decoder": in_torch(torch.float32),
        "runtime decoder": runtime.transpose(2, 0, 1)[None],
    }


def _in_runtime(
    arrays: Mapping[str, np.ndarray], logits: Sequence[np.ndarray], spec: ModelSpec
) -> np.ndarray:
    def interleaved(*names: str) -> np.ndarray:
        planes = np.concatenate([arrays[name][0] for name in names])
        return np.ascontiguousarray(planes.transpose(1, 2, 0))

    model = kernels_of(spec)
    light = Filterable(
        mean=interleaved("irradiance", "samples"),
        sample=np.concatenate([arrays[name][0] for name in ("new", "worth")]),
        remodulation_albedo=interleaved("divisor") if FAMILIES[spec.family].modulates else None,
        previous=interleaved("previous", "valid") if model.looks.previous_output else None,
        exposure=arrays["exposure"].item(),
    )
    return model.reconstruct(light, logits, Strips(1), {})


def _listed(outputs: Tensor | Sequence[Tensor]) -> list[np.ndarray]:
    """A network's outputs as arrays, one or several."""
    parts = [outputs] if isinstance(outputs, Tensor) else outputs
    return [part.numpy() for part in parts]


def note(
    worst: dict[str, float],
    name: str,
    value: np.ndarray,
    oracle: np.ndarray,
    tolerance: float,
    unit: np.ndarray | float,
) -> None:
    """Remember the largest error of a form, in a unit.

    Raises
    ------
    ParityError
        It is beyond the tolerance, or not a number.
    """
    error = float((np.abs(value - oracle) / unit).max())
    worst[name] = max(worst.get(name, 0.0), error)
    if not error <= tolerance:  # NaN fails too
        raise ParityError(
            f"{name} must agree with float64 within {tolerance:g}, got {error:g} at "
            f"{value.shape[2:]}"
        )
