"""``python -m stillray_export.quantize kpyr-5 --data DATA``: its network in integers of 8 bits.

``NAME.int8.onnx`` is written beside ``NAME.onnx``, and ``NAME.int8.pairs.onnx``, which takes pixels
by twos, where a network has few planes. Convolutions of 8-bit integers are half as dear
where a processor has instructions for them (`stillray.models.precision`), and a plane that is kept
between them is a quarter of the bytes. What the network gives are logits of weights, whose mean
stays a mean however they are rounded.

Scales are those of the frames in DATA: sequences that a model was trained on, never what it is
measured on. Made by ONNX Runtime's own quantisation: a scale for each output of a convolution, one
for each image, the least to the greatest value that was met. Then `stillray_export.small_sums` sees
to it that no processor's sums overflow, `stillray_export.bias_correction` takes back what rounded
weights shift, and `stillray_export.integer_layout` and `stillray_export.spare_planes` arrange
planes as processors take them faster.
"""

from __future__ import annotations

import json
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import onnx
import typer
from onnx import TensorProto, helper, numpy_helper
from onnxruntime.quantization import (
    CalibrationDataReader,
    CalibrationMethod,
    QuantFormat,
    QuantType,
    quantize_static,
)

from stillray.cli import program
from stillray.errors import InputError
from stillray.families.contract import Engine
from stillray.frame import Frame
from stillray.io.atomic import atomic_path
from stillray.models.precision import int8_path, made_of, pairs_path
from stillray.models.registry import ModelInfo, find_model, require_fit
from stillray.models.session import checked
from stillray.models.steps import PLACES_KEY
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.opening import engine_of_model, family_of_model
from stillray_export.bias_correction import correct_biases
from stillray_export.integer_layout import arrange
from stillray_export.plane_order import order_features
from stillray_export.small_sums import weight_scales
from stillray_export.spare_planes import add_spare_planes
from stillray_training.blocks import frames_of, mean_frame, read_blocks
from stillray_training.rendered import albedo_frame
from stillray_training.run import sequences_in
from stillray_training.targets import read_filter

#: Operators that take and give integers; what else there is stays float32.
OPERATORS = ("Add", "Clip", "Concat", "Conv", "MaxPool", "Mul", "Relu", "Resize", "Slice")


def quantized(
    model: Path, features: Sequence[np.ndarray], *, shift_biases: bool = True
) -> onnx.ModelProto:
    """A network in integers, whose sums of products no processor overflows.

    Parameters
    ----------
    model
        The .onnx file of a network of floats.
    features : (1, features, h, w) float32 each
        What it is to be given: scales and biases fit to what it makes of these, of their upper
        left in the size of the smallest.
    shift_biases
        Whether biases take back what rounded weights shift in the mean of these frames. In frames
        of little noise it is another shift: networks of stills are worse for it there.
    """
    # ONNX Runtime's calibration stacks what a layer gives
    height, width = np.min([planes.shape[2:] for planes in features], axis=0)
    floats = onnx.load(model)
    places = order_features(floats.graph)
    order = np.argsort(places)
    features = [np.ascontiguousarray(planes[:, order, :height, :width]) for planes in features]
    with tempfile.TemporaryDirectory() as folder:
        given, made = Path(folder) / "floats.onnx", Path(folder) / "int8.onnx"
        onnx.save(floats, given)
        quantize_static(
            given,
            made,
            _Features(features),
            quant_format=QuantFormat.QDQ,
            activation_type=QuantType.QUInt8,
            weight_type=QuantType.QInt8,
            per_channel=True,
            op_types_to_quantize=list(OPERATORS),
            calibrate_method=CalibrationMethod.Percentile,
            extra_options={
                "CalibPercentile": 99.999,
                "TensorQuantOverrides": weight_scales(floats.graph),
            },
        )
        found = onnx.load(made)
    for tensor in found.graph.initializer:
        # one way to hold numbers, which the runtime reads
        tensor.CopyFrom(numpy_helper.from_array(numpy_helper.to_array(tensor), tensor.name))
    del found.graph.value_info[:]
    if shift_biases:
        correct_biases(floats, found, features)
    take_pixels(found.graph)
    told = {entry.key: entry.value for entry in floats.metadata_props}
    del found.metadata_props[:]
    told[PLACES_KEY] = json.dumps(places)
    helper.set_model_props(found, {**told, **made_of(model.read_bytes())})
    return found


def take_pixels(graph: onnx.GraphProto) -> None:
    """Let a network in integers take its input as integers, and pixels one after the other.

    ONNX Runtime computes with pixels, whose planes lie side by side. It would read planes of floats
    to make integers of them, once for each operator that takes some, and turn those on one thread;
    whoever makes the planes does both while they are in the cache.

    Parameters
    ----------
    graph
        Of ONNX Runtime's quantisation: ``features`` are made integers, whole or by parts. Changed.
    """
    (features,) = [source for source in graph.input if source.name == "features"]
    shape = features.type.tensor_type.shape.dim
    _, planes, *size = [axis.dim_param or axis.dim_value for axis in shape]
    turned = helper.make_node(
        "Transpose", ["features"], ["integers"], perm=[0, 3, 1, 2], name="planes_of_pixels"
    )
    takers: dict[str, list[onnx.NodeProto]] = {}
    for node in graph.node:
        takers.setdefault(next(iter(node.input), ""), []).append(node)
    for node in list(takers["features"]):
        if node.op_type == "Slice":
            (made,) = takers[node.output[0]]
            node.input[0] = "integers"
            integers = node.output[0]
        else:
            made, integers = node, "integers"
        if made.op_type != "QuantizeLinear":
            raise InputError(f"features must be made integers, got {made.op_type}")
        for taken in takers[made.output[0]]:
            taken.input[0] = integers
        graph.node.remove(made)
    graph.node.insert(0, turned)
    features.CopyFrom(
        helper.make_tensor_value_info("features", TensorProto.UINT8, [1, *size, planes])
    )


class _Features(CalibrationDataReader):  # type: ignore[misc]
    """What ONNX Runtime asks for, one after the other."""

    def __init__(self, features: Sequence[np.ndarray]) -> None:
        self._left = iter(features)

    def get_next(self) -> dict[str, np.ndarray] | None:
        given = next(self._left, None)
        return None if given is None else {"features": given}


class _Listening(Engine):
    """Runs a network, and keeps what it was given last."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self.given: np.ndarray | None = None

    def run(self, graph: str, inputs: Any) -> dict[str, Any]:
        """As the engine's own."""
        self.given = np.array(inputs["features"])
        return self._engine.run(graph, inputs)

    def close(self) -> None:
        """As the engine's own."""
        self._engine.close()


def features_of(model: ModelInfo, sequence: Path, between: int = 0) -> Iterator[np.ndarray]:
    """What a model's network is given of a sequence: some of its frames, and a still.

    They are the first, the second and the last one, and one between, not the same in all sequences:
    where a frame's samples lie in its pixels comes in the same order in each.

    Parameters
    ----------
    model
        The model.
    sequence
        As `stillray_training.simulate` writes them. Where its last frame comes in blocks of
        samples, the still is of all but the largest.
    between
        Counts frames from the third one on, and again from there where there are no more.
    """
    frames = frames_of(sequence)
    if not frames:
        raise InputError(f"{sequence}: must hold frames, frame_0000.exr and on")
    spread, last = read_filter(sequence), len(frames) - 1
    chosen = {0, 1, 2 + between % max(last - 2, 1), last}
    engine = _Listening(engine_of_model(model, 1, None))
    with closing(engine), Denoiser(model, threads=1, engine=engine) as denoiser:
        for index, frame in enumerate([*frames, *_still(sequence, frames[-1])]):
            if index == len(frames):
                denoiser.reset()
            if model.spec.training.layer == "albedo":
                frame = albedo_frame(frame)
            denoiser.denoise(replace(frame, filter_spread=spread))
            if index in chosen or index > last:
                assert engine.given is not None
                yield engine.given


def _still(sequence: Path, last: Frame) -> list[Frame]:
    blocks = read_blocks(sequence, last, 1.0)
    return [mean_frame(blocks[:-1])] if len(blocks) > 1 else []


def main(
    model: Annotated[str, typer.Argument(help="The model, or the path of its .onnx file.")],
    data: Annotated[list[Path], typer.Option(help="Folder of sequences; repeatable.")],
    most: Annotated[
        int, typer.Option(min=1, help="Sequences of each folder of data at most.")
    ] = 24,
    shift_biases: Annotated[
        bool,
        typer.Option(help="Let biases take back what rounding shifts in the mean of the frames."),
    ] = True,
) -> None:
    """Write the network of a model in integers of 8 bits beside it."""
    info = find_model(model)
    features: list[np.ndarray] = []
    for folder in data:
        sequences = sequences_in([folder])
        for number, sequence in enumerate(sequences[:: -(-len(sequences) // most)]):
            features += features_of(info, sequence, number)
    network = quantized(info.path, features, shift_biases=shift_biases)
    # both are made before either takes the place of what is there
    pixels, pairs = (_arranged(network, info, pairs=pairs) for pairs in (False, True))
    assert pixels is not None
    files = {int8_path(info.path): pixels.SerializeToString()}
    if pairs is not None:
        told = {entry.key: entry.value for entry in pairs.metadata_props}
        helper.set_model_props(pairs, told | made_of(files[int8_path(info.path)]))
        files[pairs_path(info.path)] = pairs.SerializeToString()
    else:
        pairs_path(info.path).unlink(missing_ok=True)
    for path, made in files.items():
        with atomic_path(path) as temporary:
            temporary.write_bytes(made)
        print(f"{path}: of {len(features)} frames")


def _arranged(network: onnx.ModelProto, info: ModelInfo, *, pairs: bool) -> onnx.ModelProto | None:
    """A copy as processors take it; None of pairs of pixels that a network does not have."""
    copied = onnx.ModelProto()
    copied.CopyFrom(network)
    integers_out = family_of_model(info).traits.integers
    if arrange(copied.graph, integers_out=integers_out, pairs=pairs) != pairs:
        return None
    add_spare_planes(copied.graph, pairs=pairs)
    # what the runtime would refuse is found here, not by who runs the model
    require_fit(checked(copied.SerializeToString(), info.name)[1], info.spec, info.name)
    return copied


if __name__ == "__main__":
    program.run(main)
