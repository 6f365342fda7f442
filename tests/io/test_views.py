"""Stereo files: an eye is denoised because it was asked for, and the other stays as it is."""

import struct

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from stillray.cli import main
from stillray.errors import InputError
from stillray.io.channels.roles import find_layers
from stillray.io.exr.file import ExrFile
from stillray.io.exr.read import read_exr, read_picture
from stillray.io.exr.write import write_exr
from tests.io.odd_exr import OddPart, exr

SHAPE = (20, 24)


def write_parts(path, parts):
    """Parts from ``(name, view, channels)``, where each channel holds one value of its own."""
    specs, value = [], 0
    for name, view, channels in parts:
        spec = oiio.ImageSpec(SHAPE[1], SHAPE[0], len(channels), "half")
        spec.channelnames = channels
        spec.attribute("name", name)
        if view:
            spec.attribute("view", view)
        specs.append(spec)
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), specs)
    for number, spec in enumerate(specs):
        if number:
            assert sink.open(str(path), spec, "AppendSubimage")
        values = np.arange(value, value + spec.nchannels, dtype=np.float32) / 64
        value += spec.nchannels
        assert sink.write_image(np.broadcast_to(values, (*SHAPE, spec.nchannels)).copy())
    assert sink.close()


#: As the OpenEXR project's own stereo images of many parts are laid out.
PARTS = [
    ("rgba_right", "right", ("R", "G", "B", "A")),
    ("depth_left", "left", ("Z",)),
    ("rgba_left", "left", ("R", "G", "B", "A")),
    ("depth_right", "right", ("Z",)),
]


def test_subsampled_channels_are_named(tmp_path):
    half, path = ("half", 1), tmp_path / "f.exr"
    names = {"Y": half, "RY": ("half", 2), "BY": ("half", 2)}
    path.write_bytes(exr([OddPart(channels=names, data=(0, 0, 24, 20))], np.random.default_rng(0)))
    with pytest.raises(InputError, match=r"luminance and chroma \(Y, RY, BY\), which must be conv"):
        read_exr(path)
    with pytest.raises(InputError, match=r"part 0 has subsampled ones, .*: BY, RY"):
        read_exr(path, layers={"color": "Y,Y,Y"})


def test_a_color_whose_channels_lie_in_parts_of_other_sizes_is_refused(tmp_path):
    # drawn by the generator of odd files: no library writes parts of one name
    half, path = ("half", 1), tmp_path / "f.exr"
    parts = [
        OddPart(channels={"R": half}, data=(0, 0, 24, 20), name="rgba"),
        OddPart(channels={"G": half, "B": half}, data=(0, 0, 22, 10), name="rgba"),
    ]
    path.write_bytes(exr(parts, np.random.default_rng(0)))
    image = read_exr(path, layers={"color": "R,rgba.G,rgba.B"}).color
    with pytest.raises(InputError, match="color must have one data window"):
        write_exr(
            tmp_path / "o.exr", image, like=path, layers={"color": "R,rgba.G,rgba.B"}
        )  # fmt: skip


def write_channels_of_views(path):
    """One part: right, the default, and left, whose channels carry its name."""
    names = ("R", "G", "B", "Z", "left.R", "left.G", "left.B", "left.Z", "forward.left.u", "id.x")
    spec = oiio.ImageSpec(SHAPE[1], SHAPE[0], len(names), "half")
    spec.channelnames = names
    spec.attribute("multiView", "HERE")
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), spec)
    values = np.arange(len(names), dtype=np.float32) / 64
    assert sink.write_image(np.broadcast_to(values, (*SHAPE, len(names))).copy())
    assert sink.close()
    # OpenImageIO writes no lists of texts: the attribute is put in by hand
    value = b"".join(struct.pack("<i", len(v)) + v for v in (b"right", b"left"))
    data = path.read_bytes()
    old = b"multiView\0string\0" + struct.pack("<i", 4) + b"HERE"
    new = b"multiView\0stringvector\0" + struct.pack("<i", len(value)) + value
    assert old in data
    head, rest = data.split(old)
    grown = len(new) - len(old)
    whole = bytearray(head + new + rest)
    # the table of chunks follows the header: its offsets move with it
    container_end = _end_of_header(bytes(whole))
    count = -(-SHAPE[0] // 16)
    table = np.frombuffer(bytes(whole[container_end : container_end + 8 * count]), "<u8")
    whole[container_end : container_end + 8 * count] = (table + np.uint64(grown)).tobytes()
    path.write_bytes(bytes(whole))


def _end_of_header(data):
    at = 8
    while data[at]:
        at = data.index(b"\0", at) + 1
        at = data.index(b"\0", at) + 1
        at += 4 + struct.unpack("<i", data[at : at + 4])[0]
    return at + 1


@pytest.fixture(params=["parts", "parts without the attribute", "channels"])
def stereo(request, tmp_path):
    path = tmp_path / "stereo.exr"
    if request.param == "channels":
        write_channels_of_views(path)
    else:
        named = request.param == "parts"
        write_parts(path, [(name, view if named else "", c) for name, view, c in PARTS])
    return path


def values(frame):
    return [round(64 * float(v)) for v in frame.color[0, 0]], round(64 * float(frame.depth[0, 0]))


def test_each_view_has_its_own_color_and_depth(stereo):
    file = ExrFile.open(stereo)
    assert file.views == ("right", "left")
    parts = len(file.container.parts) > 1
    right = values(read_exr(stereo, layers={"view": "right"}))
    left = values(read_exr(stereo, layers={"view": "left"}))
    assert right == (([0, 1, 2], 9) if parts else ([0, 1, 2], 3))
    assert left == (([5, 6, 7], 4) if parts else ([4, 5, 6], 7))


def test_a_reader_of_one_picture_takes_no_eye_in_silence(stereo):
    with pytest.raises(InputError, match=r"holds the views right, left, of which one must be"):
        read_exr(stereo)
    with pytest.raises(InputError, match=r"must have the view middle, but it has right, left"):
        read_exr(stereo, layers={"view": "middle"})


def test_info_shows_one_eye_and_says_so(stereo, capsys):
    assert main(["info", str(stereo), "-m", "fast"]) == 0
    assert "views: right, left; this is right; all are denoised" in capsys.readouterr().out
    assert main(["info", str(stereo), "-m", "fast", "--view", "left"]) == 0
    assert "this is left" in capsys.readouterr().out


def test_both_eyes_are_denoised_one_after_the_other(stereo):
    half, whole = stereo.with_name("half.exr"), stereo.with_name("whole.exr")
    image = np.full((*SHAPE, 3), 0.5, np.float32)
    before = {view: read_picture(stereo, layers={"view": view}) for view in ("left", "right")}
    write_exr(half, image, like=stereo, layers={"view": "left"})
    np.testing.assert_array_equal(read_picture(half, layers={"view": "left"}), image)
    np.testing.assert_array_equal(read_picture(half, layers={"view": "right"}), before["right"])
    write_exr(whole, image / 2, like=half, layers={"view": "right"})
    np.testing.assert_array_equal(read_picture(whole, layers={"view": "left"}), image)
    np.testing.assert_array_equal(read_picture(whole, layers={"view": "right"}), image / 2)
    assert ExrFile.open(whole).views == ("right", "left")
    assert list(ExrFile.open(whole).channels) == list(ExrFile.open(stereo).channels)


def test_the_command_denoises_the_view_that_is_named(stereo):
    output = stereo.with_name("o.exr")
    before = read_picture(stereo, layers={"view": "right"})
    arguments = ["denoise", str(stereo), "-m", "wskp-3s", "-o", str(output), "--view"]
    assert main([*arguments, "left"]) == 0
    np.testing.assert_array_equal(read_picture(output, layers={"view": "right"}), before)
    kept = output.stat().st_mtime_ns
    assert main([*arguments, "left", "--resume"]) == 0
    assert output.stat().st_mtime_ns == kept
    assert main([*arguments, "right", "--resume"]) == 0  # another picture: not kept
    assert output.stat().st_mtime_ns != kept


def test_layers_of_no_view_go_with_every_view(tmp_path):
    write_channels_of_views(tmp_path / "s.exr")
    names = set(ExrFile.open(tmp_path / "s.exr", view="left").channels)
    assert names == {"R", "G", "B", "Z", "forward.u", "id.x"}
    names = set(ExrFile.open(tmp_path / "s.exr", view="right").channels)
    assert names == {"R", "G", "B", "Z", "id.x"}


def test_one_eye_alone_is_an_ordinary_file(tmp_path):
    write_parts(tmp_path / "s.exr", PARTS[1:3])
    file = ExrFile.open(tmp_path / "s.exr")
    assert {match.role for match in find_layers(file.channels)} == {"color", "depth"}
    assert values(read_exr(tmp_path / "s.exr")) == ([1, 2, 3], 0)


def test_lights_named_left_and_right_make_no_views(tmp_path):
    parts = [(name, "", ("R", "G", "B")) for name in ("beauty", "key_left", "key_right")]
    write_parts(tmp_path / "s.exr", parts)
    assert ExrFile.open(tmp_path / "s.exr").views == ()
    assert read_exr(tmp_path / "s.exr").color[0, 0, 1] == 1 / 64
