"""Programs written for pyoidn, run on `stillray.oidn`."""

from __future__ import annotations

import ctypes
import inspect
import multiprocessing
from functools import cache

import numpy as np
import pytest

import stillray
import stillray.oidn as pyoidn
from stillray.arrays import srgb
from stillray.errors import InputError
from tests.conftest import clean_color, make_frame

HEIGHT, WIDTH = 48, 40


@pytest.fixture
def frame():
    return make_frame(HEIGHT, WIDTH)


@pytest.fixture(scope="module")
def shared_device():
    with pyoidn.Device() as made:
        made.set_int("numThreads", 1)
        made.commit()
        yield made


@pytest.fixture
def device(shared_device):
    shared_device.wait()
    shared_device.get_error()
    return shared_device


@cache
def denoiser_of(model):
    return stillray.Denoiser(model, threads=1, temporal=False)


def bare(color, model="fast", **buffers):
    return denoiser_of(model).denoise(stillray.Frame(color=color, **buffers))


def run(device, images, *, filter_type="RT", quality=pyoidn.OIDN_QUALITY_FAST, **flags):
    """What a filter makes of float32 images."""
    result = np.empty_like(next(iter(images.values())))
    with pyoidn.Filter(device, filter_type) as made:
        for name, image in {**images, "output": result}.items():
            made.set_image(name, image, pyoidn.OIDN_FORMAT_FLOAT3)
        for name, value in flags.items():
            made.set_bool(name, value)
        made.set_quality(quality)
        made.commit()
        made.execute()
    assert device.get_error() is None
    return result


# What is offered


def test_every_public_name_and_signature_is_there():
    theirs = pytest.importorskip("pyoidn")
    missing = set(theirs.__all__) - set(pyoidn.__all__) - {"utils"}  # of cffi, for themselves
    assert missing == set()
    for name in theirs.__all__:
        if name.startswith("OIDN_"):
            assert getattr(pyoidn, name) == getattr(theirs, name), name
    assert named(pyoidn.denoise) == named(theirs.denoise)
    for kind in ("Device", "Filter", "Buffer"):
        for name, member in vars(getattr(theirs, kind)).items():
            if name.startswith("_") and name != "__init__":
                continue
            own = inspect.getattr_static(getattr(pyoidn, kind), name)
            assert type(own) is type(member), f"{kind}.{name}"
            if not isinstance(member, property):
                own, member = (getattr(m, "__func__", m) for m in (own, member))
                assert named(own) == named(member), f"{kind}.{name}"


def named(function):
    parameters = inspect.signature(function).parameters.values()
    return [(p.name, p.kind, p.default) for p in parameters]


# One call


def test_denoise_is_the_bare_denoiser(frame):
    before = frame.color.copy()
    buffers = {"albedo": frame.albedo, "normal": frame.normal}
    clean = pyoidn.denoise(frame.color, **buffers, hdr=True, quality="fast")
    np.testing.assert_array_equal(clean, bare(frame.color, **buffers))
    np.testing.assert_array_equal(frame.color, before)
    high = pyoidn.denoise(frame.color, **buffers, hdr=True)  # the best, unless told otherwise
    np.testing.assert_array_equal(high, bare(frame.color, "high", **buffers))
    lightmap = pyoidn.denoise(frame.color, quality=4, filter_type="RTLightmap")
    np.testing.assert_array_equal(lightmap, bare(frame.color))


def test_denoise_keeps_the_type_and_takes_views(frame):
    half = frame.color.astype(np.float16)
    clean = pyoidn.denoise(half[::2, ::-1], hdr=True, quality="fast")
    assert clean.dtype == np.float16
    assert clean.flags.c_contiguous
    np.testing.assert_array_equal(clean, bare(half[::2, ::-1]).astype(np.float16))


def test_denoise_takes_and_gives_tensors(frame):
    torch = pytest.importorskip("torch")
    color = torch.from_numpy(frame.color).requires_grad_()
    clean = pyoidn.denoise(color, albedo=torch.from_numpy(frame.albedo), quality="fast", hdr=True)
    assert isinstance(clean, torch.Tensor)
    assert not clean.requires_grad
    assert clean.dtype == torch.float32
    np.testing.assert_array_equal(clean.numpy(), bare(frame.color, albedo=frame.albedo))
    with pytest.raises(TypeError, match="albedo must be of color's kind"):
        pyoidn.denoise(color, albedo=frame.albedo)


@pytest.mark.parametrize(
    ("error", "arguments", "words"),
    [
        (TypeError, {"color": [[1.0]]}, "color must be a NumPy array"),
        (TypeError, {"color": np.zeros((4, 4, 3))}, "float16 or float32, got float64"),
        (ValueError, {"color": np.zeros((4, 4, 4), np.float32)}, r"\(4, 4, 4\)"),
        (ValueError, {"albedo": np.zeros((4, 5, 3), np.float32)}, "albedo must have color's shape"),
        (TypeError, {"hdr": 1}, "hdr and clean_aux must be bools"),
        (TypeError, {"quality": True}, "quality must be a name"),
        (ValueError, {"quality": "best"}, "quality must be one of high"),
        (ValueError, {"quality": 1}, "OIDN_QUALITY"),
        (ValueError, {"filter_type": "RTX"}, "filter_type must be RT or RTLightmap"),
        (ValueError, {"filter_type": "RTLightmap", "clean_aux": True}, "with RTLightmap"),
    ],
)
def test_wrong_arguments_are_refused_in_words(error, arguments, words):
    with pytest.raises(error, match=words):
        pyoidn.denoise(**{"color": np.zeros((4, 4, 3), np.float32), **arguments})


def _denoise_in_child(queue):
    queue.put(pyoidn.denoise(np.full((8, 8, 3), 0.5, np.float32), quality="fast"))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
def test_a_forked_child_denoises_too():
    parents = pyoidn.denoise(np.full((8, 8, 3), 0.5, np.float32), quality="fast")
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_denoise_in_child, args=(queue,), daemon=True)
    child.start()
    np.testing.assert_array_equal(queue.get(timeout=300), parents)
    child.join()


# Filters


def test_filter_is_the_bare_denoiser(frame, device):
    images = {"color": frame.color, "albedo": frame.albedo, "normal": frame.normal}
    np.testing.assert_array_equal(run(device, images, hdr=True, cleanAux=True), bare(**images))
    # lightmaps are HDR, and what normals say of edges is used
    images = {"color": frame.color, "normal": frame.normal}
    np.testing.assert_array_equal(run(device, images, filter_type="RTLightmap"), bare(**images))


def test_low_range_is_clipped_and_srgb_is_linear_light(frame, device):
    clipped = np.clip(frame.color, 0, 1)
    images = {"color": frame.color, "albedo": frame.albedo}
    expected = np.clip(bare(clipped, albedo=frame.albedo), 0, 1)
    np.testing.assert_array_equal(run(device, images), expected)
    images["color"] = srgb.encode(clipped)
    np.testing.assert_allclose(run(device, images, srgb=True), srgb.encode(expected), atol=2e-5)


@pytest.mark.parametrize("value", [-1.0, -0.25, 0.0, 0.7, 1.0])
def test_constant_normals_and_directions_stay(value, device):
    image = np.full((16, 12, 3), value, np.float32)
    alone = run(device, {"normal": image})
    direction = run(device, {"color": image}, filter_type="RTLightmap", directional=True)
    np.testing.assert_allclose(alone, image, atol=1e-5)
    np.testing.assert_allclose(direction, image, atol=1e-5)


def test_noise_goes_from_color_and_from_guides_alone(frame, device):
    rng = np.random.default_rng(1)

    def distance(image, truth):
        return np.sqrt(np.mean((image - truth) ** 2))

    truth = clean_color(HEIGHT, WIDTH)
    clean = run(device, {"color": frame.color, "albedo": frame.albedo}, hdr=True)
    assert distance(clean, truth) < 0.3 * distance(frame.color, truth)
    inner = (slice(4, 20), slice(4, 9))  # of the wall: edges of guides alone grow soft
    for name, guide in (("albedo", frame.albedo), ("normal", frame.normal)):
        noisy = (guide + rng.normal(0, 0.1, guide.shape)).astype(np.float32)
        filtered = run(device, {name: noisy})[inner]
        assert distance(filtered, guide[inner]) < 0.6 * distance(noisy[inner], guide[inner]), name


def test_buffers_with_strides_and_offsets_in_order_of_calls(frame, device):
    padded = np.full((HEIGHT, WIDTH + 3, 4), np.nan, np.float32)
    padded[:, :WIDTH, :3] = frame.color
    where = {
        "width": WIDTH,
        "height": HEIGHT,
        "byte_offset": 8,
        "pixel_byte_stride": 16,
        "row_byte_stride": 16 * (WIDTH + 3),
    }
    result = np.zeros_like(padded)
    with (
        pyoidn.Buffer(device, padded.nbytes + 8) as source,
        pyoidn.Buffer(device, padded.nbytes + 8, storage=pyoidn.OIDN_STORAGE_HOST) as target,
        pyoidn.Filter(device) as made,
    ):
        made.set_image("color", source, pyoidn.OIDN_FORMAT_FLOAT3, **where)
        made.set_image("output", target, pyoidn.OIDN_FORMAT_FLOAT3, **where)
        made.set_bool("hdr", True)
        made.set_value("quality", pyoidn.OIDN_QUALITY_FAST)
        made.commit()
        source.write_async(8, padded.nbytes, padded)
        made.execute_async()
        target.read_async(8, padded.nbytes, result)
        device.wait()
    assert device.get_error() is None
    np.testing.assert_array_equal(result[:, :WIDTH, :3], bare(frame.color))
    assert not result[:, WIDTH:].any()
    assert not result[..., 3].any()


def test_in_place_in_half_and_again_after_pixels_change(frame, device):
    image = frame.color.astype(np.float16)
    with pyoidn.Filter(device) as made:
        for name in ("color", "output"):
            made.set_image(name, image, pyoidn.OIDN_FORMAT_HALF3)
        made.set_bool("hdr", True)
        made.set_quality(pyoidn.OIDN_QUALITY_FAST)
        made.commit()
        made.execute()
        np.testing.assert_array_equal(image, bare(frame.color.astype(np.float16)).astype("f2"))
        image[:] = 0.5
        made.execute()
    assert device.get_error() is None
    np.testing.assert_allclose(image, 0.5, rtol=1e-3)


def test_one_channel_is_filtered_as_grey(frame, device):
    grey = np.ascontiguousarray(frame.color[..., 1])
    result = np.empty_like(grey)
    with pyoidn.Filter(device) as made:
        made.set_image("color", grey, pyoidn.OIDN_FORMAT_FLOAT)
        made.set_image("output", result, pyoidn.OIDN_FORMAT_FLOAT)
        made.set_bool("hdr", True)
        made.set_quality(pyoidn.OIDN_QUALITY_FAST)
        made.commit()
        made.execute()
    np.testing.assert_array_equal(result, bare(np.repeat(grey[..., None], 3, axis=2))[..., 0])


def _commit_nothing(device, made, image):
    made.set_image("color", image, 3)
    made.execute()


def _no_output(device, made, image):
    made.set_image("color", image, 3)
    made.commit()
    made.execute()


def _no_color(device, made, image):
    for name in ("albedo", "normal", "output"):
        made.set_image(name, image, 3)
    made.commit()
    made.execute()


def _sizes(device, made, image):
    for name in ("color", "output"):
        made.set_image(name, image, 3)
    made.set_image("albedo", image[:4].copy(), 3)
    made.commit()
    made.execute_async()
    device.wait()


def _too_little_memory(device, made, image):
    for name in ("color", "output"):
        made.set_image(name, image, 3)
    made.set_int("maxMemoryMB", 0)
    made.commit()
    made.execute()


def _after_release(device, made, image):
    for name in ("color", "output"):
        made.set_image(name, image, 3)
    made.commit()
    made.release()
    made.execute()


@pytest.mark.parametrize(
    ("steps", "words"),
    [
        (_commit_nothing, "not committed"),
        (_no_output, "output must be set"),
        (_no_color, "color must be given"),
        (_sizes, "albedo must have color's size"),
        (_too_little_memory, "max_memory must be"),
        (_after_release, "released"),
    ],
)
def test_what_fails_is_kept_until_asked_for(steps, words, device):
    image = np.full((8, 8, 3), 0.5, np.float32)
    steps(device, pyoidn.Filter(device), image)
    assert words in device.get_error()
    assert device.get_error() is None
    assert (image == 0.5).all()


def test_images_that_do_not_lie_in_their_memory_are_refused(device):
    made = pyoidn.Filter(device)
    image = np.zeros((4, 5, 3), np.float32)
    with pytest.raises(InputError, match="within its memory of 240 bytes"):
        made.set_image("color", image, pyoidn.OIDN_FORMAT_FLOAT3, byte_offset=1)
    with pytest.raises(InputError, match="width and height"):
        made.set_image("color", pyoidn.Buffer(device, 240), pyoidn.OIDN_FORMAT_FLOAT3)
    with pytest.raises(InputError, match="color must be float32 for its format, got float64"):
        made.set_image("color", image.astype(np.float64), pyoidn.OIDN_FORMAT_FLOAT3)
    with pytest.raises(InputError, match="data_format"):
        made.set_image("color", image, pyoidn.OIDN_FORMAT_FLOAT4)
    with pytest.raises(InputError, match="contiguous"):
        made.set_image("color", image[:, ::2], pyoidn.OIDN_FORMAT_FLOAT3)
    with pytest.raises(InputError, match="name must be one of color"):
        made.set_image("colour", image, pyoidn.OIDN_FORMAT_FLOAT3)
    image.flags.writeable = False
    with pytest.raises(InputError, match="output must be writable"):
        made.set_image("output", image, pyoidn.OIDN_FORMAT_FLOAT3)
    with pytest.raises(TypeError, match="NumPy array"):
        made.set_image("color", [1.0], pyoidn.OIDN_FORMAT_FLOAT3)
    with pytest.raises(InputError, match="filter_type"):
        pyoidn.Filter(device, "RTX")


# Devices and buffers


def test_device_parameters():
    device = pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_DEFAULT)
    assert device.get_int("type") == pyoidn.OIDN_DEVICE_TYPE_CPU
    assert device.get_int("versionMajor") == int(pyoidn.version.oidn_version.split(".")[0])
    device.set_uint("numThreads", 2)
    device.set_bool("setAffinity", True)
    assert (device.get_uint("numThreads"), device.get_bool("setAffinity")) == (2, True)
    assert device.get_error() is None
    device.set_int("numTreads", 2)
    assert "numTreads" in device.get_error()
    with pytest.raises(ValueError, match="value must be 0 or more, got -1"):
        device.set_uint("numThreads", -1)
    device.release()
    device.release()
    assert pyoidn.Device.is_cpu_available()
    assert not pyoidn.Device.is_cuda_available()


def test_other_devices_do_not_exist():
    device = pyoidn.Device(pyoidn.OIDN_DEVICE_TYPE_CUDA)
    assert "CPU" in device.get_error()
    device.commit()
    assert "unsupported" in device.get_error()
    assert pyoidn.Device.from_torch("cpu").get_error() is None
    with pytest.raises(ValueError, match="got cuda"):
        pyoidn.Device.from_torch("cuda:0")


def test_buffers_hold_bytes(device):
    with pyoidn.Buffer(device, 32) as buffer:
        assert (buffer.size, buffer.storage) == (32, pyoidn.OIDN_STORAGE_HOST)
        buffer.write(8, 8, bytes(range(8)))
        got = bytearray(32)
        buffer.read(0, 32, got)
        assert bytes(got) == bytes(8) + bytes(range(8)) + bytes(16)
        assert ctypes.string_at(buffer.get_data() + 8, 8) == bytes(range(8))
        with pytest.raises(ValueError, match="within 32 bytes"):
            buffer.read(30, 4, bytearray(4))
        with pytest.raises(ValueError, match="byte_offset must be 0 or more"):
            buffer.write(-1, 4, b"abcd")
        with pytest.raises(ValueError, match="src must hold 4 bytes, got 3"):
            buffer.write(0, 4, b"abc")
        with pytest.raises(ValueError, match="dst must be writable"):
            buffer.read(0, 4, b"abcd")
    buffer.release()
    with pytest.raises(ValueError, match="byte_size must be 0 or more, got -1"):
        pyoidn.Buffer(device, -1)


@pytest.mark.parametrize("pointer", ["int", "ctypes", "cffi", "numpy"])
def test_shared_buffers_are_the_callers_memory(device, pointer):
    array = np.arange(32, dtype=np.uint8)
    if pointer == "numpy":
        buffer = pyoidn.Buffer.shared_from_numpy(device, array)
    else:
        address = array.ctypes.data
        if pointer == "ctypes":
            address = ctypes.c_void_p(address)
        elif pointer == "cffi":
            address = pytest.importorskip("cffi").FFI().cast("void *", address)
        buffer = pyoidn.Buffer.shared(device, address, array.nbytes)
    buffer.write(4, 4, b"abcd")
    assert array[4:8].tobytes() == b"abcd"
    with pytest.raises(ValueError, match="null"):
        pyoidn.Buffer.shared(device, 0, 4)
