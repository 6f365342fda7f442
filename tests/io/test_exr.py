"""EXR files: what goes in comes out; bad files and failed writes never pass for good ones."""

import resource
from contextlib import suppress

import numpy as np
import OpenImageIO as oiio  # noqa: N813
import pytest

from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_channels, read_exr, read_metadata
from stillray.io.exr.write import write_color, write_exr

HEIGHT, WIDTH = 33, 18


def planes(*names, seed=0):
    rng = np.random.default_rng(seed)
    # multiples of 1/256 below 1 are exact in half precision: no tolerance needed
    return {n: rng.integers(0, 256, (HEIGHT, WIDTH)).astype(np.float32) / 256 for n in names}


def write_parts(path, parts):
    """A multi-part file from ``(part name, channels)`` pairs."""
    specs = []
    for name, channels in parts:
        height, width = next(iter(channels.values())).shape
        spec = oiio.ImageSpec(width, height, len(channels), "half")
        spec.channelnames = tuple(channels)
        spec.full_width, spec.full_height = WIDTH, HEIGHT
        spec.attribute("name", name)
        specs.append(spec)
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), specs)
    for index, (_, channels) in enumerate(parts):
        assert index == 0 or sink.open(str(path), specs[index], "AppendSubimage")
        assert sink.write_image(np.stack(list(channels.values()), axis=-1))
    assert sink.close()


@pytest.fixture
def source(tmp_path):
    """A file with windows and metadata of its own."""
    spec = oiio.ImageSpec(WIDTH, HEIGHT, 3, "half")
    spec.x, spec.y = 4, 7
    spec.full_x, spec.full_y, spec.full_width, spec.full_height = -2, -3, 64, 48
    spec.attribute("compression", "piz")
    spec.attribute("shotName", "the lighting department")
    spec.attribute("nameOfShot", "tr_0140")
    spec.attribute("PixelAspectRatio", 2.0)
    spec.attribute("worldToCamera", "matrix", tuple(float(i) for i in range(16)))
    path = tmp_path / "source.exr"
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(path), spec)
    assert sink.write_image(np.stack(list(planes(*"RGB").values()), axis=-1))
    assert sink.close()
    return path


def leftovers(folder):
    return [path.name for path in folder.iterdir() if path.name.endswith(".part")]


def test_read_exr_finds_all_buffers_of_our_own_layout(tmp_path):
    names = [*"RGB", "albedo.R", "albedo.G", "albedo.B", "normal.X", "normal.Y", "normal.Z"]
    channels = planes(*names, "depth.Z", "motion.X", "motion.Y")
    channels["depth.Z"] *= 1e5  # beyond half: stays float
    write_channels(tmp_path / "f.exr", channels, formats={"depth.Z": "float"})
    frame = read_exr(tmp_path / "f.exr")
    assert frame.given == {"color", "albedo", "normal", "depth", "motion"}
    np.testing.assert_array_equal(frame.color, np.stack([channels[c] for c in "RGB"], -1))
    np.testing.assert_array_equal(frame.depth, channels["depth.Z"])
    np.testing.assert_array_equal(frame.motion[..., 1], channels["motion.Y"])


def test_read_exr_keeps_nan_and_infinity_for_the_denoiser_to_repair(tmp_path):
    channels = planes(*"RGB")
    channels["R"][2, 3], channels["G"][4, 5] = np.nan, np.inf
    write_channels(tmp_path / "f.exr", channels, formats=dict.fromkeys("RGB", "float"))
    color = read_exr(tmp_path / "f.exr").color
    assert np.isnan(color[2, 3, 0])
    assert np.isposinf(color[4, 5, 1])


def test_read_exr_multi_part_blender_file_flips_motion(tmp_path):
    parts = [
        ("ViewLayer.Combined", planes(*(f"ViewLayer.Combined.{c}" for c in "RGBA"))),
        ("ViewLayer.Vector", planes(*(f"ViewLayer.Vector.{c}" for c in "XYZW"), seed=1)),
        ("ViewLayer.Denoising Albedo", planes(*"RGB", seed=2)),
        ("ViewLayer.Depth", planes("Z", seed=3)),
    ]
    write_parts(tmp_path / "blender.exr", parts)
    frame = read_exr(tmp_path / "blender.exr")
    assert frame.given == {"color", "albedo", "depth", "motion"}
    np.testing.assert_array_equal(frame.albedo[..., 0], parts[2][1]["R"])
    np.testing.assert_array_equal(frame.depth, parts[3][1]["Z"])
    vector = parts[1][1]
    np.testing.assert_array_equal(frame.motion[..., 0], vector["ViewLayer.Vector.X"])
    np.testing.assert_array_equal(frame.motion[..., 1], -vector["ViewLayer.Vector.Y"])


def test_read_exr_first_part_of_a_known_layer_is_not_taken_for_color(tmp_path):
    parts = [
        ("albedo", planes(*"RGB")),
        ("rgba", planes(*"RGBA", seed=1)),
    ]
    write_parts(tmp_path / "f.exr", parts)
    frame = read_exr(tmp_path / "f.exr")
    np.testing.assert_array_equal(frame.albedo[..., 0], parts[0][1]["R"])
    np.testing.assert_array_equal(frame.color[..., 0], parts[1][1]["R"])


def test_read_exr_first_part_of_any_other_name_is_the_beauty(tmp_path):
    parts = [("main pass", planes(*"RGB")), ("albedo", planes(*"RGB", seed=1))]
    write_parts(tmp_path / "f.exr", parts)
    frame = read_exr(tmp_path / "f.exr")
    np.testing.assert_array_equal(frame.color[..., 0], parts[0][1]["R"])
    np.testing.assert_array_equal(frame.albedo[..., 0], parts[1][1]["R"])


def test_read_exr_takes_buffers_from_separate_files_over_those_inside(tmp_path):
    write_channels(tmp_path / "c.exr", planes(*"RGB", "albedo.R", "albedo.G", "albedo.B"))
    for name, channels in (("a", "RGB"), ("n", "XYZ"), ("d", "Y"), ("m", "RG")):
        write_channels(tmp_path / f"{name}.exr", planes(*channels, seed=ord(name)))
    frame = read_exr(
        tmp_path / "c.exr",
        companions={
            "albedo": tmp_path / "a.exr",
            "normal": str(tmp_path / "n.exr"),
            "depth": tmp_path / "d.exr",
            "motion": tmp_path / "m.exr",
        },
    )
    np.testing.assert_array_equal(frame.albedo[..., 2], planes(*"RGB", seed=ord("a"))["B"])
    np.testing.assert_array_equal(frame.normal[..., 2], planes(*"XYZ", seed=ord("n"))["Z"])
    np.testing.assert_array_equal(frame.depth, planes("Y", seed=ord("d"))["Y"])
    np.testing.assert_array_equal(frame.motion[..., 1], planes(*"RG", seed=ord("m"))["G"])
    with pytest.raises(InputError, match=r"companions must be of albedo, .*, got alpha"):
        read_exr(tmp_path / "c.exr", companions={"alpha": tmp_path / "a.exr"})


def test_read_exr_separate_file_of_another_size_is_named(tmp_path):
    write_channels(tmp_path / "c.exr", planes(*"RGB"))
    write_channels(tmp_path / "a.exr", {c: np.zeros((3, 5), np.float32) for c in "RGB"})
    with pytest.raises(InputError, match=r"a\.exr: albedo must have the size \(33, 18\).*\(3, 5\)"):
        read_exr(tmp_path / "c.exr", companions={"albedo": tmp_path / "a.exr"})


def test_read_exr_separate_file_without_its_buffer_is_named(tmp_path):
    write_channels(tmp_path / "c.exr", planes(*"RGB"))
    write_channels(tmp_path / "m.exr", planes("motionvector.X", "motionvector.Y"))
    with pytest.raises(InputError, match=r"m\.exr: must hold motion .* got motionvector\.X"):
        read_exr(tmp_path / "c.exr", companions={"motion": tmp_path / "m.exr"})


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("depth.Z", "albedo.R"), ["holds albedo.R, depth.Z;", "--layer color=NAME"]),
        (("Y", "RY", "BY"), ["luminance and chroma", "must be converted"]),
        (("Y", "A"), ["luminance (Y) alone", "--layer color=Y,Y,Y"]),
        ([f"layer{n:02d}.x" for n in range(50)], ["layer39.x and 10 more"]),
    ],
)
def test_read_exr_without_color_says_what_there_is(tmp_path, names, words):
    write_channels(tmp_path / "f.exr", planes(*names))
    with pytest.raises(InputError, match=r"f\.exr: must hold color channels") as error:
        read_exr(tmp_path / "f.exr")
    assert all(word in str(error.value) for word in words), error.value


def test_a_file_of_luminance_is_read_as_the_message_says(tmp_path):
    made = planes("Y", "A")
    write_channels(tmp_path / "f.exr", made)
    color = read_exr(tmp_path / "f.exr", layers={"color": "Y,Y,Y"}).color
    np.testing.assert_array_equal(color, np.stack([made["Y"]] * 3, -1))


@pytest.mark.parametrize("kind", ["missing", "empty", "text", "png", "folder"])
def test_read_exr_of_what_is_not_exr_raises_one_line(tmp_path, kind):
    path = tmp_path / "f.exr"
    if kind == "empty":
        path.touch()
    elif kind == "text":
        path.write_text("not an image\n" * 100)
    elif kind == "folder":
        path.mkdir()
    elif kind == "png":
        sink = oiio.ImageOutput.create("png")
        assert sink.open(str(tmp_path / "p.png"), oiio.ImageSpec(4, 4, 3, "uint8"))
        assert sink.write_image(np.zeros((4, 4, 3), np.uint8))
        assert sink.close()
        (tmp_path / "p.png").rename(path)
    with pytest.raises(InputError) as error:
        read_exr(path)
    assert str(error.value).startswith(f"{path}: ")
    assert str(error.value).count("f.exr") == 1
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("compression", ["zip", "piz", "none", "dwaa"])
def test_read_exr_truncated_anywhere_is_refused(tmp_path, compression):
    whole, cut = tmp_path / "whole.exr", tmp_path / "cut.exr"
    write_channels(whole, planes(*"RGBA", "depth.Z"), compression=compression)
    data = whole.read_bytes()
    lengths = np.random.default_rng(5).integers(1, len(data), 18).tolist()
    for length in [*lengths, 4, len(data) - 1]:
        cut.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"cut\.exr: "):
            read_exr(cut)


def test_read_exr_truncated_multi_part_is_refused(tmp_path):
    # a lost later part must not pass for a file that never had it
    whole, cut = tmp_path / "whole.exr", tmp_path / "cut.exr"
    write_parts(whole, [("beauty", planes(*"RGB")), ("depth", planes("Z")), ("n", planes(*"XYZ"))])
    data = whole.read_bytes()
    for length in np.linspace(1, len(data) - 1, 20).astype(int):
        cut.write_bytes(data[:length])
        with pytest.raises(InputError, match=r"cut\.exr: "):
            read_exr(cut)


def test_read_exr_hole_of_zeros_is_refused(tmp_path):
    # what a crashed renderer leaves on a file system that allocates ahead
    path = tmp_path / "f.exr"
    write_channels(path, planes(*"RGB"))
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2] + bytes(len(data) - len(data) // 2))
    with pytest.raises(InputError, match=r"f\.exr: "):
        read_exr(path)


def test_read_exr_any_byte_changed_reads_whole_or_is_refused(tmp_path):
    path, rng = tmp_path / "f.exr", np.random.default_rng(1)
    write_channels(path, planes(*"RGB", "depth.Z"))
    data = path.read_bytes()
    for position in rng.integers(0, 400, 150):  # the header and the table of chunks
        broken = bytearray(data)
        broken[position] ^= int(rng.integers(1, 256))
        path.write_bytes(broken)
        with suppress(InputError):  # anything else that is raised fails the test
            assert read_exr(path).color.size > 0


def test_read_channels_parts_of_two_sizes_are_refused(tmp_path):
    small = {c: np.zeros((3, 4), np.float32) for c in "RGB"}
    write_parts(tmp_path / "f.exr", [("a", planes(*"RGB")), ("b", small)])
    with pytest.raises(InputError, match=r"one size, got \[\(3, 4\), \(33, 18\)\]"):
        read_channels(tmp_path / "f.exr")


@pytest.mark.parametrize("dtype", [np.float16, np.float32, np.float64])
def test_write_exr_round_trip_is_exact_in_half(tmp_path, dtype):
    image = np.stack(list(planes(*"RGB").values()), axis=-1).astype(dtype)
    write_exr(tmp_path / "o.exr", image)
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)
    spec = read_metadata(tmp_path / "o.exr")
    assert spec.channelnames == ("R", "G", "B")
    assert str(spec.format) == "half"


def test_write_exr_one_pixel(tmp_path):
    write_exr(tmp_path / "o.exr", np.full((1, 1, 3), 0.5, np.float32))
    assert read_exr(tmp_path / "o.exr").color.tolist() == [[[0.5, 0.5, 0.5]]]


def test_write_exr_keeps_windows_and_metadata_of_the_source(tmp_path, source):
    write_exr(tmp_path / "o.exr", np.zeros((HEIGHT, WIDTH, 3), np.float32), like=source)
    spec = read_metadata(tmp_path / "o.exr")
    assert (spec.x, spec.y) == (4, 7)
    assert (spec.full_x, spec.full_y, spec.full_width, spec.full_height) == (-2, -3, 64, 48)
    assert spec.getattribute("shotName") == "the lighting department"
    assert spec.getattribute("nameOfShot") == "tr_0140"
    assert spec.getattribute("PixelAspectRatio") == 2.0
    assert spec.getattribute("worldToCamera") == tuple(float(i) for i in range(16))
    assert spec.getattribute("compression") == "piz"


def test_write_exr_of_another_size_keeps_metadata_without_windows(tmp_path, source):
    size = (2 * HEIGHT, 2 * WIDTH + 1)  # no whole number of times
    write_exr(tmp_path / "o.exr", np.zeros((*size, 3), np.float32), like=source)
    spec = read_metadata(tmp_path / "o.exr")
    assert (spec.x, spec.y, spec.full_width, spec.full_height) == (0, 0, 2 * WIDTH + 1, 2 * HEIGHT)
    assert spec.getattribute("shotName") == "the lighting department"


def test_write_exr_beyond_half_range_is_clamped_not_infinite(tmp_path):
    image = np.full((3, 5, 3), 1e6, np.float32)
    image[0, 0] = np.inf
    write_exr(tmp_path / "o.exr", image)
    assert np.unique(read_exr(tmp_path / "o.exr").color).tolist() == [65504.0]


@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 4), (0, 5, 3), (1, 4, 5, 3)])
def test_write_exr_wrong_shape_names_it(tmp_path, shape):
    with pytest.raises(InputError, match=r"image must have shape \(height, width, 3\), got \("):
        write_exr(tmp_path / "o.exr", np.zeros(shape, np.float32))
    assert list(tmp_path.iterdir()) == []


def test_write_exr_integers_are_refused(tmp_path):
    with pytest.raises(InputError, match="image must be floating point, got uint8"):
        write_exr(tmp_path / "o.exr", np.zeros((4, 5, 3), np.uint8))


@pytest.mark.parametrize("folder", ["missing", "a_file"])
def test_write_exr_where_no_folder_is_raises(tmp_path, folder):
    (tmp_path / "a_file").touch()
    with pytest.raises(InputError, match=r"o\.exr: the folder must exist and be writable"):
        write_exr(tmp_path / folder / "o.exr", np.zeros((4, 5, 3), np.float32))


def test_write_exr_onto_a_folder_raises_and_leaves_nothing(tmp_path):
    (tmp_path / "o.exr").mkdir()
    with pytest.raises(InputError, match=r"o\.exr: cannot be written"):
        write_exr(tmp_path / "o.exr", np.zeros((4, 5, 3), np.float32))
    assert leftovers(tmp_path) == []


def test_write_exr_when_the_disk_is_full_keeps_the_old_file(tmp_path):
    path = tmp_path / "o.exr"
    write_exr(path, np.full((4, 5, 3), 0.25, np.float32))
    before = path.read_bytes()
    noise = np.random.default_rng(0).random((300, 300, 3), np.float32)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))  # stands for a full disk
    try:
        with pytest.raises(InputError, match=r"o\.exr: cannot be written"):
            write_exr(path, noise)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_bytes() == before
    assert leftovers(tmp_path) == []


def test_write_exr_only_color_of_a_multi_part_source_is_one_whole_part(tmp_path):
    write_parts(tmp_path / "s.exr", [("VL.beauty", planes(*"RGB")), ("VL.depth", planes("Z"))])
    image = np.stack(list(planes(*"RGB", seed=3).values()), axis=-1)
    write_color(tmp_path / "o.exr", image, like=tmp_path / "s.exr")
    assert set(read_channels(tmp_path / "o.exr")) == {"R", "G", "B"}
    assert read_metadata(tmp_path / "o.exr").getattribute("name") is None


@pytest.mark.parametrize(
    ("kinds", "expected"), [("half", "half"), ("float", "float"), ("mixed", "float")]
)
@pytest.mark.parametrize("scale", [1, 2])
def test_a_picture_alone_has_the_type_of_the_color_of_its_source(tmp_path, kinds, expected, scale):
    formats = dict.fromkeys(("key.R", "key.G", "key.B"), kinds)
    if kinds == "mixed":
        formats = {"key.R": "half", "key.G": "half", "key.B": "float"}
    # the layer of the other type is not the one that was chosen
    other = "half" if expected == "float" else "float"
    formats |= dict.fromkeys("RGB", other)
    write_channels(tmp_path / "s.exr", planes(*formats), formats=formats)
    image = np.full((scale * HEIGHT, scale * WIDTH, 3), 1e5, np.float32)
    clamped = write_color(
        tmp_path / "o.exr", image, like=tmp_path / "s.exr", layers={"color": "key"}
    )
    assert str(read_metadata(tmp_path / "o.exr").format) == expected
    assert clamped == (image.size if expected == "half" else 0)
    assert read_exr(tmp_path / "o.exr").color.max() == (65504 if expected == "half" else 1e5)


def test_a_picture_alone_has_the_type_that_is_asked_for(tmp_path):
    image = np.full((HEIGHT, WIDTH, 3), 1e5, np.float32)
    write_channels(tmp_path / "s.exr", planes(*"RGB"))
    write_color(tmp_path / "o.exr", image, like=tmp_path / "s.exr", kind="float")
    np.testing.assert_array_equal(read_exr(tmp_path / "o.exr").color, image)


def test_read_exr_brings_a_cropped_part_to_the_window_of_the_color(tmp_path):
    # Redshift crops each part to what is not black
    rng = np.random.default_rng(3)
    specs, images = [], []
    for name, channels, x, y, width, height in [
        ("beauty", "RGB", -3, 2, 12, 9), ("depth", "Z", 1, 4, 30, 3), ("far", "Q", 90, 90, 4, 4),
    ]:  # fmt: skip
        spec = oiio.ImageSpec(width, height, len(channels), "half")
        spec.channelnames = tuple(channels)
        spec.x, spec.y, spec.full_width, spec.full_height = x, y, 100, 100
        spec.attribute("name", name)
        specs.append(spec)
        images.append(rng.integers(1, 99, (height, width, len(channels))).astype(np.float32))
    sink = oiio.ImageOutput.create("exr")
    assert sink.open(str(tmp_path / "f.exr"), specs)
    for index, image in enumerate(images):
        assert index == 0 or sink.open(str(tmp_path / "f.exr"), specs[index], "AppendSubimage")
        assert sink.write_image(image)
    assert sink.close()
    frame = read_exr(tmp_path / "f.exr")
    expected = np.zeros((9, 12))
    for row in range(9):
        for column in range(12):
            y, x = row + 2 - 4, column - 3 - 1  # from the color's window to the depth's
            if 0 <= y < 3 and 0 <= x < 30:
                expected[row, column] = images[1][y, x, 0]
    np.testing.assert_array_equal(frame.depth, expected)
    np.testing.assert_array_equal(frame.color, images[0])


def test_a_picture_of_twice_the_size_has_windows_of_twice_the_size(tmp_path):
    source, enlarged = tmp_path / "a.exr", tmp_path / "b.exr"
    spec = oiio.ImageSpec(4, 3, 3, "half")
    spec.x, spec.y, spec.full_x, spec.full_y, spec.full_width, spec.full_height = 2, -1, 1, 0, 9, 7
    sink = oiio.ImageOutput.create(str(source))
    assert sink.open(str(source), spec)
    sink.write_image(np.ones((3, 4, 3), np.float32))
    sink.close()
    write_exr(enlarged, np.ones((6, 8, 3), np.float32), like=source)
    found = read_metadata(enlarged)
    assert (found.x, found.y, found.width, found.height) == (4, -2, 8, 6)
    assert (found.full_x, found.full_y, found.full_width, found.full_height) == (2, 0, 18, 14)
    assert read_exr(enlarged).shape == (6, 8)
