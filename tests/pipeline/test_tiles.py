"""Tiles cover a frame, see enough, and give its pixels."""

import re
from dataclasses import replace

import numpy as np
import pytest

import stillray.pipeline.plan
from stillray.errors import InputError
from stillray.families.registry import family_of
from stillray.frame import Frame
from stillray.model_spec import load
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.tiles import MemoryUse, parse_memory, plan_tiles, tiles_of
from tests.conftest import make_frame

ALL = MemoryUse(channels=12)


@pytest.mark.parametrize("shape", [(1, 1), (33, 18), (257, 64), (300, 431)])
@pytest.mark.parametrize(("size", "halo", "multiple"), [(64, 16, 16), (40, 3, 1), (5, 16, 16)])
def test_tiles_give_every_pixel_once_and_see_around_it(shape, size, halo, multiple):
    count = np.zeros(shape, int)
    for tile in tiles_of(shape, size, halo, multiple):
        count[tile.inner] += 1
        for inner, outer, within, extent in zip(
            tile.inner, tile.outer, tile.within, shape, strict=True
        ):
            assert outer.start % multiple == 0
            assert outer.start <= max(inner.start - halo, 0) or outer.start == 0
            assert outer.stop == extent or outer.stop >= inner.stop + halo
            assert within == slice(inner.start - outer.start, inner.stop - outer.start)
    assert (count == 1).all()


def test_frame_that_fits_is_one_tile():
    traits = family_of(load("kpyr-5")).traits
    for limit in (None, 64 << 30):
        (tile,) = plan_tiles((720, 1280), ALL, traits, limit, "kpyr-5")
        assert tile.inner == tile.outer == (slice(0, 720), slice(0, 1280))


def area(tile):
    rows, columns = (side.stop - side.start for side in tile.outer)
    return rows * columns


def test_less_memory_makes_smaller_tiles_until_it_is_refused():
    traits = family_of(load("kpyr-5")).traits
    areas = []
    for gigabytes in (12, 8, 7, 6):
        tiles = plan_tiles((2160, 3840), ALL, traits, gigabytes << 30, "kpyr-5")
        areas.append(max(area(tile) for tile in tiles))
    assert areas == sorted(areas, reverse=True)
    assert areas[-1] < areas[0]
    with pytest.raises(InputError, match=r"max_memory must be \d+M or more for 3840 x 2160 pixels"):
        plan_tiles((2160, 3840), ALL, traits, 1 << 30, "kpyr-5")


@pytest.mark.parametrize(
    ("shape", "channels", "megabytes"), [((101, 203), 12, 300), ((360, 640), 12, 500)]
)
def test_little_memory_is_enough_for_small_frames(shape, channels, megabytes):
    """Whole runs of kpyr-5 took 150 and 359 MiB."""
    traits = family_of(load("kpyr-5")).traits
    assert plan_tiles(shape, MemoryUse(channels=channels), traits, megabytes << 20, "kpyr-5")


def test_fewer_buffers_take_less_memory():
    traits = family_of(load("kpyr-5")).traits
    with pytest.raises(InputError, match="max_memory must be"):
        plan_tiles((1080, 1920), ALL, traits, 1300 << 20, "kpyr-5")
    assert plan_tiles((1080, 1920), MemoryUse(channels=3), traits, 1300 << 20, "kpyr-5")
    frame = make_frame(9, 7, shift=1.0)
    assert Frame(color=frame.color, samples=4).channels == 3
    assert Frame(color=frame.color, samples=frame.depth + 1).channels == 4
    assert frame.channels == 12


def test_frames_without_a_past_and_integers_take_less_memory():
    """Of 1920 x 1080 with 12 channels, kpyr-5-still took 1,324 MiB in tiles, 2,230 whole."""
    traits = family_of(load("kpyr-5-still")).traits
    alone = MemoryUse(channels=12, past=False, integers=True)
    for use, enough in ((alone, 1600), (replace(alone, integers=False), 1800), (ALL, 2000)):
        assert len(plan_tiles((1080, 1920), use, traits, enough << 20, "kpyr-5-still")) > 1
        with pytest.raises(InputError, match=f"got {(enough - 250) / 1024:.4g}G"):
            plan_tiles((1080, 1920), use, traits, (enough - 250) << 20, "kpyr-5-still")
    assert len(plan_tiles((1080, 1920), alone, traits, 2600 << 20, "kpyr-5-still")) == 1
    assert len(plan_tiles((1080, 1920), ALL, traits, 2600 << 20, "kpyr-5-still")) > 1
    past = replace(ALL, integers=True)
    assert past.tile_bytes(traits) == ALL.tile_bytes(traits)  # its floor takes what they spare


@pytest.mark.parametrize("amount", [1000, 700 << 10, 300 << 20])
def test_the_memory_that_is_asked_for_is_enough(amount):
    traits = family_of(load("kpyr-5")).traits
    told = {1000: "1000 bytes", 700 << 10: "700K", 300 << 20: "300M"}[amount]
    with pytest.raises(InputError, match=f"got {told}$") as refused:
        plan_tiles((1080, 1920), ALL, traits, amount, "kpyr-5")
    asked = re.search(r"must be (\d+M)", str(refused.value))
    assert plan_tiles((1080, 1920), ALL, traits, parse_memory(asked[1]), "kpyr-5")


def test_a_prefilters_memory_is_not_asked_for_first():
    with Denoiser("kpyr-5-still", max_memory=200 << 20) as denoiser:
        with pytest.raises(InputError, match=r"with kpyr-5-still, got 200M"):
            denoiser.denoise(make_frame(300, 400))
        with pytest.raises(InputError, match=r"with kpyr-5-still, got 200M"):
            denoiser.stages(make_frame(300, 400))


@pytest.mark.parametrize("amount", [0, -4, float("nan"), True, "2G"])
def test_memory_must_be_a_number_above_0(amount):
    with pytest.raises(InputError, match="max_memory must be a number of bytes above 0"):
        Denoiser("kpyr-5s", max_memory=amount)


@pytest.mark.parametrize(
    ("text", "amount"),
    [("2G", 2 << 30), ("1.5g", 3 << 29), ("800M", 800 << 20), ("64 KiB", 1 << 16), ("12", 12)],
)
def test_parse_memory(text, amount):
    assert parse_memory(text) == amount


@pytest.mark.parametrize("text", ["", "G", "2X", "-1G", "1,5G"])
def test_parse_memory_refuses_other_text(text):
    with pytest.raises(InputError, match="max-memory must be an amount such as 2G"):
        parse_memory(text)


@pytest.fixture
def in_tiles(monkeypatch):
    """Makes denoisers use tiles of a size, with an overlap."""

    def set_tiles(size, halo=None):
        def plan(shape, use, traits, max_memory, name):
            if max_memory is None:
                return plan_tiles(shape, use, traits, None, name)
            around = traits.tile_overlap if halo is None else halo
            return tiles_of(shape, size, around, traits.tile_alignment)

        monkeypatch.setattr(stillray.pipeline.plan, "plan_tiles", plan)

    return set_tiles


def differences(model, frames):
    """The largest relative difference of each frame, whole against in tiles."""
    with Denoiser(model) as whole, Denoiser(model, max_memory=1) as tiled:
        found = []
        for frame in frames:
            expected, result = whole.denoise(frame), tiled.denoise(frame)
            found.append(float((np.abs(result - expected) / (expected + 1e-4)).max()))
        return found


# Rounding: an operator may take other shapes in other ways, 1.4e-6 measured over three frames of
# 640 x 360. Half precision, in which pictures are written, is 300 times coarser.
TOLERANCE = 1e-5


@pytest.mark.parametrize(
    ("model", "size", "short"), [("wskp-3s", 64, 3), ("wskp-6", 64, 3), ("wskp-mr", 128, 8)]
)
def test_tiles_are_the_whole_frame_but_for_rounding(in_tiles, model, size, short):
    in_tiles(size)
    frames = [make_frame(97, 150, seed, shift=1.5) for seed in range(3)]
    assert max(differences(model, frames)) < TOLERANCE
    # one pixel less than needed shows, so what is seen is not more than needed by much
    in_tiles(size, halo=short)
    assert max(differences(model, frames)) > TOLERANCE


def test_tiles_of_a_pyramid_are_the_whole_frame_but_for_rounding(in_tiles):
    in_tiles(2 * 208 + 48)
    frames = [make_frame(65, 500, seed, shift=1.5) for seed in range(2)]
    assert max(differences("kpyr-5", frames)) < TOLERANCE
    in_tiles(160, halo=32)
    assert max(differences("kpyr-5", frames)) > TOLERANCE


def test_exposure_is_that_of_the_frame_not_of_the_tile(in_tiles):
    in_tiles(64)
    frame = make_frame(97, 150)
    frame.color[:, :75] *= 1000  # tiles of their own would be exposed quite differently
    assert max(differences("wskp-3s", [frame])) < TOLERANCE


def test_broken_pixels_are_repaired_across_tiles(in_tiles):
    in_tiles(64)
    frame = make_frame(97, 150)
    frame.color[30:70, 40:80] = np.nan
    assert max(differences("wskp-3s", [frame])) < TOLERANCE


def test_tiles_count_the_samples_of_their_own_pixels(in_tiles, rng):
    in_tiles(2 * 208 + 48)
    samples = rng.choice(np.float32([1, 4, 64]), (65, 500))
    frames = [replace(make_frame(65, 500, seed, shift=1.5), samples=samples) for seed in range(2)]
    assert max(differences("kpyr-5", frames)) < TOLERANCE
