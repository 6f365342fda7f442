"""What Blender's Cycles rendered for training becomes sequences like the simulator's."""

from __future__ import annotations

import json
import os
import subprocess
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="training is of the extra train")
pytest.importorskip("pyoidn", reason="targets are of the extra compare")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.io.exr.read import read_exr  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.pixel_filter import filter_spread  # noqa: E402
from stillray_training.blender.record import RECORD, TAKEN  # noqa: E402
from stillray_training.cycles_sequences import main, take  # noqa: E402
from stillray_training.examples import QUIET, STILL, find_sequences, load_examples  # noqa: E402
from stillray_training.film import film_variance  # noqa: E402
from stillray_training.provenance import assets_of  # noqa: E402
from stillray_training.targets import read_filter  # noqa: E402
from tests.conftest import clean_color, make_frame  # noqa: E402
from tests.training.test_own_renders import write_render  # noqa: E402

SIZE = 64
FILES = ["frame_0000", "frame_0001", "block_00", "block_01", "ref_0001"]


@pytest.fixture
def rendered(tmp_path):
    """A scene of two frames and two blocks, as Blender's side leaves it."""
    folder = tmp_path / "raw" / "00007"
    folder.mkdir(parents=True)
    for index, name in enumerate(FILES):
        frame = make_frame(SIZE, SIZE, index)
        if name.startswith("ref"):
            frame = replace(frame, color=clean_color(SIZE, SIZE))
        write_render(folder / f"{name}.exr", frame)
    record = {
        "scene": "cycles_room", "seed": 7, "frames": 2, "spp": 2, "blocks": [1, 4],
        "reference_spp": 64, "height": SIZE, "width": SIZE, "used": ["cup"], "clamp": 10.0,
        "filter": "BLACKMAN_HARRIS", "filter_width": 2.0, "blender": "5.0.1",
    }  # fmt: skip
    (folder / RECORD).write_text(json.dumps(record))
    asset = {
        "name": "cup", "title": "Cup", "author": "Somebody", "licence": "CC0 1.0",
        "source": "https://example.org",
    }  # fmt: skip
    (tmp_path / "assets" / "cup").mkdir(parents=True)
    (tmp_path / "assets" / "cup" / "asset.json").write_text(json.dumps(asset))
    return folder


def test_a_scene_becomes_a_sequence_that_training_reads(rendered, tmp_path):
    out = tmp_path / "data" / "cycles_room-00007-0"
    bias = take(rendered, out, tmp_path / "assets")
    assert abs(bias) < 0.1
    assert find_sequences(tmp_path / "data") == [out]
    assert assets_of([out]) == {"cup": '"Cup" by Somebody (https://example.org), CC0 1.0'}
    frame, noisy = read_exr(out / "frame_0001.exr"), make_frame(SIZE, SIZE, 1)
    np.testing.assert_allclose(frame.color, noisy.color, rtol=1e-3, atol=1e-4)
    np.testing.assert_allclose(frame.depth, noisy.depth, rtol=1e-5)
    assert frame.motion is not None
    spec = load("kpyr-5")
    unpainted = replace(spec.training, sheen_share=0.0, small_share=0.0, defocus_share=0.0)
    examples = load_examples(out, replace(spec, training=unpainted), Strips(1))
    # some come through a wider filter, whose variance adds to that of the render's
    rendered_with = filter_spread("blackman-harris", 2.0)
    assert min(e.filter_spread for e in examples) == pytest.approx(rendered_with)
    wider = [e.filter_spread for e in examples if e.filter_spread > rendered_with * 1.001]
    added = [film_variance(deviation) for deviation in (0.3, 0.6)]
    assert all(added[0] < w**2 - rendered_with**2 < added[1] for w in wider)
    alone = {e.spp for e in examples if e.kind == STILL and e.frames == 1}
    assert alone <= {1, 2, 3, 4, 5, 6, 7}
    assert min(e.spp for e in examples if e.kind == QUIET) > 7
    # what is learned from is the filtered reference, not that
    reference, target = (read_exr(out / f"{name}_0001.exr").color for name in ("ref", "target"))
    assert np.abs(reference - target).max() > 0
    np.testing.assert_array_equal(examples[0].reference, target)
    assert take(rendered, out, tmp_path / "assets") is None


@pytest.mark.parametrize(
    ("told", "spread"),
    [
        ({"filter": "BOX"}, filter_spread("box")),
        ({"filter": "GAUSSIAN", "filter_width": 2.0}, 0.5),
        ({"filter": "BLACKMAN_HARRIS"}, None),
        ({}, None),
    ],
)
def test_what_a_record_says_of_the_filter_is_kept_and_nothing_is_guessed(
    told, spread, rendered, tmp_path
):
    record = json.loads((rendered / RECORD).read_text())
    record = {k: v for k, v in record.items() if not k.startswith("filter")} | told
    (rendered / RECORD).write_text(json.dumps(record))
    out = tmp_path / "data" / "cycles_room-00007-0"
    take(rendered, out, tmp_path / "assets")
    assert read_filter(out) == spread
    examples = load_examples(out, load("kpyr-5"), Strips(1))
    assert all((e.filter_spread is None) == (spread is None) for e in examples)


def test_a_scene_without_light_is_left_out(rendered, tmp_path):
    """Its target would be black, and the noise of its frames nothing to learn from."""
    dark = make_frame(SIZE, SIZE, 1)
    write_render(rendered / "ref_0001.exr", replace(dark, color=np.zeros_like(dark.color)))
    main(rendered.parent, tmp_path / "data", assets=tmp_path / "assets", remove=True)
    assert not (tmp_path / "data").exists()
    assert [path.name for path in rendered.iterdir()] == [TAKEN]


def test_a_scene_whose_target_is_brighter_than_its_reference_is_left_out(
    rendered, tmp_path, monkeypatch, capsys
):
    """One in six hundred was brighter by 17 %: a network would learn to add light."""
    monkeypatch.setattr("stillray_training.cycles_sequences.make_targets", lambda _: 0.17)
    main(rendered.parent, tmp_path / "data", assets=tmp_path / "assets", remove=True)
    assert find_sequences(tmp_path / "data") == []
    assert "1 left out" in capsys.readouterr().out
    assert [path.name for path in rendered.iterdir()] == [TAKEN]


def test_renders_are_deleted_once_taken_and_not_rendered_anew(rendered, tmp_path):
    main(rendered.parent, tmp_path / "data", assets=tmp_path / "assets", remove=True)
    assert [path.name for path in rendered.iterdir()] == [TAKEN]
    assert len(find_sequences(tmp_path / "data")) == 1
    main(rendered.parent, tmp_path / "data", assets=tmp_path / "assets")


def test_an_asset_without_a_credit_is_refused(rendered, tmp_path):
    with pytest.raises(InputError, match="assets must hold cup"):
        take(rendered, tmp_path / "data" / "one", None)
    assert not find_sequences(tmp_path)


in_blender = pytest.mark.skipif(
    not os.environ.get("STILLRAY_BLENDER_PYTHON"),
    reason="STILLRAY_BLENDER_PYTHON names no Python with bpy",
)


def render(folder, *options):
    """The command that renders scenes, in Blender's Python."""
    python = os.environ["STILLRAY_BLENDER_PYTHON"]
    command = [python, "-m", "stillray_training.blender.sequences", str(folder), *options]
    environment = {**os.environ, "PYTHONPATH": "training"}
    return subprocess.run(command, env=environment, capture_output=True, text=True, check=False)


@in_blender
@pytest.mark.parametrize("seed", [0, 1])
def test_blender_renders_a_scene_of_a_seed(tmp_path, seed):
    options = f"--count 1 --first-seed {seed} --size 24 --reference 16".split()
    assert render(tmp_path, *options).returncode == 0
    folder = tmp_path / f"{seed:05d}"
    take(folder, tmp_path / "data" / "one")
    frame = read_exr(tmp_path / "data" / "one" / "frame_0007.exr")
    reference = read_exr(tmp_path / "data" / "one" / "ref_0007.exr")
    assert np.isfinite(reference.color).all()
    assert reference.color.max() > 0
    assert frame.depth.max() > 0
    # other seeds of noise, the same light
    assert np.abs(frame.color - reference.color).max() > 0


@in_blender
def test_painted_joinery_is_told_by_normals_alone(tmp_path):
    shares = ["--rooms", "1", "--panelled", "1"]
    scene = ["--count", "1", "--first-seed", "15", "--size", "48", "--reference", "1"]
    assert render(tmp_path, *scene, *shares).returncode == 0
    frame = read_exr(tmp_path / "00015" / "frame_0007.exr")
    albedo, normal = np.round(frame.albedo, 1), np.round(frame.normal, 1)
    paint = np.median(albedo.reshape(-1, 3), axis=0)
    painted = (albedo == paint).all(-1)
    ways, counts = np.unique(normal[painted], axis=0, return_counts=True)
    # walls, and faces of mouldings that look elsewhere
    assert len(ways) > 8
    assert counts.max() < 0.9 * painted.sum()


@in_blender
def test_shares_are_shares(tmp_path):
    for option in ("--rooms", "--panelled", "--backlit", "--box"):
        done = render(tmp_path, option, "1.5")
        assert done.returncode == 2
        assert f"{option[2:]} must be 0 to 1, got 1.5" in done.stderr
    assert "assets must be a folder" in render(tmp_path, "--assets", str(tmp_path / "no")).stderr
    assert not list(tmp_path.iterdir())
