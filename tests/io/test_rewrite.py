"""A denoised file is its source but for the picture: compared part by part with OpenImageIO."""

import struct
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

import stillray
from stillray.errors import InputError
from stillray.io.exr.container import read_container
from stillray.io.exr.read import read_exr, read_metadata, read_picture
from stillray.io.exr.write import expected_changes, write_exr

BLENDER = Path(__file__).parents[1] / "data/blender/frame_0002.exr"
HEIGHT, WIDTH = 67, 45
LOSSLESS = ["none", "rle", "zips", "zip", "piz"]
BITS = {"half": np.uint16, "float": np.uint32, "uint": np.uint32}
# what OpenImageIO derives from the pixels' storage and not from an attribute
DERIVED = {"oiio:subimages"}


def native(path):
    """Of each part: its spec, and each channel's own bits."""
    source = oiio.ImageInput.open(str(path))
    parts = []
    while source.seek_subimage(len(parts), 0):
        spec = source.spec()
        kinds = [str(k) for k in spec.channelformats] or [str(spec.format)] * spec.nchannels
        planes = {}
        for index, (name, kind) in enumerate(zip(spec.channelnames, kinds, strict=True)):
            plane = source.read_image(len(parts), 0, index, index + 1, oiio.TypeDesc(kind))
            assert plane is not None, source.geterror()
            plane = np.ascontiguousarray(plane).reshape(spec.height, spec.width)
            planes[name] = (kind, plane.view(BITS[kind]))
        parts.append((spec, planes))
    source.close()
    return parts


def attributes(spec):
    return {
        a.name: (str(a.type), a.value)
        for a in spec.extra_attribs
        if a.name not in DERIVED and not a.name.startswith("stillray:")
    }


def assert_same_but(before, after, replaced):
    """Same parts, windows, tiles, attributes, channels, types and bits, but for some channels."""
    assert len(before) == len(after)
    for (old, old_planes), (new, new_planes) in zip(before, after, strict=True):
        for name in ("x", "y", "width", "height", "tile_width", "tile_height"):
            assert getattr(old, name) == getattr(new, name), name
        for name in ("full_x", "full_y", "full_width", "full_height", "channelnames"):
            assert getattr(old, name) == getattr(new, name), name
        assert attributes(old) == attributes(new)
        for name, (kind, bits) in old_planes.items():
            assert new_planes[name][0] == kind, name
            if name not in replaced:
                np.testing.assert_array_equal(new_planes[name][1], bits, name)


def any_bits(rng, kind, shape):
    """Every pattern of bits, as ids and hashes have them; NaN with a message in it too."""
    if kind == "half":
        return rng.integers(0, 2**16, shape, dtype=np.uint16).view(np.float16)
    bits = rng.integers(0, 2**32, shape, dtype=np.uint32)
    return bits.view(np.float32) if kind == "float" else bits


def write_mixed(
    path, kinds, *, compression="zip", tile=0, window=(-3, 5), line_order="increasingY"
):
    """A part of several types; without integers OpenImageIO keeps all bits of what it is given."""
    rng = np.random.default_rng(11)
    spec = oiio.ImageSpec(WIDTH, HEIGHT, len(kinds), "float")
    spec.channelnames = tuple(kinds)
    spec.channelformats = tuple(oiio.TypeDesc(kind) for kind in kinds.values())
    spec.x, spec.y = window
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = -3, 5, 40, 80
    spec.tile_width = spec.tile_height = tile
    spec.attribute("compression", compression)
    spec.attribute("openexr:lineOrder", line_order)
    spec.attribute("smpte:TimeCode", oiio.TypeDesc("timecode"), (0x01020304, 7))
    spec.attribute("chromaticities", "float[8]", (0.7, 0.3, 0.1, 0.8, 0.1, 0.05, 0.32, 0.33))
    spec.attribute("arnold/version", "7.2")
    planes = {n: any_bits(rng, kind, (HEIGHT, WIDTH)) for n, kind in kinds.items()}
    between_0_and_1 = [n for n, kind in kinds.items() if n in "RGB" or kind == "uint"]
    planes |= {n: rng.random((HEIGHT, WIDTH), np.float32) for n in between_0_and_1}
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), spec), sink.geterror()
    pixels = np.stack([plane.astype(np.float32) for plane in planes.values()], -1)
    assert sink.write_image(pixels), sink.geterror()
    assert sink.close()


def picture(shape=(HEIGHT, WIDTH), seed=0):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 256, (*shape, 3)).astype(np.float32) / 256  # exact in half


@pytest.mark.parametrize("shape", [(67, 45), (16, 64), (1, 9)])
@pytest.mark.parametrize("chunk_count", [True, False], ids=["counted", "uncounted"])
def test_a_mip_mapped_file_is_read_and_written_at_full_resolution(tmp_path, shape, chunk_count):
    image = picture(shape)
    path = tmp_path / "s.exr"
    spec = oiio.ImageSpec(shape[1], shape[0], 4, "float")
    buffer = oiio.ImageBuf(spec)
    assert buffer.set_pixels(oiio.ROI(), np.concatenate([image, image[..., :1]], -1))
    config = oiio.ImageSpec(1, 1, 1, "half")
    config.tile_width = config.tile_height = 16
    assert oiio.ImageBufAlgo.make_texture(oiio.MakeTxTexture, buffer, str(path), config)
    assert read_container(path).parts[0].levels
    if not chunk_count:  # which files of one part need not have
        data = path.read_bytes()
        path.write_bytes(data.replace(b"chunkCount\0int\0", b"chunkCoumt\0int\0"))
    np.testing.assert_array_equal(read_exr(path).color, image)
    assert expected_changes(path) == ["mip-mapped color is written at its full resolution alone"]
    write_exr(tmp_path / "o.exr", image / 2, like=path)
    ((spec, planes),) = native(tmp_path / "o.exr")
    assert (spec.height, spec.width, spec.tile_width) == (*shape, 16)
    np.testing.assert_array_equal(planes["A"][1], native(path)[0][1]["A"][1])
    np.testing.assert_array_equal(read_picture(tmp_path / "o.exr"), image / 2)
    assert not read_container(tmp_path / "o.exr").parts[0].levels


MIXED = {"R": "half", "G": "half", "B": "half", "A": "half", "Z": "float", "crypto00.r": "float"}


@pytest.mark.parametrize("compression", LOSSLESS)
@pytest.mark.parametrize("tile", [0, 16])
def test_rewrite_keeps_every_bit_of_what_is_not_color(tmp_path, compression, tile):
    write_mixed(tmp_path / "s.exr", MIXED, compression=compression, tile=tile)
    image = picture()
    assert write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr") == 0
    assert_same_but(native(tmp_path / "s.exr"), native(tmp_path / "o.exr"), {"R", "G", "B"})
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)


@pytest.mark.parametrize("compression", ["pxr24", "b44", "b44a", "dwaa:30", "dwab"])
def test_rewrite_with_a_lossy_codec_keeps_it_and_the_float_ids(tmp_path, compression):
    kinds = {"R": "half", "G": "half", "B": "half", "A": "half", "id": "float"}
    if compression == "pxr24":
        del kinds["id"]  # it rounds floats to 24 bits
    write_mixed(tmp_path / "s.exr", kinds, compression=compression)
    image = np.full((HEIGHT, WIDTH, 3), 0.5, np.float32)  # no codec loses anything of a constant
    write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr")
    lossy = {"R", "G", "B"} | ({"A"} if compression.startswith("b44") else set())
    assert_same_but(native(tmp_path / "s.exr"), native(tmp_path / "o.exr"), lossy)
    np.testing.assert_allclose(read_exr(tmp_path / "o.exr").color, image, rtol=1e-3)


def test_rewrite_of_blender_5_changes_one_part_and_no_byte_of_the_others(tmp_path):
    shape = read_exr(BLENDER).shape
    image = picture(shape)
    write_exr(tmp_path / "o.exr", image, like=BLENDER)
    replaced = {f"ViewLayer.Combined.{c}" for c in "RGB"}
    assert_same_but(native(BLENDER), native(tmp_path / "o.exr"), replaced)
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)
    before, after = chunk_bytes(BLENDER), chunk_bytes(tmp_path / "o.exr")
    changed = {part for part, index in before if before[part, index] != after[part, index]}
    assert changed == {0}


def chunk_bytes(path):
    with open(path, "rb") as file:
        data = file.read()
    return {(c.part, c.index): data[c.start : c.stop] for c in read_container(path).chunks}


def test_rewrite_keeps_attributes_of_types_that_no_library_knows(tmp_path):
    write_mixed(tmp_path / "plain.exr", MIXED)
    data = (tmp_path / "plain.exr").read_bytes()
    value = b"shotgun\0tag"
    added = b"zzCustom\0myOwnType\0" + struct.pack("<i", len(value)) + value
    container = read_container(tmp_path / "plain.exr")
    end = min(c.start for c in container.chunks) - 8 * len(container.chunks) - 1
    offsets = np.frombuffer(data, "<u8", len(container.chunks), end + 1) + np.uint64(len(added))
    rest = data[end + 1 + 8 * len(container.chunks) :]
    custom = tmp_path / "s.exr"
    custom.write_bytes(data[:end] + added + b"\0" + offsets.tobytes() + rest)
    write_exr(tmp_path / "o.exr", picture(), like=custom)
    kept = {a.name: a for a in read_container(tmp_path / "o.exr").parts[0].attributes}
    assert kept["zzCustom"].kind == "myOwnType"
    assert kept["zzCustom"].value == value
    assert read_exr(tmp_path / "o.exr").shape == (HEIGHT, WIDTH)


def test_rewrite_keeps_integers_that_floats_cannot_hold(tmp_path):
    kinds = {"R": "half", "G": "half", "B": "half", "objectId": "uint"}
    write_mixed(tmp_path / "s.exr", kinds, compression="zip")
    before = native(tmp_path / "s.exr")
    assert len(np.unique(before[0][1]["objectId"][1])) > 1000
    write_exr(tmp_path / "o.exr", picture(), like=tmp_path / "s.exr")
    assert_same_but(before, native(tmp_path / "o.exr"), {"R", "G", "B"})


def test_rewrite_of_integers_under_a_rounding_codec_takes_zip_for_that_part(tmp_path):
    kinds = {"R": "half", "G": "half", "B": "half", "objectId": "uint"}
    write_mixed(tmp_path / "s.exr", kinds, compression="pxr24")
    write_exr(tmp_path / "o.exr", picture(), like=tmp_path / "s.exr")
    before, after = native(tmp_path / "s.exr"), native(tmp_path / "o.exr")
    np.testing.assert_array_equal(after[0][1]["objectId"][1], before[0][1]["objectId"][1])
    assert after[0][0].getattribute("compression") == "zip"


def test_rewrite_of_decreasing_lines(tmp_path):
    write_mixed(tmp_path / "s.exr", MIXED, line_order="decreasingY")
    image = picture()
    write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr")
    assert_same_but(native(tmp_path / "s.exr"), native(tmp_path / "o.exr"), {"R", "G", "B"})
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)
    assert read_metadata(tmp_path / "o.exr").getattribute("openexr:lineOrder") == "decreasingY"


def test_rewrite_in_many_bands_is_the_same_file(tmp_path, monkeypatch):
    write_mixed(tmp_path / "s.exr", MIXED)
    write_mixed(tmp_path / "t.exr", MIXED, tile=16)
    for name in ("s", "t"):
        write_exr(tmp_path / f"{name}1.exr", picture(), like=tmp_path / f"{name}.exr")
        monkeypatch.setattr("stillray.io.exr.rewrite._BAND_BYTES", 1)
        write_exr(tmp_path / f"{name}2.exr", picture(), like=tmp_path / f"{name}.exr")
        monkeypatch.undo()
        whole, bands = (tmp_path / f"{name}{i}.exr" for i in (1, 2))
        assert whole.read_bytes() == bands.read_bytes()


def test_rewrite_blender_with_noisy_image_replaces_the_combined(tmp_path):
    names = [f"VL.{layer}.{c}" for layer in ("Combined", "Noisy Image") for c in "RGB"]
    write_mixed(tmp_path / "s.exr", dict.fromkeys(names, "half"))
    write_exr(tmp_path / "o.exr", picture(), like=tmp_path / "s.exr")
    replaced = set(names[:3])
    assert_same_but(native(tmp_path / "s.exr"), native(tmp_path / "o.exr"), replaced)
    np.testing.assert_array_equal(read_picture(tmp_path / "o.exr"), picture())
    assert not np.array_equal(read_exr(tmp_path / "o.exr").color, picture())  # still the noisy one


def test_rewrite_clamps_and_counts_only_what_half_cannot_hold(tmp_path):
    write_mixed(tmp_path / "s.exr", {"R": "half", "G": "half", "B": "float"})
    image = picture()
    image[1, 2], image[3, 4, 0] = 1e6, np.inf
    assert write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr") == 3
    color = read_exr(tmp_path / "o.exr").color
    assert color[1, 2].tolist() == [65504.0, 65504.0, 1e6]
    assert color[3, 4, 0] == 65504.0
    assert write_exr(tmp_path / "p.exr", image) == 4


def test_rewrite_does_not_touch_premultiplied_alpha_nor_divide_by_it(tmp_path):
    write_mixed(tmp_path / "s.exr", MIXED)
    alpha = native(tmp_path / "s.exr")[0][1]["A"][1]
    image = picture()
    write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr")
    np.testing.assert_array_equal(native(tmp_path / "o.exr")[0][1]["A"][1], alpha)
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)


def test_rewrite_says_where_the_picture_comes_from_once(tmp_path):
    tags = {"stillray:model": "kpyr-5", "stillray:options": "temporal"}
    write_exr(tmp_path / "a.exr", picture((35, 49)), like=BLENDER, attributes=tags)
    write_exr(tmp_path / "b.exr", picture((35, 49)), like=tmp_path / "a.exr", attributes=tags)
    spec = read_metadata(tmp_path / "b.exr")
    assert spec.getattribute("stillray:version") == stillray.__version__
    assert spec.getattribute("stillray:model") == "kpyr-5"
    names = [a.name for a in read_container(tmp_path / "b.exr").parts[0].attributes]
    assert len(names) == len(set(names))
    write_exr(tmp_path / "c.exr", picture(), attributes=tags)
    assert read_metadata(tmp_path / "c.exr").getattribute("stillray:options") == "temporal"


def test_rewrite_takes_the_color_that_was_chosen(tmp_path):
    kinds = {n: "half" for n in ("R", "G", "B", "key.R", "key.G", "key.B")}
    write_mixed(tmp_path / "s.exr", kinds)
    chosen = {"color": "key"}
    image = picture()
    write_exr(tmp_path / "o.exr", image, like=tmp_path / "s.exr", layers=chosen)
    replaced = {"key.R", "key.G", "key.B"}
    assert_same_but(native(tmp_path / "s.exr"), native(tmp_path / "o.exr"), replaced)
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr", layers=chosen).color, image)


def test_rewrite_failing_leaves_nothing_behind(tmp_path):
    write_exr(tmp_path / "s.exr", np.full((HEIGHT, WIDTH, 3), 0.5, np.float32))
    data = bytearray((tmp_path / "s.exr").read_bytes())
    last = read_container(tmp_path / "s.exr").chunks[-1]
    data[last.start + 8 : last.stop] = bytes(last.stop - last.start - 8)  # undecodable pixels
    (tmp_path / "s.exr").write_bytes(data)
    with pytest.raises(InputError, match=r"s\.exr: "):
        write_exr(tmp_path / "o.exr", picture(), like=tmp_path / "s.exr")
    assert [path.name for path in tmp_path.iterdir()] == ["s.exr"]
