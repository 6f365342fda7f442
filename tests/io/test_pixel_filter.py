"""The renderer's pixel filter: its spread, where a frame has it from, and who is told."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

import stillray
from stillray.cli import main
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.pixel_filter import FILTER_ATTRIBUTE
from stillray.io.exr.read import read_exr, read_picture
from stillray.io.exr.write import write_exr
from stillray.models.registry import find_model
from stillray.pixel_filter import filter_sharpness, filter_spread, parse_filter
from tests.conftest import make_frame

BLENDER = Path(__file__).parents[1] / "data/blender/frame_0001.exr"
SOFT = filter_spread("blackman-harris")


def window(t):
    """Harris's window of four terms over its length, -1/2 to 1/2."""
    cosines = (np.cos(2 * np.pi * k * t) for k in (1, 2, 3))
    return 0.35875 + np.dot([0.48829, 0.14128, 0.01168], list(cosines))


@pytest.mark.parametrize(
    ("kind", "width", "weigh", "reach"),
    [
        ("box", 1.0, np.ones_like, 0.5),
        ("box", 2.5, np.ones_like, 1.25),
        ("triangle", 2.0, lambda x: 1 - np.abs(x), 1.0),
        # as Cycles has them: the Gaussian ends at a width and a half, the window at a width
        ("gaussian", 1.5, lambda x: np.exp(-2 * (6 * x / 4.5) ** 2), 2.25),
        ("blackman-harris", 1.5, lambda x: window(x / 3), 1.5),
        ("blackman-harris", 1.0, lambda x: window(x / 2), 1.0),
    ],
)
def test_a_spread_is_the_filter_s_standard_deviation(kind, width, weigh, reach):
    x = np.linspace(-reach, reach, 200_001)
    weights = weigh(x)
    expected = np.sqrt((weights * x**2).sum() / weights.sum())
    assert filter_spread(kind, width) == pytest.approx(expected, rel=1e-4)


def test_a_user_s_words_name_a_filter():
    assert parse_filter("box") == filter_spread("box") == pytest.approx(12**-0.5)
    assert parse_filter(" Gaussian:2 ") == filter_spread("gaussian", 2.0) == 0.5
    assert parse_filter("0.37") == 0.37


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("mitchell", "pixel filter must be box, triangle"),
        ("gaussian:wide", "got gaussian:wide"),
        ("box:0", "got box:0"),
        ("box:nan", "got box:nan"),
        ("box:", "got box:"),
        ("0.37:9", "got 0.37:9"),
        ("-0.1", "0 to 4 pixels, got -0.1"),
        ("gaussian:400", "0 to 4 pixels, got gaussian:400"),
        ("", "pixel filter must be"),
    ],
)
def test_what_is_no_filter_is_one_clear_error(text, message):
    with pytest.raises(InputError, match=message):
        parse_filter(text)


@pytest.mark.parametrize("spread", [-1, np.nan, np.inf, "box", np.ones((4, 5))])
def test_a_frame_takes_one_number_that_a_filter_may_have(spread):
    with pytest.raises(InputError, match="filter_spread must be 0 to 4 pixels"):
        stillray.Frame(color=np.ones((4, 5, 3)), filter_spread=spread)


def test_sharpness_falls_from_a_box_to_blender_s_filter():
    spreads = [0.0, filter_spread("box"), 0.35, SOFT, 1.0]
    sharpness = [filter_sharpness(spread) for spread in spreads]
    assert sharpness[:2] == [1, 1]
    assert 0 < sharpness[2] < 1
    assert sharpness[3:] == [0, 0]
    assert filter_sharpness(None) == 1


def write(path, **attributes):
    rng = np.random.default_rng(0)
    channels = {name: rng.random((12, 17), np.float32) for name in "RGB"}
    write_channels(path, channels, attributes=attributes)
    return path


def test_files_of_cycles_have_blender_s_filter_and_others_none(tmp_path):
    assert read_exr(BLENDER).filter_spread == SOFT
    assert read_exr(write(tmp_path / "f.exr")).filter_spread is None
    write_exr(tmp_path / "c.exr", read_picture(BLENDER), like=BLENDER)
    assert read_exr(tmp_path / "c.exr").filter_spread == SOFT


def test_an_attribute_says_it_before_anything_else(tmp_path):
    said = {FILTER_ATTRIBUTE: "gaussian:2", "cycles.View.samples": "16"}
    assert read_exr(write(tmp_path / "f.exr", **said)).filter_spread == 0.5


def test_an_attribute_that_is_no_filter_is_told_and_not_used(tmp_path, capsys):
    path = write(tmp_path / "f.exr", **{FILTER_ATTRIBUTE: "round"})
    assert read_exr(path).filter_spread is None
    assert main(["info", str(path)]) == 0
    out = capsys.readouterr().out
    assert f"pixel filter: not known ({FILTER_ATTRIBUTE}: pixel filter must be box, " in out


def test_an_attribute_may_be_a_number(tmp_path):
    assert read_exr(write(tmp_path / "f.exr", **{FILTER_ATTRIBUTE: 0.375})).filter_spread == 0.375


def test_a_width_that_is_none_is_an_error():
    for width in (0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="width of a pixel filter must be above 0 pixels"):
            filter_spread("box", width)


def test_info_tells_the_filter_and_where_it_is_from(tmp_path, capsys):
    assert main(["info", str(BLENDER)]) == 0
    line = next(x for x in capsys.readouterr().out.splitlines() if x.startswith("pixel filter"))
    assert line.startswith("pixel filter: 0.42 pixels of standard deviation, from cycles.View")
    assert main(["info", str(write(tmp_path / "f.exr")), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)["pixel_filter"]
    assert found == {"from": None, "spread": None, "note": "", "told": True}


def test_the_command_line_says_it_for_files_that_do_not(tmp_path):
    path, clean = tmp_path / "f.exr", {}
    frame = make_frame(32, 48)
    glint = np.array(frame.color)
    glint[10:14, 20:24] = 30
    write_channels(path, dict(zip("RGB", np.moveaxis(glint, 2, 0), strict=True)))
    for told in ("box", "blackman-harris", None):
        out = tmp_path / f"{told}.exr"
        more = ["--pixel-filter", told] if told else []
        assert main(["denoise", str(path), "-o", str(out), *more]) == 0
        clean[told] = read_picture(out)
    with stillray.Denoiser("high", temporal=False) as denoiser:
        for told, spread in (("blackman-harris", SOFT), ("box", 12**-0.5), (None, None)):
            frame = stillray.Frame(color=read_exr(path).color, filter_spread=spread)
            expected = denoiser.denoise(frame).astype(np.float16)  # as the file holds it
            np.testing.assert_array_equal(clean[told], expected)
    assert not np.array_equal(clean["blackman-harris"], clean["box"])
    assert main(["denoise", str(path), "-o", str(tmp_path / "x.exr"), "--pixel-filter", "?"]) == 2
    assert not (tmp_path / "x.exr").exists()


def bars(spread):
    """Dark bars of a pixel before a window, as a renderer with a pixel filter shows them."""
    color = np.full((32, 48, 3), 20, np.float32)
    color[:, 5::6] = 0.05
    albedo = np.full_like(color, 0.5)
    return stillray.Frame(color=color, albedo=albedo, filter_spread=spread)


def test_bars_before_a_window_are_kept_dark_of_a_box_and_as_they_are_of_softer_filters():
    def darkness(spread, tone):
        info = find_model("kpyr-5")
        decoder = dataclasses.replace(info.spec.decoder, resolve_tone=tone)
        info = dataclasses.replace(info, spec=dataclasses.replace(info.spec, decoder=decoder))
        with stillray.Denoiser(info, temporal=False) as denoiser:
            return denoiser.denoise(bars(spread))

    box, unknown, soft = (darkness(s, 4.0) for s in (filter_spread("box"), None, SOFT))
    np.testing.assert_array_equal(box, unknown)
    np.testing.assert_array_equal(soft, darkness(SOFT, 0.0))
    middle = darkness(0.35, 4.0)
    at = np.s_[4:-4, 5::6]
    assert box[at].mean() < middle[at].mean() < soft[at].mean()
