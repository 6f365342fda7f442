"""The graph of a frame alone beside the runtime, as a host runs it that keeps nothing."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

torch = pytest.importorskip("torch")

import stillray  # noqa: E402
from stillray.cli import main  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.models.registry import find_model  # noqa: E402
from stillray_export.frame_graph.color_curve import ColorCurve, decoded, encoded  # noqa: E402
from stillray_export.frame_graph.export import write_spatial  # noqa: E402
from stillray_export.frame_graph.moving import sequence  # noqa: E402
from stillray_export.frame_graph.spatial import unit_normals  # noqa: E402

#: dB of tone-mapped pictures
PARITY = 80


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """Graphs by model and curve, made and opened when they are first asked for."""

    @cache
    def made(name, curve):
        folder = tmp_path_factory.mktemp("spatial")
        return Graph(write_spatial(find_model(name), folder, ColorCurve(curve)))

    return made


class Graph:
    """A spatial graph as a host runs it, on planes ``(h, w, 9)``."""

    def __init__(self, path):
        import onnxruntime as ort

        self.path = path
        self.session = ort.InferenceSession(str(path), providers=["CPUExecutionProvider"])

    def __call__(self, planes):
        (source,) = self.session.get_inputs()
        (picture,) = self.session.run(None, {source.name: planes.transpose(2, 0, 1)[None]})
        return picture[0].transpose(1, 2, 0)


def planes_of(frame, color):
    """The planes of a frame, ``(h, w, 9)``, in the order that mapping tables say."""
    return np.concatenate([color, frame.albedo, frame.normal], 2)


def alone(name, frame):
    """The runtime's picture of a frame without a past; depth does not reach a spatial host."""
    given = Frame(color=frame.color, albedo=frame.albedo, normal=frame.normal)
    with stillray.Denoiser(name, threads=1, precision="float32", temporal=False) as denoiser:
        return denoiser.denoise(given)


def decibels(got, wanted):
    got, wanted = (image / (1 + image) for image in (got, wanted))
    return -10 * np.log10(np.square(got - wanted).mean() + 1e-30)


def code_of(frame, exposure=1.0):
    """Color through the curve of Open Image Denoise."""
    return encoded(torch.from_numpy(frame.color * np.float32(exposure)), ColorCurve.OIDN).numpy()


def test_a_frame_of_odd_size_with_broken_pixels_is_the_runtimes(exported):
    (frame,) = sequence(1, 61, 91)
    got = exported("kpyr-5", "linear")(planes_of(frame, frame.color))
    assert decibels(got, alone("kpyr-5", frame)) > PARITY


@pytest.mark.parametrize("size", [(1, 1), (17, 40), (50, 37)])
def test_colour_through_the_curve_of_open_image_denoise_at_any_exposure(exported, size):
    (frame,) = sequence(1, *size, broken=False)
    wanted, graph = alone("kpyr-5s", frame), exported("kpyr-5s", "oidn")
    for exposure in (0.02, 7.0):
        got = graph(planes_of(frame, code_of(frame, exposure)))
        assert 0 <= got.min() <= got.max() <= 1
        got = decoded(torch.from_numpy(got), ColorCurve.OIDN).numpy() / exposure
        assert decibels(got, wanted) > PARITY


def test_normals_moved_to_0_to_1_are_the_same_normals(exported):
    (frame,) = sequence(1, 33, 50, broken=False)
    moved, without = (
        Frame(color=frame.color, albedo=frame.albedo, normal=normal)
        for normal in (frame.normal / 2 + 0.5, 0 * frame.normal)
    )
    graph, code = exported("kpyr-5s", "oidn"), code_of(frame)
    got, wanted, other = (graph(planes_of(each, code)) for each in (moved, frame, without))
    assert decibels(got, wanted) > PARITY
    assert decibels(other, wanted) < PARITY


def test_a_frame_that_shows_no_surface_has_no_normals():
    for nothing in (0.0, 0.5):
        assert not unit_normals(torch.full((1, 3, 4, 5), nothing)).any()


def test_the_curve_is_that_of_open_image_denoise():
    # of an exposed radiance of 1e-6, 0.01, 0.5, 10 and 65504, worked out in float64 by its formulas
    radiance = torch.tensor([0.0, 1e-6, 0.01, 0.5, 10.0, 65504.0, 1e9])
    code = encoded(radiance, ColorCurve.OIDN)
    wanted = [0, 4.506488e-4, 7.107096e-2, 2.766977e-1, 4.600595e-1, 1, 1]
    np.testing.assert_allclose(code, wanted, rtol=1e-5)
    np.testing.assert_allclose(decoded(code, ColorCurve.OIDN)[:-1], radiance[:-1], rtol=1e-4)
    assert decoded(torch.tensor([float("nan")]), ColorCurve.OIDN).isnan()


def test_a_spatial_graph_takes_and_gives_images_of_any_size_and_tells_of_them(exported, capsys):
    import onnx

    path = exported("kpyr-5s", "oidn").path
    graph = onnx.load_model(str(path)).graph
    shapes = [
        [part.dim_value or part.dim_param for part in value.type.tensor_type.shape.dim]
        for value in (*graph.input, *graph.output)
    ]
    assert shapes == [[1, 9, "height", "width"], [1, 3, "height", "width"]]
    assert not {node.op_type for node in graph.node} & {"If", "Loop", "NonZero", "IsNaN", "Split"}
    assert main(["info", str(path), "--graph"]) == 0
    assert "planes 0 to 2 color" in capsys.readouterr().out


def test_a_spatial_graph_is_not_taken_for_a_model(exported):
    with pytest.raises(InputError, match=r"the model is kpyr-5s\.onnx"):
        find_model(exported("kpyr-5s", "oidn").path)
