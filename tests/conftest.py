"""Shared small inputs: odd sizes, and a scene-like frame that needs no renderer."""

from __future__ import annotations

import dataclasses
import importlib
import os
import sys
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from stillray.families.temporal_kernels import history_of
from stillray.frame import Frame
from stillray.model_spec import ModelSpec, load
from stillray.models.registry import find_model
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


@pytest.fixture(scope="session")
def frame_graph(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The frame graph of a packaged model, by its name: made once a run for all that ask."""
    from filelock import FileLock  # torch needs it, which frame graphs need

    from stillray_export.frame_graph.export import write

    folder = tmp_path_factory.getbasetemp()
    if "PYTEST_XDIST_WORKER" in os.environ:
        folder = folder.parent  # of all workers

    def path_of(name: str) -> Path:
        path = folder / f"{name}.frame.onnx"
        with FileLock(f"{path}.lock"):
            return path if path.is_file() else write(find_model(name), folder)

    return path_of


@pytest.fixture(scope="session", autouse=True)
def _operators_of_the_exporter() -> Iterator[None]:
    """torch lists all operators that it can export anew for every graph, half a second: once."""
    if "stillray_training.onnx_graph" not in sys.modules:  # nothing is exported
        yield
        return
    registry = importlib.import_module("torch.onnx._internal.exporter._registration").ONNXRegistry
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "from_torchlib", staticmethod(cache(registry.from_torchlib)))
        yield


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


class NotAccumulatedError(AssertionError):
    """A model that does not accumulate as those of kernels do."""


def remembered(denoiser: Denoiser) -> History:
    """What a model of kernels remembers of its last frame."""
    history = history_of(denoiser.state)
    if history is None:
        raise NotAccumulatedError(denoiser.model.name)
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
