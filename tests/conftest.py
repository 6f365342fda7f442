"""Shared small inputs: odd sizes, and a scene-like frame that needs no renderer."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import numpy as np
import pytest

from stillray.families.temporal_kernels import history_of
from stillray.frame import Frame
from stillray.model_spec import ModelSpec, load
from stillray.pipeline.denoiser import Denoiser
from stillray.stages.state import History

# processes that tests start read the same sources as they do, whatever is installed
_REPOSITORY = Path(__file__).parents[1]
os.environ["PYTHONPATH"] = os.pathsep.join(
    [str(_REPOSITORY / root) for root in ("runtime", "training", "export")]
    + [path for path in (os.environ.get("PYTHONPATH"),) if path]
)

ODD_SIZES = [(1, 1), (3, 5), (33, 18), (64, 97)]


@pytest.fixture
def spec() -> ModelSpec:
    return load("wskp-3s")


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(7)


def make_frame(height: int, width: int, seed: int = 0, shift: float = 0.0) -> Frame:
    """A wall and a box in front of it under 1-spp-like noise; ``shift`` moves the box, pixels."""
    rng = np.random.default_rng(seed)
    row, column = np.mgrid[0:height, 0:width].astype(np.float32)
    box = (np.abs(column - width / 2 - shift) < width / 5) & (np.abs(row - height / 2) < height / 4)
    albedo = np.where(box[..., None], [0.8, 0.3, 0.1], [0.5, 0.6, 0.7])
    normal = np.where(box[..., None], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0])
    light = 0.5 + 0.4 * np.sin(row / 9)[..., None]
    noise = rng.exponential(1.0, (height, width, 1)) * (rng.random((height, width, 1)) < 0.7) / 0.7
    return Frame(
        color=albedo * light * noise,
        albedo=albedo,
        normal=normal,
        depth=np.where(box, 2.0, 5.0),
        motion=np.where(box[..., None], [-shift, 0.0], 0.0),
    )


def remembered(denoiser: Denoiser) -> History:
    """What a model of kernels remembers of its last frame."""
    history = history_of(denoiser.state)
    assert history is not None
    return history


def clean_color(height: int, width: int) -> np.ndarray:
    """What `make_frame` is an unbiased estimate of, with ``shift`` 0."""
    frame = make_frame(height, width)
    row = np.mgrid[0:height, 0:width][0]
    assert frame.albedo is not None
    return frame.albedo * (0.5 + 0.4 * np.sin(row / 9))[..., None]


def with_decoder(spec: ModelSpec, **changes: object) -> ModelSpec:
    """A spec whose decoder differs."""
    return dataclasses.replace(spec, decoder=dataclasses.replace(spec.decoder, **changes))
