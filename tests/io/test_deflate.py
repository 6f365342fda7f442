"""Plain and deflated scan lines, read and written without OpenImageIO, against OpenImageIO."""

import struct
import zlib

import numpy as np
import OpenImageIO
import pytest

from stillray.errors import InputError
from stillray.io.exr.container import read_container
from stillray.io.exr.deflate import is_plain, read_planes, replace_planes
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.write import write_exr

SIZES = [(1, 1), (33, 18), (16, 5), (50, 131)]
NAMES = ("B", "G", "R", "depth.Z", "id.X", "mask.Y")
FORMATS = {"depth.Z": "float", "id.X": "float"}
COMPRESSIONS = ("zip", "zips", "none")


def channels(height, width, kind):
    rng = np.random.default_rng(height * width)
    planes = {}
    for index, name in enumerate(NAMES):
        plane = rng.normal(size=(height, width)).astype(np.float32)
        if kind == "smooth":
            plane = np.add.outer(np.arange(height), np.arange(width)).astype(np.float32) / 8 + index
        if kind == "hard":
            plane.flat[:: index + 2] = [np.nan, np.inf, -np.inf, 0.0, 6e-8][index % 5]
        planes[name] = plane
    return planes


def by_openimageio(path):
    source = OpenImageIO.ImageInput.open(str(path))
    names, spec = source.spec().channelnames, source.spec()
    pixels = np.asarray(source.read_image(0, 0, 0, len(names), OpenImageIO.FLOAT))
    source.close()
    pixels = pixels.reshape(spec.height, spec.width, -1)
    return {name: pixels[..., i] for i, name in enumerate(names)}


def whole(path):
    container = read_container(path)
    return container.parts[0], container.chunks


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("compression", COMPRESSIONS)
@pytest.mark.parametrize("kind", ["noise", "smooth", "hard"])
def test_planes_are_those_that_openimageio_reads(tmp_path, size, compression, kind):
    path = tmp_path / "f.exr"
    write_channels(path, channels(*size, kind), formats=FORMATS, compression=compression)
    part, chunks = whole(path)
    assert is_plain(part, NAMES)
    expected = by_openimageio(path)
    found = read_planes(path, part, chunks, NAMES)
    assert found.keys() == set(NAMES)
    for name, plane in found.items():
        np.testing.assert_array_equal(plane, expected[name], err_msg=name)
    assert read_planes(path, part, chunks, ["id.X"]).keys() == {"id.X"}


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("compression", COMPRESSIONS)
def test_written_file_is_read_by_openimageio_and_keeps_other_channels(tmp_path, size, compression):
    path, out = tmp_path / "f.exr", tmp_path / "o.exr"
    write_channels(path, channels(*size, "hard"), formats=FORMATS, compression=compression)
    image = np.random.default_rng(1).normal(size=(*size, 3)).astype(np.float32)
    image[0, 0] = (1e6, -1e6, 1.0)
    assert write_exr(out, image, like=path) == 2
    before, after = by_openimageio(path), by_openimageio(out)
    limit = np.finfo(np.float16)
    stored = np.clip(image, limit.min, limit.max).astype(np.float16).astype(np.float32)
    for index, name in enumerate("RGB"):
        np.testing.assert_array_equal(after[name], stored[..., index])
    for name in ("depth.Z", "id.X", "mask.Y"):
        np.testing.assert_array_equal(after[name], before[name])
    assert read_container(out).parts[0].compression == compression


def test_float_channel_is_replaced_in_full_precision(tmp_path):
    path = tmp_path / "f.exr"
    write_channels(path, channels(33, 18, "smooth"), formats=FORMATS)
    part, chunks = whole(path)
    plane = np.full((33, 18), 1e30, np.float64) / 3
    written, clamped = replace_planes(path, part, chunks, {"id.X": plane}, tmp_path / "raw")
    assert clamped == 0
    found = read_planes(tmp_path / "raw", part, written, ["id.X", "R"])
    np.testing.assert_array_equal(found["id.X"], plane.astype(np.float32))
    np.testing.assert_array_equal(found["R"], by_openimageio(path)["R"])


def test_bits_of_integers_and_of_nan_beside_color_are_kept(tmp_path):
    path, out = tmp_path / "f.exr", tmp_path / "o.exr"
    planes = channels(33, 18, "noise")
    # a hash as Cryptomatte stores it, one of them a signalling NaN
    planes["id.X"] = np.full((33, 18), 0x7FA00001, np.uint32).view(np.float32)
    write_channels(path, planes, formats=FORMATS, compression="none")
    # what NumPy's assignments might have quieted on the way in
    data = bytearray(path.read_bytes())
    _, chunks = whole(path)
    at = chunks[0].start + 8 + 18 * (2 + 2 + 2 + 4)
    data[at : at + 4] = struct.pack("<I", 0x7FA00001)
    path.write_bytes(data)
    write_exr(out, np.ones((33, 18, 3), np.float32), like=path)
    (_, after), written = whole(out), out.read_bytes()
    start = after[0].start + 8 + 18 * (2 + 2 + 2 + 4)
    assert written[start : start + 4] == struct.pack("<I", 0x7FA00001)


def broken(path, change):
    part, chunks = whole(path)
    data = bytearray(path.read_bytes())
    change(data, chunks[1].start, chunks[1].stop)
    path.write_bytes(data)
    return part, chunks


def garble(data, start, stop):
    data[start + 12 : stop] = bytes(stop - start - 12)


def other_rows(data, start, stop):
    data[start : start + 4] = struct.pack("<i", 3)


def bomb(data, start, stop):
    packed = zlib.compress(bytes(10_000_000), 9)
    packed = packed[: stop - start - 8]
    data[start + 8 : start + 8 + len(packed)] = packed


@pytest.mark.parametrize("change", [garble, other_rows, bomb])
def test_broken_chunk_is_one_line_that_names_the_file(tmp_path, change):
    path = tmp_path / "f.exr"
    write_channels(path, channels(50, 131, "noise"), formats=FORMATS)
    part, chunks = broken(path, change)
    with pytest.raises(InputError, match=r"f\.exr: cannot read the pixels: a chunk is "):
        read_planes(path, part, chunks, NAMES)
    with pytest.raises(InputError, match=r"f\.exr: cannot read the pixels: a chunk is "):
        write_exr(tmp_path / "o.exr", np.ones((50, 131, 3), np.float32), like=path)
    assert [p.name for p in tmp_path.iterdir()] == ["f.exr"]


@pytest.mark.parametrize("compression", ["piz", "rle", "dwaa"])
def test_other_compressions_are_left_to_openimageio(tmp_path, compression):
    path = tmp_path / "f.exr"
    write_channels(path, channels(33, 18, "smooth"), formats=FORMATS, compression=compression)
    assert not is_plain(whole(path)[0], NAMES)
