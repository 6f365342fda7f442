"""Parity of all forms of a model, checked before anything is written.

branches = fused = ONNX Runtime; decoder in PyTorch = decoder of the runtime = whole graph; each
against float64. Sizes are odd, inputs random with fireflies, logits extreme.
"""

from __future__ import annotations

import numpy as np
import onnxruntime as ort
import torch
from torch import nn

from stillray import kernels
from stillray.models_spec import ModelSpec
from stillray.training.decoders import fused_kernels
from stillray.training.networks.importance import ImportanceNet

SIZES = ((33, 18), (1, 1), (3, 5), (64, 97))  # height, width
# Sums of a few hundred float32 products, in other orders: relative to the largest value.
NETWORK_TOLERANCE = 2e-5
# A logit's error of 1e-5 moves an importance by as much, and the result by no more.
IMAGE_TOLERANCE = 2e-4


class ParityError(RuntimeError):
    """Two forms of one model disagree: the message names them, the size and the error."""


def check(
    network: ImportanceNet, fused: nn.Module, alone: bytes, whole: bytes, spec: ModelSpec
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
    exact = ImportanceNet(spec).double()
    exact.load_state_dict({name: value.double() for name, value in network.state_dict().items()})
    for index, (height, width) in enumerate(SIZES):
        rng = np.random.default_rng(index)
        features = rng.uniform(-1, 1, (1, len(spec.network.features), height, width))
        features = features.astype(np.float32)
        irradiance = rng.lognormal(0, 2, (1, 3, height, width)).astype(np.float32)
        irradiance[:, :, 0, 0] = 1e5  # a firefly
        samples = rng.uniform(0.01, 16, (1, 1, height, width)).astype(np.float32)
        with torch.no_grad():
            oracle = exact.forward_branches(torch.from_numpy(features).double()).numpy()
            forms = {
                "branches logits": network.forward_branches(torch.from_numpy(features)).numpy(),
                "merged logits": network(torch.from_numpy(features)).numpy(),
                "fused logits": fused(torch.from_numpy(features)).numpy(),
                "onnx logits": sessions[0].run(None, {"features": features})[0],
            }
        for name, value in forms.items():
            _note(worst, name, value, oracle, NETWORK_TOLERANCE, (height, width))
        for scale in (1.0, 1e4):  # 1e4: logits far beyond the bound
            logits = (forms["onnx logits"] * scale).astype(np.float32)
            images = decoded(irradiance, samples, logits, spec)
            for name in ("torch decoder", "runtime decoder"):
                _note(worst, name, images[name], images["oracle"], IMAGE_TOLERANCE, (height, width))
            if scale == 1.0:
                image = sessions[1].run(
                    None, {"features": features, "irradiance": irradiance, "samples": samples}
                )[0]
                _note(
                    worst, "whole graph", image, images["oracle"], IMAGE_TOLERANCE, (height, width)
                )
    return worst


def decoded(
    irradiance: np.ndarray, samples: np.ndarray, logits: np.ndarray, spec: ModelSpec
) -> dict[str, np.ndarray]:
    """The same logits through each decoder; ``oracle`` is the PyTorch one in float64."""
    light, held, maps = (torch.from_numpy(part) for part in (irradiance, samples, logits))
    exact = fused_kernels(light.double(), held.double(), maps.double(), spec.decoder)
    mean = np.concatenate([irradiance, samples], axis=1)[0].transpose(1, 2, 0)
    runtime = kernels.filter_rows(
        np.ascontiguousarray(mean), logits[0], slice(0, mean.shape[0]), spec.decoder
    )
    return {
        "oracle": exact.numpy(),
        "torch decoder": fused_kernels(light, held, maps, spec.decoder).numpy(),
        "runtime decoder": runtime.transpose(2, 0, 1)[None],
    }


def _note(
    worst: dict[str, float],
    name: str,
    value: np.ndarray,
    oracle: np.ndarray,
    tolerance: float,
    size: tuple[int, int],
) -> None:
    # images hold fireflies beside dark pixels: every pixel answers for itself
    unit = np.abs(oracle) + 1e-6 if "logits" not in name else np.abs(oracle).max() + 1e-30
    error = float((np.abs(value - oracle) / unit).max())
    worst[name] = max(worst.get(name, 0.0), error)
    if not error <= tolerance:  # NaN fails too
        raise ParityError(
            f"{name} must agree with float64 within {tolerance:g}, got {error:g} at {size}"
        )
