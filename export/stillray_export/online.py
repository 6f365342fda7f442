"""``python -m stillray_export.online``: a model that learns while it denoises, as ONNX files.

``NAME.onnx`` is its network with the weights that it begins with, which are inputs, too: learned
ones take their place. ``steps/cross-regression.onnx`` is the step of learning; it comes with the
runtime as its code does, and is never read from where a model lies.
"""

from __future__ import annotations

import math
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import torch
import typer
from onnx import numpy_helper
from safetensors.torch import load_file
from torch import Tensor, nn
from torch.fx.experimental.proxy_tensor import make_fx

from stillray.cli import program
from stillray.errors import InputError
from stillray.families.filter_network import join
from stillray.families.online import THINNED
from stillray.families.online_learning import CROP
from stillray.io.atomic import atomic_path
from stillray.model_spec import ModelSpec, load
from stillray.model_spec.network_weights import network_weights
from stillray.models.onnx_file import parse_onnx, read_bytes
from stillray.models.registry import UNLISTED, find_model, require_fit
from stillray.models.session import checked
from stillray_training.loss_log import LOG, last_step
from stillray_training.networks.filter_parameters import Shapes, filter_parameters, split, start
from stillray_training.online.step import LOSS_EPSILON, Learning, train_step
from stillray_training.online.warm import WEIGHTS
from stillray_training.onnx_graph import metadata_of, to_model
from stillray_training.provenance import collect
from stillray_training.start import origin_of

OPSET = 18
STEP_NAME = "cross-regression.onnx"
#: What a step takes and gives, in the graph's order.
INPUTS = ("weights", "first", "second", "step", "rate", "features", "halves", "inside")
OUTPUTS = ("loss", "next_weights", "next_first", "next_second")


class GivenWeights(nn.Module):
    """The network as a function of its input and its weights."""

    def __init__(self, layout: Shapes) -> None:
        super().__init__()
        self.layout = layout

    def forward(self, features: Tensor, *weights: Tensor) -> Tensor:
        """``(1, 15, h, w)`` to the planes that set the filter."""
        named = {name: part for part, (name, _) in zip(weights, self.layout, strict=True)}
        return filter_parameters(named, features)


def layout_of(spec: ModelSpec) -> Shapes:
    """Names and shapes of a model's weights.

    Raises
    ------
    InputError
        It is of a family that does not learn while it denoises.
    """
    layout = network_weights(spec)
    if not layout:
        raise InputError(f"model must be of cross-regression, got {spec.name} of {spec.family}")
    return layout


def network_file(spec: ModelSpec, weights: Tensor, provenance: dict[str, Any]) -> bytes:
    """The bytes of a model: its network, and weights ``(n,)`` to begin with."""
    layout = layout_of(spec)
    named = split(weights, layout)
    multiple = 2 ** (len(spec.network.widths) - 1)  # type: ignore[union-attr]
    rows, columns = (torch.export.Dim(name, min=1) for name in ("rows", "columns"))
    axes: Any = {2: multiple * rows, 3: multiple * columns}
    model = to_model(
        GivenWeights(layout).eval(),
        (torch.zeros(1, len(spec.network.features), 32, 48), *named.values()),
        ["features", *named],
        ["parameters"],
        (axes, tuple({} for _ in named)),
        metadata_of(spec, {**provenance, "parameters": weights.numel()}),
    )
    for name, tensor in named.items():
        model.graph.initializer.append(numpy_helper.from_array(tensor.numpy(), name))
    data: bytes = model.SerializeToString()
    require_fit(checked(data, spec.name)[1], spec, spec.name)
    return data


def step_file(spec: ModelSpec) -> bytes:
    """The bytes of the graph of one step of learning, for frames' parts of `CROP` pixels."""
    layout = layout_of(spec)
    how = Learning(layout=layout, loss_epsilon=LOSS_EPSILON, thinned=THINNED)
    count = sum(math.prod(shape) for _, shape in layout)
    example = _example(count, len(spec.network.features))
    step = partial(train_step, how=how)
    table = {
        **torch._decomp.core_aten_decompositions(),
        torch.ops.aten.convolution_backward.default: convolution_backward,
    }
    graph = make_fx(step, decomposition_table=table)(*example)
    # what is left of make_fx's bookkeeping are nodes that nobody looks at
    graph.graph.eliminate_dead_code()
    graph.recompile()
    none: Any = tuple({} for _ in example)
    model = to_model(graph, example, list(INPUTS), list(OUTPUTS), none, {})
    data: bytes = model.SerializeToString()
    return data


def convolution_backward(
    slope: Tensor,
    planes: Tensor,
    kernel: Tensor,
    bias_sizes: list[int] | None,
    stride: list[int],
    padding: list[int],
    dilation: list[int],
    transposed: bool,
    output_padding: list[int],
    groups: int,
    output_mask: list[bool],
) -> tuple[Tensor | None, Tensor | None, Tensor | None]:
    """Derivatives of a convolution that keeps the size of one image, by convolution and products.

    Torch's own is an operator that ONNX does not have.
    """
    assert (list(stride), list(dilation), transposed, groups) == ([1, 1], [1, 1], False, 1)
    height, width = planes.shape[2:]
    reach = padding[0]
    back = None
    if output_mask[0]:
        turned = kernel.flip(2, 3).transpose(0, 1)
        back = torch.ops.aten.convolution(
            slope, turned, None, [1, 1], [reach, reach], [1, 1], False, [0, 0], 1
        )
    padded = torch.constant_pad_nd(planes, [reach] * 4)
    flat = slope.reshape(slope.shape[1], -1)
    of_kernel = torch.stack(
        [
            flat @ padded[0, :, y : y + height, x : x + width].reshape(planes.shape[1], -1).t()
            for y in range(kernel.shape[2])
            for x in range(kernel.shape[3])
        ],
        -1,
    ).reshape(kernel.shape)
    return back, of_kernel, slope.sum((0, 2, 3))


def _example(count: int, features: int) -> tuple[Tensor, ...]:
    generator = torch.Generator().manual_seed(0)
    weights = torch.rand(1, count, generator=generator) * 0.1
    planes = torch.rand(1, features, CROP, CROP, generator=generator)
    halves = torch.rand(1, 6, CROP, CROP, generator=generator)
    return (
        weights,
        torch.zeros_like(weights),
        torch.zeros_like(weights),
        torch.ones(1),
        torch.full((1,), 1e-3),
        planes,
        halves,
        torch.ones(1, 1, CROP, CROP),
    )


def _begin(spec: ModelSpec, run: Path | None) -> tuple[Tensor, dict[str, Any]]:
    """Weights to begin with, and where they are from."""
    if run is None:
        random = start(layout_of(spec), spec.training.seed)
        return random, {"data": "none: random weights", "seed": spec.training.seed}
    path = run / WEIGHTS
    if not path.is_file():
        raise InputError(f"run must hold {WEIGHTS}, got {run}")
    weights = load_file(path)["weights"]
    count = sum(math.prod(shape) for _, shape in layout_of(spec))
    if weights.shape != (count,):
        raise InputError(f"{path}: must hold {count} weights, got {tuple(weights.shape)}")
    return weights, collect(run, spec, last_step(run / LOG))


def mixed(
    spec: ModelSpec, weights: Tensor, provenance: dict[str, Any], share: float
) -> tuple[Tensor, dict[str, Any]]:
    """A mean of weights and those that the model has by now, and where it is from.

    Between weights before and after a training lie some that do what both do well (Wortsman et al.
    2022, Robust fine-tuning of zero-shot models).

    Parameters
    ----------
    spec
        Of the model.
    weights : (n,)
        Those of a run.
    provenance
        Theirs.
    share
        Of them in the mean, (0, 1].

    Raises
    ------
    InputError
        ``share`` is out of its range.
    """
    if not 0 < share <= 1:
        raise InputError(f"share must be above 0 and at most 1, got {share:g}")
    if share == 1:
        return weights, provenance
    before = find_model(spec.name)
    tensors = parse_onnx(read_bytes(before.path)).graph.tensors
    earlier = torch.from_numpy(join(tensors, layout_of(spec)))
    origin = {**origin_of(before), "share_of_its_weights": round(1 - share, 6)}
    return torch.lerp(earlier, weights, share), {**provenance, "started_from": origin}


def main(
    model: Annotated[str, typer.Argument(help="A specification's name.")] = "online",
    run: Annotated[
        Path | None, typer.Option(help="Folder of `stillray_training.online.warm`.")
    ] = None,
    out: Annotated[Path, typer.Option(help="Folder for the .onnx files.")] = Path(
        "runtime/stillray/models"
    ),
    share: Annotated[
        float, typer.Option(help="Of the run's weights in a mean with those of the model by now.")
    ] = 1.0,
) -> None:
    """Export a model, which nothing has taught yet unless there is a run, and its step."""
    spec = load(model)
    weights, about = mixed(spec, *_begin(spec, run), share)
    files = {
        out / UNLISTED / f"{spec.name}.onnx": network_file(spec, weights, about),
        out / "steps" / STEP_NAME: step_file(spec),
    }
    for path, data in files.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_path(path) as temporary:
            temporary.write_bytes(data)
        print(f"{path}: {len(data) // 1024} KiB")


if __name__ == "__main__":
    program.run(main)
