from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from dataclasses import replace

from stillray.errors import InputError
from stillray.io.exr.read import read_channels, read_exr
from stillray_training.examples import find_sequences
from stillray_training.simulate import buffers, trace, variant
from stillray_training.simulate.jobs import Job, run_job
from stillray_training.simulate.sequence import (
    SequenceOptions,
    is_complete,
    jitters_of,
    render_sequence,
)
from stillray_training.simulate.variant import load_mitsuba
from tests.training.simulate_worlds import FRONT, everything, exact, moment, noisy, stage_of

SMALL = SequenceOptions(frames=2, height=24, width=32, reference_spp=2, seed=5, speed=0.02)
EFFECTS = ("moving_object", "soft_shadow")


@pytest.fixture(scope="module")
def mi():
    return load_mitsuba("scalar_rgb")[0]


@pytest.fixture(scope="module")
def stage(mi):
    return stage_of(mi, everything(), EFFECTS, height=24, width=32)


@pytest.fixture(scope="module")
def rendered(stage, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequence") / "everything-0003-0"
    render_sequence(stage, folder, SMALL)
    return folder


def test_a_rendered_sequence_reads_back_as_frames(rendered):
    assert find_sequences(rendered.parent) == [rendered]
    frame = read_exr(rendered / "frame_0001.exr")
    assert frame.shape == (24, 32)
    assert frame.given == {"color", "albedo", "normal", "depth", "motion"}
    hit = frame.depth > 0
    assert hit.mean() > 0.5
    np.testing.assert_allclose(np.linalg.norm(frame.normal[hit], axis=-1), 1, atol=2e-3)
    assert (rendered / "ref_0001.exr").is_file()
    assert not (rendered / "ref_0000.exr").exists()


def test_the_record_names_effects_and_cameras(rendered):
    record = json.loads((rendered / "sequence.json").read_text())
    assert set(record["effects"]) == set(EFFECTS)
    assert record["scene"] == "everything"
    assert len(record["cameras"]) == 2
    matrix = np.array(record["cameras"][1]["camera_to_world"])
    assert matrix.shape == (4, 4)
    np.testing.assert_allclose(matrix[:3, :3].T @ matrix[:3, :3], np.eye(3), atol=1e-9)


def test_the_same_seed_gives_the_same_pixels_and_another_seed_others(stage, rendered, tmp_path):
    render_sequence(stage, tmp_path / "again", SMALL)
    render_sequence(stage, tmp_path / "other", replace(SMALL, seed=6))
    for name in ("frame_0001.exr", "ref_0001.exr"):
        one, two = read_channels(rendered / name), read_channels(tmp_path / "again" / name)
        for channel, plane in one.items():
            np.testing.assert_array_equal(plane, two[channel])
        other = read_channels(tmp_path / "other" / name)
        assert (other["R"] != one["R"]).any()


@pytest.mark.parametrize("lost", ["frame_0001.exr", "ref_0001.exr", "frame_0000.exr"])
def test_a_killed_run_resumes_with_the_same_pixels_and_keeps_what_is_there(
    stage, rendered, tmp_path, lost
):
    folder = tmp_path / "killed"
    folder.mkdir()
    for path in rendered.glob("*.exr"):
        if path.name != lost:
            (folder / path.name).write_bytes(path.read_bytes())
    # what was being written when the process died has another name
    (folder / f".{lost}.abc.part").write_bytes(b"half a file")
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("[fr]*.exr")}
    assert not is_complete(folder)
    render_sequence(stage, folder, SMALL)
    assert is_complete(folder)
    for name, stamp in before.items():
        assert (folder / name).stat().st_mtime_ns == stamp
    one, two = read_channels(rendered / lost), read_channels(folder / lost)
    for channel, plane in one.items():
        np.testing.assert_array_equal(plane, two[channel])


def test_a_finished_sequence_is_not_touched(stage, rendered):
    before = {path: path.stat().st_mtime_ns for path in rendered.iterdir()}
    render_sequence(stage, rendered, SMALL)
    assert {path: path.stat().st_mtime_ns for path in rendered.iterdir()} == before


def test_frames_left_out_change_nothing_in_those_after_them(stage, rendered, tmp_path):
    render_sequence(stage, tmp_path / "late", replace(SMALL, first=1))
    written = {path.name for path in (tmp_path / "late").iterdir()}
    assert written == {"frame_0001.exr", "ref_0001.exr", "sequence.json"}
    one, two = (read_channels(f / "frame_0001.exr") for f in (rendered, tmp_path / "late"))
    for channel, plane in one.items():
        np.testing.assert_array_equal(plane, two[channel])


def test_recorded_cameras_give_the_same_frames_again(stage, rendered, tmp_path):
    again = replace(SMALL, cameras=str(rendered / "sequence.json"))
    render_sequence(stage, tmp_path / "again", again)
    one, two = (read_channels(f / "frame_0001.exr") for f in (rendered, tmp_path / "again"))
    for channel, plane in one.items():  # motion too: it needs the camera of the frame before
        np.testing.assert_allclose(plane, two[channel], rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{}", "cameras must be JSON with camera_to_world"),
        ("no json", "cameras must be JSON with camera_to_world"),
        ('{"frames": [{"camera_to_world": [1, 2]}], "fov_x_deg": 50}', "cameras must be JSON with"),
        (None, "cameras must be a readable file"),
    ],
)
def test_a_file_without_cameras_is_refused(stage, tmp_path, text, message):
    file = tmp_path / "cameras.json"
    if text is not None:
        file.write_text(text)
    with pytest.raises(InputError, match=message):
        render_sequence(stage, tmp_path / "out", replace(SMALL, cameras=str(file)))


def test_too_few_recorded_cameras_are_refused(stage, rendered, tmp_path):
    more = replace(SMALL, frames=3, cameras=str(rendered / "sequence.json"))
    with pytest.raises(InputError, match="cameras must hold 3, got 2"):
        render_sequence(stage, tmp_path / "out", more)


def test_a_frame_of_several_launches_is_the_mean_of_all_their_samples(mi, stage, monkeypatch):
    calls = []
    original = buffers.first_hits

    def keep(stage, shot, pixels, seed, each):
        seen = original(stage, shot, pixels, seed, each)
        calls.append((each, {name: values.copy() for name, values in seen.items()}))
        return seen

    monkeypatch.setattr(buffers, "first_hits", keep)
    monkeypatch.setattr(trace, "LANES", 2 * 24 * 32)
    frame = buffers.render_noisy(stage, moment(), spp=5, seed=3)
    assert [each for each, _ in calls] == [2, 2, 1]
    assert (calls[0][1]["color"] != calls[1][1]["color"]).any()  # not the same samples thrice
    color, hits, normal = (
        sum(seen[name] for _, seen in calls) for name in ("color", "hit", "normal")
    )
    np.testing.assert_allclose(frame["color"].reshape(-1, 3), color / 5, rtol=1e-6, atol=1e-9)
    assert ((frame["depth"].ravel() > 0) == (hits > 0)).all()
    length = np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-9)
    np.testing.assert_allclose(frame["normal"].reshape(-1, 3), normal / length, atol=1e-6)


def test_several_samples_are_the_sum_of_single_ones(mi, stage):
    shot = trace.Shot(time=1.0, camera=FRONT, previous=FRONT, jitter=np.zeros(2))
    stage.aim(FRONT, 5.0)
    number = np.arange(0, 24 * 32, 3)
    together = trace.first_hits(stage, shot, number, 7, 4)
    apart = trace.first_hits(stage, shot, np.repeat(number, 4), 7)
    for name, values in apart.items():
        sums = values.reshape(len(number), 4, *values.shape[1:]).sum(axis=1)
        np.testing.assert_allclose(together[name], sums, rtol=1e-4, atol=1e-4)


def test_blocks_are_further_samples_of_the_last_frame(mi, stage, tmp_path):
    options = replace(SMALL, blocks=(1, 2))
    render_sequence(stage, tmp_path, options)
    assert [path.name for path in sorted(tmp_path.glob("block_*"))] == [
        "block_0001_00.exr", "block_0001_01.exr",
    ]  # fmt: skip
    frames = [read_exr(tmp_path / name) for name in ("frame_0001.exr", "block_0001_00.exr")]
    assert (frames[0].color != frames[1].color).mean() > 0.3


@pytest.mark.parametrize("blocks", [(0,), (1, -2)])
def test_blocks_without_samples_are_refused(blocks):
    with pytest.raises(InputError, match="blocks must be of 1 sample or more"):
        replace(SMALL, blocks=blocks)


@pytest.mark.parametrize("clamp", [(0.0, 1.0), (3.0, 2.0)])
def test_a_clamp_that_bounds_nothing_is_refused(clamp):
    with pytest.raises(InputError, match="clamp must be two bounds above 0"):
        replace(SMALL, clamp=clamp)


def test_a_depth_that_is_asked_for_takes_the_place_of_the_effects_own(mi):
    plan = stage_of(mi, everything(), ("mirror_glass",), height=4, width=4, depth=3).plan
    assert plan.depth == [(3, "option")]
    assert plan.integrator.params["max_depth"] == 3


def test_buffers_on_demand_are_written_only_on_demand(mi, rendered, tmp_path):
    wants = replace(
        SMALL,
        frames=1,
        second_color=True,
        jitter=True,
        reference_scale=2,
        reference_features=4,
        guides=("roughness", "specular_albedo"),
    )
    stage = stage_of(
        mi,
        everything(),
        ("mirror_glass", "glossy"),
        height=24,
        width=32,
        second_color=True,
        jitter=True,
        reference_scale=2,
        guides=wants.guides,
    )
    render_sequence(stage, tmp_path / "more", wants)
    more = set(read_channels(tmp_path / "more" / "frame_0000.exr"))
    plain = set(read_channels(rendered / "frame_0000.exr"))
    extra = {"roughness.Y", *(f"{n}.{c}" for n in ("color_b", "specular_albedo") for c in "RGB")}
    assert more - plain == extra
    reference = read_channels(tmp_path / "more" / "ref_0000.exr")
    assert {plane.shape for plane in reference.values()} == {(48, 64)}
    assert {"albedo.R", "normal.X", "roughness.Y", "specular_albedo.R"} <= set(reference)
    # features of the reference are those of the frame, seen more closely
    frame = read_channels(tmp_path / "more" / "frame_0000.exr")
    pooled = reference["albedo.R"].reshape(24, 2, 32, 2).mean(axis=(1, 3))
    assert np.median(np.abs(pooled - frame["albedo.R"])) < 0.02
    jitter = read_exr(tmp_path / "more" / "frame_0000.exr").jitter
    np.testing.assert_allclose(jitter, jitters_of(wants)[0], atol=1e-6)
    record = json.loads((tmp_path / "more" / "sequence.json").read_text())
    np.testing.assert_allclose(record["cameras"][0]["jitter"], jitters_of(wants)[0])


def test_guides_tell_mirror_gloss_and_matte_apart(mi):
    seen = noisy(
        mi,
        everything(),
        ("mirror_glass", "glossy"),
        spp=1,
        height=24,
        width=32,
        guides=("roughness", "specular_albedo"),
    )
    values = {round(float(value), 4) for value in np.unique(seen["roughness"])}
    assert values <= {0.0, 0.2, 1.0}
    assert {0.0, 1.0} <= values
    specular = seen["specular_albedo"].mean(axis=-1)
    np.testing.assert_allclose(specular[seen["roughness"] == 0], 0.9, atol=1e-3)  # the mirror's
    assert (specular[seen["roughness"] == 1] == 0).all()
    varnish = specular[np.isclose(seen["roughness"], 0.2)]
    assert 0.02 < varnish.mean() < 0.5  # a dielectric coat: 4 % and more at grazing angles


def test_the_second_colour_is_independent_and_of_the_same_mean(mi, stage):
    # noise of two independent estimates: the variance of the difference is the sum of variances
    frames = [buffers.render_noisy(stage, moment(), spp=2, seed=k)["color"] for k in range(8)]
    seconds = [buffers.render_second(stage, moment(), spp=2, seed=500 + k) for k in range(8)]
    single, paired = np.var(frames, axis=0), np.var(np.subtract(frames, seconds), axis=0)
    noise = single > np.median(single)
    assert paired[noise].mean() == pytest.approx(2 * single[noise].mean(), rel=0.4)
    assert np.mean(frames) == pytest.approx(np.mean(seconds), rel=0.1)


def test_a_reference_of_twice_the_size_is_the_same_picture(mi):
    once = exact(mi, everything(), ("soft_shadow",), spp=512, height=8, width=10)
    twice = exact(
        mi, everything(), ("soft_shadow",), spp=256, height=8, width=10, reference_scale=2
    )
    pooled = twice.reshape(8, 2, 10, 2, 3).mean(axis=(1, 3))
    # what is left is the noise of hundreds of samples
    np.testing.assert_allclose(pooled, once, atol=0.35 * once.max())
    assert np.abs(pooled - once).mean() < 0.1 * once.mean()


def test_jitter_begins_anywhere_but_in_a_recorded_film():
    film = jitters_of(SequenceOptions(frames=3, jitter=True, cameras="film.json", seed=5))
    np.testing.assert_allclose(film, [(0, 1 / 3 - 0.5), (-0.25, 2 / 3 - 0.5), (0.25, 1 / 9 - 0.5)])
    first, again, other = (
        np.array(jitters_of(SequenceOptions(frames=8, jitter=True, seed=seed)))
        for seed in (1, 1, 2)
    )
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1
    for found in (first, other):
        assert found.min() >= -0.5
        assert found.max() < 0.5
        assert len(np.unique(found[:, 0])) == 8
    assert not np.any(jitters_of(SequenceOptions(frames=2, seed=1)))


def test_jitter_shifts_what_the_pixels_see(mi, stage):
    # a shift of one whole pixel to the right shows each pixel its right neighbour's content
    still = buffers.render_noisy(stage, moment(), spp=4, seed=1)
    moved = buffers.render_noisy(stage, moment(jitter=(1.0, 0.0)), spp=4, seed=1)
    same = np.abs(moved["depth"][:, :-1] - still["depth"][:, 1:])
    assert np.median(same) < 0.05 * np.median(still["depth"])
    unshifted = np.abs(moved["depth"][:, :-1] - still["depth"][:, :-1])
    assert same.mean() < unshifted.mean()


def test_samples_that_do_not_spread_lie_at_one_place_of_their_pixels(mi, stage):
    # whatever the random numbers are, features of one sample a pixel are then the same
    first, second = (
        buffers.render_noisy(stage, replace(moment(), spread=0.0), spp=1, seed=seed)
        for seed in (1, 2)
    )
    np.testing.assert_allclose(first["depth"], second["depth"], rtol=1e-5)
    spread = buffers.render_noisy(stage, moment(), spp=1, seed=2)
    assert (spread["depth"] != first["depth"]).any()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"spread": 1.5}, "spread must be 0 to 1, got 1.5"),
        ({"reference_features": -1}, "reference_features must be 0 or more, got -1"),
        ({"spp": 0}, "spp must be 1 or more, got 0"),
        ({"frames": 2, "references": 3}, r"references must be 0 to frames \(2\), got 3"),
        ({"frames": 2, "first": 2}, r"first must be 0 to frames - 1 \(1\), got 2"),
        ({"depth": 0}, "depth must be 1 or more, got 0"),
        ({"cameras": "a.json", "move": "still"}, "cameras must be given without origin and move"),
        ({"reference_scale": 3}, "reference_scale must be 1 or 2, got 3"),
        ({"guides": ("curvature",)}, "guides must be of roughness, specular_albedo, got curvature"),
        ({"move": "jump"}, "move must be of still, dolly, orbit, handheld, got jump"),
        ({"speed": float("nan")}, "speed must be 0 or more, got nan"),
        ({"origin": (0.0, 0.0, 0.0)}, "origin and target must be given together"),
        ({"fov": 180.0}, "fov must be 1 to 170 degrees, got 180"),
    ],
)
def test_options_beyond_their_rules_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        SequenceOptions(**changes)


def test_a_camera_inside_a_body_is_refused_and_one_outside_is_not(stage, tmp_path):
    block = replace(SMALL, origin=(0.9, 0.5, 0.0), target=(0.0, 0.5, 5.0), frames=1, move="still")
    with pytest.raises(InputError, match=r"origin must be in the open, got 0.9, 0.5, 0"):
        render_sequence(stage, tmp_path / "in", block)
    assert not (tmp_path / "in").exists()
    render_sequence(
        stage, tmp_path / "out", replace(block, origin=(0.0, 1.0, 4.0), target=(0.0, 0.5, 0.0))
    )
    assert is_complete(tmp_path / "out")


def test_views_of_a_scene_differ_and_a_finished_job_renders_nothing(mi, tmp_path):
    options = replace(SMALL, frames=1, height=8, width=9, reference_spp=1)
    job = Job(scene="tabletop", seed=2, views=2, effects=(), options=options)
    assert run_job(mi, job, tmp_path) == ["tabletop-0002-0", "tabletop-0002-1"]
    cameras = [
        json.loads((tmp_path / f"tabletop-0002-{v}" / "sequence.json").read_text())["cameras"]
        for v in (0, 1)
    ]
    assert cameras[0] != cameras[1]
    assert run_job(mi, job, tmp_path) == []


def test_old_llvm_is_never_chosen(monkeypatch):
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/usr/lib/libLLVM-15.so.1")
    assert variant.find_llvm() is None
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/usr/lib/libLLVM.so.19.1")
    assert variant.find_llvm() == "/usr/lib/libLLVM.so.19.1"


def test_a_library_that_appears_while_a_process_runs_is_not_taken(mi, monkeypatch):
    before = load_mitsuba()[1]
    monkeypatch.setattr(variant, "find_llvm", lambda: "/usr/lib/libLLVM.so.99.1")
    assert load_mitsuba()[1] == before


@pytest.mark.parametrize(
    ("cuda", "library", "chosen"),
    [
        (True, None, "cuda_ad_rgb"),
        (True, "x", "cuda_ad_rgb"),
        (False, "x", "llvm_ad_rgb"),
        (False, None, "scalar_rgb"),
    ],
)
def test_the_variant_follows_what_the_machine_has(mi, monkeypatch, cuda, library, chosen):
    import drjit

    monkeypatch.setattr(drjit, "has_backend", lambda backend: cuda)
    name, why = variant.choose(library)
    assert name == chosen
    assert why
