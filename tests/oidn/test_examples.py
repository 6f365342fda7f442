"""Programs as pyoidn's documentation shows them, on pyoidn itself and on stillray's module."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from stillray import read_exr
from stillray.errors import InputError

ROOM = Path(__file__).parents[1] / "data/room"
#: Share of the noisy picture's distance to the reference that may be left.
LEFT = 0.5


@pytest.fixture(params=["pyoidn", "stillray.oidn"])
def module(request):
    pytest.importorskip(request.param)
    return importlib.import_module(request.param)


@pytest.fixture(scope="module")
def room():
    """A rendered frame as contiguous images of a size that both are quick at, and its reference."""
    frame, reference = (read_exr(ROOM / name) for name in ("frame_0007.exr", "ref_0007.exr"))
    near = np.s_[20:116, 60:188]
    images = {
        name: np.ascontiguousarray(getattr(frame, name)[near], np.float32)
        for name in ("color", "albedo", "normal")
    }
    return images, reference.color[near]


def distance(image, truth):
    """Of tone-mapped radiance."""
    image, truth = (np.maximum(part, 0) / (1 + np.maximum(part, 0)) for part in (image, truth))
    return np.sqrt(np.mean((image - truth) ** 2))


def is_clean(result, room):
    images, truth = room
    return distance(result, truth) < LEFT * distance(images["color"], truth)


def bind(module, made, images, result):
    for name, image in images.items():
        made.set_image(name, image, module.OIDN_FORMAT_FLOAT3)
    made.set_image(module.OIDN_IMAGE_OUTPUT, result, module.OIDN_FORMAT_FLOAT3)


def test_one_call(module, room):
    images, _ = room
    before = {name: image.copy() for name, image in images.items()}
    result = module.denoise(**images, hdr=True, quality="fast")
    assert result.dtype == np.float32
    assert is_clean(result, room)
    for name, image in images.items():
        np.testing.assert_array_equal(image, before[name])
    strided = module.denoise(images["color"][:, ::-1], hdr=True, quality="fast")
    assert strided.flags.c_contiguous


def test_a_device_and_a_filter_with_errors_asked_for(module, room):
    images, _ = room
    result = np.empty_like(images["color"])
    with module.Device(module.OIDN_DEVICE_TYPE_CPU) as device:
        assert device.get_error() is None
        device.set_int("numThreads", 0)
        device.commit()
        made = module.Filter(device, module.OIDN_FILTER_TYPE_RT)
        try:
            bind(module, made, images, result)
            made.set_bool("hdr", True)
            made.set_bool("cleanAux", False)
            made.set_quality(module.OIDN_QUALITY_FAST)
            made.commit()
            made.execute()
            assert device.get_error() is None
        finally:
            made.release()
    assert is_clean(result, room)


def test_asynchronous_and_again_with_other_pixels(module, room):
    images, _ = room
    images = {name: image.copy() for name, image in images.items()}
    result = np.zeros_like(images["color"])
    device = module.Device()
    device.commit()
    made = module.Filter(device, "RT")
    bind(module, made, images, result)
    made.set_bool("hdr", True)
    made.set_quality(module.OIDN_QUALITY_FAST)
    made.commit()
    made.execute_async()
    device.wait()
    assert device.get_error() is None
    assert is_clean(result, room)
    first = result.copy()
    images["color"] *= 2  # bound already: nothing is committed again
    made.execute()
    assert device.get_error() is None
    assert result.mean() == pytest.approx(2 * first.mean(), rel=0.05)
    made.release()
    device.release()


def test_through_buffers(module, room):
    images, _ = room
    color = images["color"]
    height, width = color.shape[:2]
    result = np.empty_like(color)
    with module.Device() as device:
        device.commit()
        source, target = (module.Buffer(device, color.nbytes) for _ in range(2))
        source.write(0, color.nbytes, color)
        made = module.Filter(device)
        for name, held in (("color", source), ("output", target)):
            made.set_image(name, held, module.OIDN_FORMAT_FLOAT3, width, height)
        made.set_bool("hdr", True)
        made.set_quality(module.OIDN_QUALITY_FAST)
        made.commit()
        made.execute()
        assert device.get_error() is None
        target.read(0, color.nbytes, result)
        made.release()
        source.release()
        target.release()
    assert is_clean(result, room)


def test_a_lightmap(module, room):
    images, _ = room
    result = module.denoise(images["color"], quality="fast", filter_type="RTLightmap")
    assert is_clean(result, room)


def test_what_is_forgotten_is_an_error(module, room):
    """Of pyoidn kept for whoever asks; here too, or raised at once where arguments are wrong."""
    images, _ = room
    with module.Device() as device:
        device.commit()
        made = module.Filter(device)
        made.set_image("color", images["color"], module.OIDN_FORMAT_FLOAT3)
        try:
            made.commit()
            made.execute()
        except InputError:
            return
        assert device.get_error()
        assert device.get_error() is None
        made.release()
