"""The comparison page's data: what is paired, measured, and embedded; no browser needed."""

import base64
import json
import re
import subprocess
import sys
import zlib

import numpy as np
import pytest

from stillray.cli import main
from stillray.compare import metrics, scores
from stillray.compare.metrics import Metric
from stillray.compare.pixels import box_average, pack_radiance
from stillray.compare.sources import pair
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr
from stillray.io.exr.write import write_exr
from stillray.io.pfm import write_pfm
from tests.io.odd_exr import OddPart, exr

HEIGHT, WIDTH = 33, 18


def write(path, image, kind="float"):
    planes = {name: image[..., index] for index, name in enumerate("RGB")}
    write_channels(path, planes, formats=dict.fromkeys("RGB", kind))
    return image


def render(seed, shape=(HEIGHT, WIDTH, 3)):
    """Positive radiance over many magnitudes."""
    return np.exp(np.random.default_rng(seed).normal(-1, 2, shape)).astype(np.float32)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def data_of(page):
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'id="data">(.*?)</script>', text, re.DOTALL)[1])


def bytes_of(page, name):
    found = re.search(rf'id="{name}">(.*?)</script>', page.read_text(encoding="utf-8"))
    return zlib.decompress(base64.b64decode(found[1]))


def decode(data, height, width):
    """What the page makes of embedded radiance, in slow loops."""
    count = 3 * height * width
    codes = np.zeros((3, height, width), np.int64)
    for channel in range(3):
        for row in range(height):
            left = 0
            for column in range(width):
                place = (channel * height + row) * width + column
                folded = data[place] * 256 + data[count + place]
                step = folded // 2 if folded % 2 == 0 else -(folded + 1) // 2
                left = (left + step) % 65536
                codes[channel, row, column] = left
    codes[0] = (codes[0] + codes[1]) % 65536
    codes[2] = (codes[2] + codes[1]) % 65536
    return codes.astype(np.uint16).view(np.float16).transpose(1, 2, 0)


def decode_map(data, height, width):
    steps = np.frombuffer(data, np.uint8).reshape(height, width).astype(np.int64)
    return np.cumsum(steps, axis=1) % 256 / 255


def test_packed_radiance_comes_back_as_its_half_floats():
    image = render(0, (7, 5, 3))
    image[0, 0] = -2.5, 0.0, 1e-7
    image[3, 4] = np.nan, np.inf, -np.inf
    image[1, 1] = 7e4, -1e30, 65504
    back = decode(zlib.decompress(pack_radiance(image)), 7, 5)
    limited = np.where(np.isinf(image), image, np.clip(image, -65504, 65504))
    np.testing.assert_array_equal(back, limited.astype(np.float16))


def test_packed_radiance_is_smaller_than_its_half_floats():
    row, column = np.mgrid[0:64, 0:64] / 64
    smooth = np.stack([row, row * column, column], axis=-1).astype(np.float32)
    assert len(pack_radiance(smooth)) < 64 * 64 * 3


@pytest.mark.parametrize("channels", [(), (3,)])
def test_box_average_is_the_mean_of_each_cell_at_the_border_too(rng, channels):
    image = rng.random((7, 5, *channels)).astype(np.float32)
    small = box_average(image, 3)
    assert small.shape == (3, 2, *channels)
    for row in range(3):
        for column in range(2):
            cell = image[3 * row : 3 * row + 3, 3 * column : 3 * column + 3]
            np.testing.assert_allclose(small[row, column], cell.mean((0, 1)), rtol=1e-6)


def test_page_carries_pixels_metrics_and_flip_of_its_files(folder):
    pytest.importorskip("flip_evaluator")
    pytest.importorskip("skimage")
    images = [write(folder / f"{name}.exr", render(i)) for i, name in enumerate("ab")]
    truth = write(folder / "r.exr", render(0) * 0.9 + 0.1)
    assert main(["compare", "a.exr", "b.exr", "--reference", "r.exr", "-o", "page.html"]) == 0
    page = folder / "page.html"
    data = data_of(page)
    assert data["labels"] == ["a", "b", "reference"]
    assert (data["width"], data["height"]) == (WIDTH, HEIGHT)
    for place, image in enumerate([*images, truth]):
        back = decode(bytes_of(page, f"radiance-0-{place}"), HEIGHT, WIDTH)
        np.testing.assert_array_equal(back, image.astype(np.float16))
    names = [metric["name"] for metric in data["metrics"]]
    assert names == ["psnr", "ssim", "smape", "relmse", "flip"]
    expected = [metrics.evaluate([image], [truth], names=names) for image in images]
    formats = {metric.name: metric.format for metric in metrics.METRICS}
    for row, values in zip(data["frames"][0]["rows"], expected, strict=True):
        assert [cell["text"] for cell in row] == [format(values[n], formats[n]) for n in names]
    for column, name in enumerate(names):
        best = max if name in ("psnr", "ssim") else min
        winner = best((0, 1), key=lambda image: expected[image][name])
        marks = [row[column]["best"] for row in data["frames"][0]["rows"]]
        assert marks == [winner == 0, winner == 1]
    shown = decode_map(bytes_of(page, "flip-0-1"), HEIGHT, WIDTH)
    errors, mean = metrics.flip(images[1], truth)
    np.testing.assert_allclose(shown, errors, atol=0.5 / 255 + 1e-6)
    assert mean == pytest.approx(expected[1]["flip"])


def test_page_carries_alpha_and_the_layers_that_are_named(folder):
    image = render(0)
    planes = {name: image[..., i] for i, name in enumerate("RGB")}
    planes |= {f"key.{c}": image[..., i] / 2 for i, c in enumerate("RGB")}
    planes |= {"A": np.full((HEIGHT, WIDTH), 0.2), "depth.Z": np.full((HEIGHT, WIDTH), 7.0)}
    write_channels("a.exr", planes)
    write("b.exr", image)
    command = ["compare", "a.exr", "b.exr", "-o", "page.html", "--layer", "key"]
    assert main([*command, "--layer", "depth"]) == 0
    page = folder / "page.html"
    (frame,) = data_of(page)["frames"]
    assert data_of(page)["layers"] == ["color", "key", "depth"]
    assert (frame["layers"], frame["has_alpha"]) == ([[True, True], [False, False]], [True, False])
    key = decode(bytes_of(page, "radiance-0-0-1"), HEIGHT, WIDTH)
    np.testing.assert_array_equal(key, (image / 2).astype(np.float16))
    assert (decode(bytes_of(page, "radiance-0-0-2"), HEIGHT, WIDTH) == 7).all()
    assert (decode_map(bytes_of(page, "alpha-0-0"), HEIGHT, WIDTH) == 51 / 255).all()


def test_a_layer_that_no_image_has_is_one_line(folder, capsys):
    write("a.exr", render(0))
    write("b.exr", render(1))
    assert main(["compare", "a.exr", "b.exr", "-o", "page.html", "--layer", "key"]) == 2
    assert "layer must be in one of the images, got key" in capsys.readouterr().err


def test_an_eye_is_compared_with_what_it_should_be(folder, capsys):
    half = ("half", 1)
    parts = [
        OddPart(channels=dict.fromkeys("RGB", half), data=(0, 0, 24, 20), name=f"rgba_{eye}")
        for eye in ("left", "right")
    ]
    (folder / "stereo.exr").write_bytes(exr(parts, np.random.default_rng(0)))
    eyes = {v: read_exr("stereo.exr", layers={"view": v}).color for v in ("left", "right")}
    write_pfm("mono.pfm", eyes["right"])
    assert main(["compare", "stereo.exr", "mono.pfm", "-o", "page.html"]) == 2
    assert "holds the views left, right" in capsys.readouterr().err
    for eye, image in eyes.items():
        command = ["compare", "stereo.exr", "mono.pfm", "-o", f"{eye}.html", "--view", eye]
        assert main(command) == 0
        shown = decode(bytes_of(folder / f"{eye}.html", "radiance-0-0"), 20, 24)
        np.testing.assert_array_equal(shown, image)


def test_a_clean_file_that_keeps_the_noisy_image_shows_the_picture(folder):
    noisy, image = render(0), render(1)
    planes = {f"View.Noisy Image.{c}": noisy[..., i] for i, c in enumerate("RGB")}
    planes |= {f"View.Combined.{c}": noisy[..., i] for i, c in enumerate("RGB")}
    write_channels("noisy.exr", planes, formats=dict.fromkeys(planes, "float"))
    write_exr("clean.exr", image, like="noisy.exr")
    assert main(["compare", "noisy.exr", "clean.exr", "-o", "page.html"]) == 0
    for place, expected in enumerate((noisy, image)):
        shown = decode(bytes_of(folder / "page.html", f"radiance-0-{place}"), HEIGHT, WIDTH)
        np.testing.assert_array_equal(shown, expected.astype(np.float16))


def test_page_names_nothing_outside_of_itself(folder):
    for name in "ab":
        write(folder / f"{name}.exr", render(0))
    assert main(["compare", "a.exr", "b.exr", "-o", "page.html"]) == 0
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert not re.search(r"""https?:|src=|href="(?!data:)|@import|url\(|fetch\(""", text)
    assert str(folder) not in text
    assert "default-src 'none'" in text


def test_whatever_the_page_looks_up_by_its_id_is_there_once(folder):
    # a menu that bore the id of embedded data was found in its place, and the picture never came
    for name in "ab":
        write(folder / f"{name}.exr", render(0))
    assert main(["compare", "a.exr", "b.exr", "-o", "page.html"]) == 0
    text = (folder / "page.html").read_text(encoding="utf-8")
    identities = re.findall(r'<[^<>]*\bid="([^"]+)"', text)
    assert {"radiance-0-0", "radiance-0-1", "cube", "view"} <= set(identities)
    assert len(set(identities)) == len(identities)


def test_titles_and_labels_cannot_break_out_of_the_page(folder):
    for name in "ab":
        write(folder / f"{name}.exr", render(0))
    evil = "</script><script>alert(1)</script>&amp;"
    command = ["compare", "a.exr", "b.exr", "-o", "page.html", "--label", evil, "--label", "b"]
    assert main([*command, "--title", "<i>$title"]) == 0
    text = (folder / "page.html").read_text(encoding="utf-8")
    assert evil not in text
    assert "<h1>&lt;i&gt;$title</h1>" in text
    assert data_of(folder / "page.html")["labels"] == [evil, "b"]


def test_without_a_reference_there_are_no_metrics_and_no_packages_needed(folder, monkeypatch):
    monkeypatch.setattr(Metric, "is_installed", False)
    for name in "ab":
        write(folder / f"{name}.exr", render(0))
    assert main(["compare", "a.exr", "b.exr", "-o", "page.html"]) == 0
    data = data_of(folder / "page.html")
    assert data["metrics"] == []
    assert not data["frames"][0]["has_reference"]


def test_missing_packages_are_one_line_that_says_what_to_install(folder, monkeypatch, capsys):
    monkeypatch.setattr(metrics, "find_spec", lambda module: module == "numpy" or None)
    for name in "ar":
        write(folder / f"{name}.exr", render(0))
    assert main(["compare", "a.exr", "-r", "r.exr", "-o", "page.html"]) == 2
    error = capsys.readouterr().err
    assert "psnr, ssim, flip must be measured with scikit-image, flip-evaluator" in error
    assert "pip install 'stillray[compare]'" in error
    assert error.count("\n") == 1
    assert not (folder / "page.html").exists()


def test_crop_and_downscale_show_a_part_but_measure_every_pixel_of_it(folder):
    pytest.importorskip("flip_evaluator")
    pytest.importorskip("skimage")
    image = write(folder / "a.exr", render(0))
    truth = write(folder / "r.exr", render(1))
    part = (slice(3, 28), slice(2, 17))
    command = ["compare", "a.exr", "-r", "r.exr", "-o", "page.html", "--crop", "2,3,15,25"]
    assert main([*command, "--downscale", "2"]) == 0
    page = folder / "page.html"
    data = data_of(page)
    assert (data["width"], data["height"], data["origin"]) == (8, 13, [2, 3])
    back = decode(bytes_of(page, "radiance-0-0"), 13, 8)
    np.testing.assert_array_equal(back, box_average(image[part], 2).astype(np.float16))
    psnr = metrics.evaluate([image[part]], [truth[part]], names=["psnr"])["psnr"]
    assert data["frames"][0]["rows"][0][0]["text"] == f"{psnr:.2f}"


def test_pixels_that_are_not_finite_are_counted_and_not_measured(folder):
    pytest.importorskip("flip_evaluator")
    pytest.importorskip("skimage")
    broken = render(0)
    broken[0, 0] = np.nan
    broken[1, 1, 2] = np.inf
    write(folder / "a.exr", broken)
    write(folder / "b.exr", render(1) + 1e5)
    write(folder / "r.exr", render(2))
    assert main(["compare", "a.exr", "b.exr", "-r", "r.exr", "-o", "page.html"]) == 0
    data = data_of(folder / "page.html")
    frame = data["frames"][0]
    assert frame["not_finite"] == [2, 0, 0]
    assert frame["clamped"] == [0, HEIGHT * WIDTH, 0]
    assert frame["has_flip"] == [False, True, False]
    assert {cell["text"] for cell in frame["rows"][0]} == {"–"}
    assert not any(cell["best"] for row in frame["rows"] for cell in row)


@pytest.fixture
def shots(folder):
    """Two sequences of frames 1 to 4, the second without 3, and references of 2 to 4."""
    for number in range(1, 5):
        write(folder / f"a.{number:04d}.exr", render(number))
        if number != 3:
            write(folder / f"b.{number:04d}.exr", render(number + 10))
        if number != 1:
            write(folder / f"r.{number:04d}.exr", render(number + 20))
    return folder


def test_sequences_are_paired_by_number(shots):
    sources = pair(["a.####.exr", "b.%04d.exr"], "r.####.exr")
    assert [frame.number for frame in sources.frames] == [1, 2, 4]
    assert sources.left_out == (3,)
    assert [frame.reference and frame.reference.name for frame in sources.frames] == [
        None, "r.0002.exr", "r.0004.exr",
    ]  # fmt: skip
    assert sources.labels == ("a", "b")
    only = pair(["a.####.exr", "b.####.exr"], frames="2-3,9")
    assert [frame.number for frame in only.frames] == [2]
    assert only.left_out == (3,)
    assert pair(["a.####.exr", "b.####.exr"], frames="1-2").left_out == ()


def test_sequence_page_has_flicker_of_frames_that_follow_each_other_and_means(shots, capsys):
    pytest.importorskip("flip_evaluator")
    pytest.importorskip("skimage")
    assert main(["compare", "a.####.exr", "-r", "r.####.exr", "-o", "page.html"]) == 0
    data = data_of(shots / "page.html")
    names = [metric["name"] for metric in data["metrics"]]
    column = names.index("flicker")
    shown = [frame["rows"][0][column]["text"] for frame in data["frames"]]
    flicker = [
        metrics.flicker(render(n - 1), render(n), render(n + 19), render(n + 20)) for n in (3, 4)
    ]
    # frame 1 has no reference, frame 2 none before it
    assert shown == ["–", "–", *(f"{value:.4f}" for value in flicker)]
    assert data["means"][0][column]["text"] == f"{np.mean(flicker):.4f}"
    smape = [
        metrics.evaluate([render(n)], [render(n + 20)], names=["smape"])["smape"] for n in (2, 3, 4)
    ]
    assert data["means"][0][names.index("smape")]["text"] == f"{np.mean(smape):.4f}"
    assert "mean of the 3 of 4 with a reference" in capsys.readouterr().out
    assert main(["compare", "a.####.exr", "b.####.exr", "-r", "r.####.exr", "-o", "two.html"]) == 0
    assert "left out, not in every sequence: 3" in capsys.readouterr().err
    # 2 and 4 do not follow each other
    assert "flicker" not in [metric["name"] for metric in data_of(shots / "two.html")["metrics"]]


def test_means_are_not_taken_over_different_frames():
    rows = scores.means([[{"psnr": 20.0}, {}], [{"psnr": 30.0}, {"psnr": 40.0}]])
    assert rows == [{"psnr": 25.0}, {}]


def test_labels_are_as_short_as_they_can_be_told_apart(folder):
    for name in ("noisy/shot.exr", "clean/shot.exr"):
        (folder / name).parent.mkdir()
        write(folder / name, render(0))
    assert pair(["noisy/shot.exr", "clean/shot.exr"]).labels == ("noisy/shot", "clean/shot")
    write(folder / "other.exr", render(0))
    assert pair(["other.exr", "clean/shot.exr"]).labels == ("other", "shot")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["a.0001.exr"], ["images must be two or more", "a.0001.exr"]),
        (["a.0001.exr", "gone.exr"], ["gone.exr: no such file"]),
        (["a.0001.exr", "b.####.exr"], ["all be files or all sequences"]),
        (["a.####.exr", "b.####.exr", "--frames", "3"], ["frame in common", "3"]),
        (["a.####.exr", "b.####.exr", "--frames", "4-2"], ["frames must count upwards", "4-2"]),
        (["a.0001.exr", "b.0001.exr", "--frames", "1"], ["--frames", "sequence"]),
        (["a.####.exr", "-r", "r.####.exr", "--frames", "1"], ["reference must have a frame"]),
        (["a.0001.exr", "b.0001.exr", "--label", "x"], ["--label", "(2), got 1"]),
        (["a.0001.exr", "b.0001.exr", "--crop", "1,2,3"], ["--crop", "X,Y,WIDTH,HEIGHT", "1,2,3"]),
        (["a.0001.exr", "b.0001.exr", "--crop", "9,0,10,5"], ["--crop", "18 x 33", "9,0,10,5"]),
        (["a.0001.exr", "-r", "r.0002.exr", "--crop", "0,0,6,20"], ["7 x 7", "6 x 20"]),
        (["a.0001.exr", "b.0001.exr", "--downscale", "0"], ["--downscale", "0"]),
        (["a.0001.exr", "small.exr"], ["small.exr: must have the size (33, 18)", "(5, 5)"]),
        (["a.0001.exr", "b.0001.exr", "-o", "page.png"], ["output", ".html", "page.png"]),
        (["a.0001.exr", "b.0001.exr", "-o", "nowhere/page.html"], ["nowhere", "writable"]),
        (
            ["a.0001.exr", "b.0001.exr", "--max-megapixels", "0.0004"],
            ["0.0004 million pixels, got 0.0", "2 pictures", "--downscale 2 fits"],
        ),
    ],
)
def test_bad_usage_is_one_line_and_leaves_no_page(shots, capsys, arguments, words):
    write(shots / "small.exr", render(0, (5, 5, 3)))
    before = sorted(shots.iterdir())
    output = [] if "-o" in arguments else ["-o", "page.html"]
    assert main(["compare", *arguments, *output]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert all(word in error for word in words), error
    assert sorted(shots.iterdir()) == before


def test_the_page_never_replaces_an_image(folder):
    for name in "ab":
        write(folder / f"{name}.exr", render(0))
    (folder / "a.html").symlink_to("a.exr")
    assert main(["compare", "a.exr", "b.exr", "-o", "a.html"]) == 2
    assert (folder / "a.html").is_symlink()


def test_commands_load_no_metric_packages_until_they_measure():
    code = (
        "import sys, stillray.cli, stillray.compare;"
        "print(sorted({'skimage', 'flip_evaluator', 'numpy', 'cv2'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_no_pair_is_an_error_for_the_library_too():
    with pytest.raises(InputError, match="two or more"):
        pair(["a.exr"])
