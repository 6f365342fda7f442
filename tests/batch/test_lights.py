"""Light passes without the colour of surfaces: times their colours they add up to the beauty."""

import json
from pathlib import Path

import numpy as np
import pytest

import stillray
from stillray.batch.lights import denoise_lights
from stillray.cli import main
from stillray.io.exr.read import read_channels, read_lights
from tests.conftest import make_frame

BLENDER = Path(__file__).parents[1] / "data" / "blender"
KINDS = ("Diffuse", "Glossy", "Transmission")
REST = ("Emission", "Environment", "Volume Direct", "Volume Indirect")
SHAPE = 34, 45


def added_up(channels):
    """What a compositor makes of Blender's passes."""

    def layer(name):
        return np.stack([channels[f"ViewLayer.{name}.{c}"] for c in "RGB"], axis=-1)

    total = sum(layer(name) for name in REST)
    for kind in KINDS:
        light = layer(f"{kind} Direct") + layer(f"{kind} Indirect")
        total = total + light * layer(f"{kind} Color")
    return total, layer("Combined")


def difference(channels):
    total, beauty = added_up(channels)
    return np.abs(total - beauty) / (beauty + 1e-3)


@pytest.mark.parametrize("model", ["high", "fast"])
def test_passes_of_a_real_file_add_up_to_the_clean_beauty(model, tmp_path):
    options = stillray.ShotOptions(aovs=())
    sources = str(BLENDER / "lights_####.exr")
    stillray.denoise_shot(sources, tmp_path / "c_####.exr", model=model, options=options)
    for number in (1, 2):
        noisy = read_channels(BLENDER / f"lights_{number:04d}.exr")
        clean = read_channels(tmp_path / f"c_{number:04d}.exr")
        assert list(clean) == list(noisy)
        assert difference(clean).mean() < max(5e-4, difference(noisy).mean())
        assert difference(clean).max() < 3e-3  # a few roundings of half floats
        changed = np.abs(added_up(clean)[1] - added_up(noisy)[1]).mean()
        assert changed > 0.02 * added_up(noisy)[1].mean()


def test_colours_are_read_beside_the_light_that_needs_them():
    path = BLENDER / "lights_0001.exr"
    assert set(read_lights(path, ["ViewLayer.Diffuse Direct", "ViewLayer.Emission"])) == {
        "ViewLayer.Diffuse Direct", "ViewLayer.Diffuse Color", "ViewLayer.Emission",
    }  # fmt: skip
    # a file without the colour
    assert set(read_lights(BLENDER / "frame_0001.exr")) == {"ViewLayer.Diffuse Direct"}


def test_light_without_its_view_layer_is_that_of_the_whole_name(tmp_path):
    path = BLENDER / "lights_0001.exr"
    assert set(read_lights(path, ["Diffuse Direct", "Emission"])) == {
        "ViewLayer.Diffuse Direct", "ViewLayer.Diffuse Color", "ViewLayer.Emission",
    }  # fmt: skip
    written = []
    for name in ("Diffuse Direct", "ViewLayer.Diffuse Direct"):
        options = stillray.ShotOptions(aovs=(name,))
        stillray.denoise_shot(str(path), tmp_path / "c.exr", model="fast", options=options)
        written.append(read_channels(tmp_path / "c.exr"))
    for channel, plane in written[1].items():
        np.testing.assert_array_equal(written[0][channel], plane)
    noisy = read_channels(path)
    assert not np.array_equal(written[0]["ViewLayer.Diffuse Direct.G"],
                              noisy["ViewLayer.Diffuse Direct.G"])  # fmt: skip


def test_a_light_that_is_not_there_is_one_of_the_aovs(tmp_path):
    options = stillray.ShotOptions(aovs=("Rim",))
    words = r"aovs must name layers of three colours, got Rim; the file has .*\.Diffuse Direct"
    with pytest.raises(stillray.InputError, match=words):
        stillray.denoise_shot(
            str(BLENDER / "lights_0001.exr"), tmp_path / "c.exr", model="fast", options=options
        )


def test_colour_passes_that_are_written_anew_are_named_in_the_end(tmp_path, capsys):
    source = BLENDER / "lights_0001.exr"
    noisy = read_channels(source)

    def denoised(aovs, output):
        command = ["denoise", str(source), "-o", str(tmp_path / output), "-m", "fast", "--json"]
        assert main([*command, "--aovs", aovs]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    for aovs in ("all", "Diffuse Direct,Emission"):
        events = denoised(aovs, "c.exr")
        assert [event["event"] for event in events] == ["frame", "note", "summary"]
        clean = read_channels(tmp_path / "c.exr")
        changed = {n.rpartition(".")[0] for n in noisy if not np.array_equal(noisy[n], clean[n])}
        anew = {name for name in changed if name.endswith(" Color")}
        named = events[1]["text"].removeprefix("written anew as well: ").split(", filtered")[0]
        assert anew
        assert set(named.split(", ")) >= anew
    assert set(named.split(", ")) == {"ViewLayer.Diffuse Color"}
    # light that has its colour, and a file that holds the picture alone
    assert [event["event"] for event in denoised("Emission", "c.exr")] == ["frame", "summary"]
    notes = [event["text"] for event in denoised("all", "c.pfm") if event["event"] == "note"]
    assert notes == [".pfm files hold the color alone"]


def test_no_light_is_lost_where_the_colour_is_black_beside_a_silhouette():
    frame = make_frame(*SHAPE)
    color = np.full((*SHAPE, 3), 0.5, np.float32)
    color[:, 20:] = 0
    light = frame.color + 0.1
    layers = {"Diffuse Direct": light, "Diffuse Color": color}
    frame = stillray.Frame(color=light * color)
    with stillray.Denoiser("high", threads=1) as denoiser:
        image, clean = denoise_lights(denoiser, frame, layers)
    assert image[:, 20:22].max() > 1e-3  # what the kernels carried over the edge
    found = clean["Diffuse Direct"] * clean["Diffuse Color"]
    np.testing.assert_allclose(found, image, rtol=1e-4, atol=1e-5)
    assert clean["Diffuse Direct"].max() <= light.max()  # never divided by almost nothing


def test_light_without_its_colour_is_filtered_as_it_is():
    frame = make_frame(*SHAPE)
    layers = {"DiffDir": frame.color / 2}
    with stillray.Denoiser("fast", threads=1) as denoiser:
        _, found = denoise_lights(denoiser, frame, layers)
        denoiser.state = None
        _, expected = denoiser.denoise_layers(frame, layers, irradiance=["DiffDir"])
    np.testing.assert_array_equal(found["DiffDir"], expected["DiffDir"])


def test_light_that_is_not_finite_stays_where_it_is():
    frame = make_frame(*SHAPE)
    light = frame.color.copy()
    light[5, 5], light[9, 9] = np.nan, np.inf
    layers = {"DiffDir": light, "DiffCol": np.full((*SHAPE, 3), 0.5, np.float32)}
    with stillray.Denoiser("fast", threads=1) as denoiser:
        _, found = denoise_lights(denoiser, frame, layers)
    assert all(np.isfinite(layer).all() for layer in found.values())
