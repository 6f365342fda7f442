"""``python -m stillray_training.network_maps MODEL SEQUENCE --out FOLDER``: what a network says.

Of fused kernels each one's share of a pixel (Fan et al. 2021, figure 8); of bilateral grids each
scale's guide, the mean of the features that an unlearned guide would be, and each scale's share of
a pixel (Meng et al. 2020, figure 8). A PNG each, of the last frame; and their means at edges of
surfaces and elsewhere, since small kernels are said to serve the one and large ones the other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import cv2
import numpy as np
import typer
from rich.console import Console
from rich.table import Table

from stillray.arrays.strips import Strips
from stillray.cli import program
from stillray.compare.display import display_exposure, tone_map, write_png
from stillray.errors import InputError
from stillray.families.contract import Engine
from stillray.families.depth_to_space import DepthToSpace
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import BilateralGrids, FusedKernels
from stillray.model_spec.networks import ImportanceNetwork
from stillray.pipeline.denoiser import Denoiser
from stillray_training.blocks import frame_paths
from stillray_training.error_places import edges_of
from stillray_training.grid_study import changes

#: From features ``(planes, H, W)`` and outputs to maps ``(h, w)`` in [0, 1], by title.
Maps = dict[str, np.ndarray]


class Overheard:
    """An engine that keeps what it was given last and what it gave.

    Parameters
    ----------
    engine
        As `stillray.Denoiser` runs it.

    Attributes
    ----------
    features : (planes, H, W) float32
    outputs
        Of the network, without their batch axis.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.features = np.zeros((0, 0, 0), np.float32)
        self.outputs: list[np.ndarray] = []

    def run(self, graph: str, inputs: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
        """What the engine gives."""
        given = self._engine.run(graph, inputs)
        if graph == "network":
            self.features = np.array(inputs["features"][0])
            self.outputs = [np.array(one) for one in given.values()]
        return given

    def close(self) -> None:
        """Close the engine."""
        self._engine.close()


def kernel_shares(logits: np.ndarray, options: FusedKernels, prefix: str = "") -> Maps:
    """The share of each fused kernel in a pixel (Fan et al. 2021, eq. 5), by its size.

    Parameters
    ----------
    logits : (2 m or more, h, w) float32
        m importance maps, m fusion maps, and what does not count here.
    options
        The kernels.
    prefix
        Of the titles.

    Returns
    -------
    dict
        m maps ``(h, w)`` that add up to 1.
    """
    count = len(options.kernel_sizes)
    bounded = np.clip(logits[count : 2 * count], -options.logit_bound, options.logit_bound)
    weights = np.exp(bounded.astype(np.float64))
    shares = weights / weights.sum(0)
    sizes = zip(options.kernel_sizes, shares, strict=True)
    return {f"{prefix}share of {size}x{size}": share for size, share in sizes}


def level_shares(outputs: Sequence[np.ndarray], options: FusedKernels) -> Maps:
    """`kernel_shares` of every resolution, and how far each gives way to the next coarser one.

    Maps of coarser levels are enlarged by doubling pixels.

    Parameters
    ----------
    outputs
        As `stillray.families.multi_resolution` takes them, finest first.
    options
        The kernels.
    """
    count, found = len(options.kernel_sizes), Maps()
    for level, logits in enumerate(outputs):
        maps = kernel_shares(logits, options, f"1/{1 << level} of the size, ")
        if len(logits) > 2 * count:
            bounded = np.clip(logits[2 * count], -options.logit_bound, options.logit_bound)
            maps[f"1/{1 << level} of the size, coarser ones"] = 1 / (1 + np.exp(-bounded))
        for title, plane in maps.items():
            found[title] = np.kron(plane, np.ones((1 << level, 1 << level)))
    return found


def grid_maps(features: np.ndarray, maps: np.ndarray, spec: ModelSpec) -> Maps:
    """Guides, the mean of the features in their place, and each scale's share of a pixel.

    Parameters
    ----------
    features : (planes, h, w) float32
        What the network read.
    maps : (2 m - 1, h, w) float32
        What it said, see `stillray.families.bilateral_grid.filter_grids`.
    spec
        The model's.
    """
    count, rest = (len(maps) + 1) // 2, np.ones(maps.shape[1:])
    bounded = np.clip(maps, 0, 1).astype(np.float64)
    found = {f"guide {scale}": bounded[scale] for scale in range(count)}
    found["mean of features"] = changes(spec)["mean of features as guides"](features, maps)[0]
    for scale in range(count):
        own = rest * bounded[count + scale] if scale < count - 1 else rest
        found[f"share of scale {scale}"] = own
        rest = rest - own
    return found


def maps_of(spec: ModelSpec, features: np.ndarray, outputs: Sequence[np.ndarray]) -> Maps:
    """What a network said, as maps in [0, 1], by title.

    Raises
    ------
    InputError
        The model neither fuses kernels nor has grids.
    """
    if isinstance(spec.decoder, BilateralGrids):
        return grid_maps(features, outputs[0], spec)
    if not isinstance(spec.decoder, FusedKernels):
        raise InputError(f"model must fuse kernels or have bilateral grids, got {spec.name}")
    if not isinstance(spec.network, ImportanceNetwork):
        return level_shares(outputs, spec.decoder)
    logits = outputs[0]
    if spec.network.block > 1:
        pixels = DepthToSpace(logits, Strips(1))
        logits = pixels[slice(0, len(pixels)), slice(0, pixels.shape[1])]
    return kernel_shares(logits, spec.decoder)


def look(model: str, frames: Sequence[Frame]) -> tuple[Maps, np.ndarray]:
    """Maps of the last frame, of its size, and its picture, radiance ``(h, w, 3)``.

    Parameters
    ----------
    model
        As `stillray.Denoiser` takes it.
    frames
        In order, one or more; those before the last are its past.
    """
    with Denoiser(model) as plain:
        heard = Overheard(plain.engine)
        with Denoiser(plain.model, engine=heard) as stream:
            for frame in frames:
                image = stream.denoise(frame)
        maps = maps_of(plain.model.spec, heard.features, heard.outputs)
    height, width = frames[-1].shape
    return {title: plane[:height, :width] for title, plane in maps.items()}, image


def write_maps(maps: Maps, image: np.ndarray, prefix: str, out: Path) -> None:
    """Write a PNG a map, bright where it is large, and the picture.

    Shares are shown from 0 to 1. Guides are shown from their first to their last hundredth: what
    counts in them is difference.
    """
    out.mkdir(parents=True, exist_ok=True)
    write_png(out / f"{prefix}-picture.png", tone_map(image, display_exposure(image)))
    for title, plane in maps.items():
        low, high = (0.0, 1.0) if "share" in title or "coarser" in title else _range(plane)
        shown = np.clip((plane - low) / max(high - low, 1e-6), 0, 1)
        name = f"{prefix}-{title}".replace(", ", "-").replace(" ", "-").replace("/", "-of-")
        write_png(out / f"{name}.png", cv2.merge([shown] * 3))


def _range(plane: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(plane, (1, 99))
    return float(low), float(high)


def main(
    model: Annotated[str, typer.Argument(help="Model of fused kernels or grids, or an .onnx.")],
    sequence: Annotated[Path, typer.Argument(help="Folder of frame_0000.exr and so on, or one.")],
    out: Annotated[Path, typer.Option(help="Folder for the pictures.")] = Path("network-maps"),
) -> None:
    """Write what a network says of the last frame, and print its means."""
    paths = [sequence] if sequence.is_file() else frame_paths(sequence)
    if not paths:
        raise InputError(f"sequence must hold frame_0000.exr and so on, got {sequence}")
    frames = [read_exr(path) for path in paths]
    maps, image = look(model, frames)
    write_maps(maps, image, Path(model).stem, out)
    edges = edges_of(frames[-1])
    table = Table("map", "mean", "at edges", "elsewhere", box=None)
    for title, plane in maps.items():
        means = (plane.mean(), plane[edges].mean(), plane[~edges].mean())
        table.add_row(title, *(f"{mean:.3f}" for mean in means))
    Console().print(table)


if __name__ == "__main__":
    program.run(main)
