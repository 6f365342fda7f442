from __future__ import annotations

import subprocess
import sys
from collections import Counter
from importlib.resources import files
from pathlib import Path

import pytest

pytest.importorskip("mitsuba")

import numpy as np

from stillray.batch import farm
from stillray.cli import program
from stillray.errors import InputError
from stillray.io.exr.read import read_channels
from stillray_training.simulate import __main__ as command
from stillray_training.simulate.recipe import read_recipe
from stillray_training.simulate.report import contact_sheet, write_report
from stillray_training.simulate.sequence import open_world

TINY = (
    "--frames",
    "1",
    "--height",
    "8",
    "--width",
    "9",
    "--reference-spp",
    "1",
    "--variant",
    "scalar_rgb",
    "--workers",
    "1",
)
XML = """<scene version="3.0.0">
  <sensor type="perspective"><float name="fov" value="50"/>
    <transform name="to_world"><lookat origin="0,1,5" target="0,0.5,0" up="0,1,0"/></transform>
    <film type="hdrfilm"/></sensor>
  <emitter type="constant"><rgb name="radiance" value="1"/></emitter>
  <shape type="sphere"><point name="center" x="0" y="0.5" z="0"/><float name="radius" value="1"/>
    <bsdf type="dielectric"/></shape>
  <shape type="rectangle"><transform name="to_world"><scale value="6"/>
    <rotate x="1" angle="-90"/></transform><bsdf type="diffuse"/></shape>
  {more}
</scene>"""


def simulate(*args: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "stillray_training.simulate", *map(str, args)],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def ended(monkeypatch, capsys):
    """The command in this process, which has Mitsuba already: exit code and both outputs."""

    def run(*args: object) -> tuple[object, str, str]:
        monkeypatch.setattr(sys, "argv", ["stillray-simulate", *map(str, args)])
        with pytest.raises(SystemExit) as end:
            program.run(command.simulate)
        return end.value.code, *capsys.readouterr()

    return run


@pytest.fixture
def xml(tmp_path):
    path = tmp_path / "glassball" / "scene.xml"
    path.parent.mkdir()
    path.write_text(XML.format(more=""))
    return path


def test_an_xml_file_renders_with_effects_on_top_of_its_own(tmp_path, xml):
    done = simulate(
        tmp_path / "out", "--scene", xml, *TINY, "--effects", "depth_of_field,medium", "--report"
    )
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "out" / "glassball-0000-0"
    assert (folder / "sequence.json").is_file()
    channels = read_channels(folder / "ref_0000.exr")
    assert np.isfinite(channels["R"]).all()
    assert channels["R"].max() > 0
    assert (tmp_path / "out" / "report.html").is_file()
    assert (tmp_path / "out" / "contact.png").is_file()


def test_explain_says_what_runs_and_renders_nothing(tmp_path, xml, ended):
    code, out, error = ended(
        "--scene", xml, "--effects", "depth_of_field", "--explain", "--variant", "scalar_rgb"
    )
    assert code == 0, error
    lines = {" ".join(line.split()) for line in out.splitlines()}
    assert "thinlens 1 depth_of_field" in lines
    assert "lens position 2 a sample depth_of_field" in lines
    assert "dielectric 1 the file" in lines
    assert "integrator path, depth 8 (base) + 4 (mirror_glass)" in lines
    assert not any("volpath" in line or "perspective" in line for line in lines)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("args", "message"),
    [
        (
            ("--scene", "nowhere.xml"),
            "scene must be of room, corridor, court, tabletop, interior, desk, shadows, terrace",
        ),
        (("--scene", "room", "--effects", "caustics"), "effects must be of soft_shadow"),
        (("--scene", "room", "--spp", "0"), "spp must be 1 or more, got 0"),
        (
            ("--scene", "room", "--origin", "0", "-3", "0", "--target", "0", "1", "0"),
            "origin must be in the open, got 0, -3, 0",
        ),
        (
            ("--scene", "room", "--recipe", "x.toml"),
            "one of scene and recipe must be given, got both",
        ),
        (("--recipe", "nowhere.toml"), "recipe must be a readable TOML file, got nowhere.toml"),
        (
            ("--scene", "room", "--scheduler", "tcp://127.0.0.1:1"),
            "scheduler must answer, got tcp://127.0.0.1:1",
        ),
    ],
)
def test_bad_input_is_one_line_and_exit_code_2(tmp_path, monkeypatch, ended, args, message):
    if "--scheduler" in args:
        pytest.importorskip("distributed")
        monkeypatch.setattr(farm, "ANSWER_SECONDS", 0.5)
    code, _, error = ended(tmp_path / "out", *args, "--variant", "scalar_rgb")
    assert code == 2
    assert message in error
    assert not list((tmp_path / "out").glob("*/*")) if (tmp_path / "out").exists() else True


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            '<shape type="ply"><string name="filename" value="lost.ply"/></shape>',
            "names a file that is missing: lost.ply",
        ),
        ('<shape type="cone"/>', "Mitsuba cannot"),
        ("<shape", "Mitsuba cannot"),
    ],
)
def test_an_xml_file_that_cannot_be_loaded_is_one_line_and_exit_code_2(
    tmp_path, xml, ended, more, message
):
    xml.write_text(XML.format(more=more))
    code, _, error = ended(tmp_path / "out", "--scene", xml, *TINY)
    assert code == 2, error
    assert message in error


def test_a_process_ends_with_one_line_too(tmp_path, xml):
    xml.write_text(XML.format(more='<shape type="cone"/>'))
    done = simulate(tmp_path / "out", "--scene", xml, *TINY)
    assert done.returncode == 2, done.stderr
    assert "Mitsuba cannot" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_recipe_goes_seed_by_seed_through_its_scenes(tmp_path):
    path = tmp_path / "r.toml"
    path.write_text(
        '[options]\nframes = 2\n[[sequences]]\nscene = "room"\ncount = 2\nfirst_seed = 5\n'
        '[[sequences]]\nscene = "court"\nviews = 3\nalso = ["sun"]\noptions = { spp = 4 }\n'
    )
    jobs = read_recipe(path)
    assert [(job.scene, job.seed, job.views) for job in jobs] == [
        ("room", 5, 1),
        ("court", 0, 3),
        ("room", 6, 1),
    ]
    assert [job.options.spp for job in jobs] == [1, 4, 1]
    assert all(job.options.frames == 2 for job in jobs)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1", "keys must be of options, sequences, got x"),
        ("[options]\nframes = 2", r"must hold \[\[sequences\]\]"),
        ("[[sequences]]\ncount = 2", "must name a scene"),
        (
            '[[sequences]]\nscene = "room"\ncount = 0',
            "count must be a whole number of 1 or more, got 0",
        ),
        ('[[sequences]]\nscene = "room"\nalso = ["rain"]', "effects must be of .* got rain"),
        ('[[sequences]]\nscene = "room"\noptions = { seed = 1 }', "keys must be of .* got seed"),
        (
            '[[sequences]]\nscene = "room"\n[[sequences]]\nscene = "room"',
            "first_seed must keep entries apart, twice: room-0000-0",
        ),
        ("[[", "recipe must be TOML"),
    ],
)
def test_a_recipe_with_a_mistake_names_it(tmp_path, text, message):
    path = tmp_path / "r.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_recipe(path)


def test_the_training_recipe_asks_for_two_hundred_sequences_of_every_kind():
    path = files("stillray_training") / "simulate" / "recipes" / "train.toml"
    jobs = read_recipe(path)
    counts = Counter({"total": sum(job.views for job in jobs)})
    for job in jobs:
        counts[job.scene] += job.views
    assert counts["total"] == 200
    assert set(counts) == {"total", "room", "corridor", "court", "tabletop"}
    asked = {name for job in jobs for name in job.also}
    assert asked >= {"medium", "motion_blur", "moving_object", "moving_light", "depth_of_field"}


def test_a_contact_sheet_holds_every_tile_once():
    tiles = [np.full((4, 4, 3), i, np.uint8) for i in range(1, 12)]
    sheet = contact_sheet(tiles)
    assert sheet.shape == (8, 32, 3)
    assert Counter(sheet[::4, ::4, 0].ravel().tolist()) == {**{i: 1 for i in range(1, 12)}, 0: 5}


def test_a_report_on_a_folder_without_sequences_is_refused(tmp_path):
    with pytest.raises(InputError, match="folder must hold finished sequences"):
        write_report(tmp_path)


def test_a_bundled_recipe_is_found_by_its_name_unless_a_file_has_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    bundled = read_recipe(Path("sun.toml"))
    assert {"shadows", "terrace"} <= {job.scene for job in bundled}
    Path("sun.toml").write_text('[[sequences]]\nscene = "court"\ncount = 1\nfirst_seed = 3\n')
    assert [job.scene for job in read_recipe(Path("sun.toml"))] == ["court"]
    with pytest.raises(InputError, match=r"recipe must be a readable TOML file, got other\.toml"):
        read_recipe(Path("other.toml"))


def test_nothing_moves_where_long_pasts_are_learned():
    """One reference is that of all frames there."""
    jobs = read_recipe(Path("upscale_held.toml"))
    assert {job.options.move for job in jobs} == {"still"}
    plan = next(job for job in jobs if (job.scene, job.seed) == ("room", 728003)).plan(None)
    assert {"moving_light", "moving_object", "motion_blur"} < set(plan.world.effects)
    assert not plan.motions
    assert plan.shutter == 0


def test_effects_left_out_are_those_of_the_scene_or_added(tmp_path):
    path = tmp_path / "r.toml"
    entry = '[[sequences]]\nscene = "court"\nfirst_seed = {}\nalso = ["sun", "medium"]\n'
    path.write_text(entry.format(0) + entry.format(1) + 'without = ["sun", "texture"]\n')
    every, without = (set(job.asks(open_world(None, job.scene, 0))) for job in read_recipe(path))
    assert {"sun", "texture"} < every
    assert without == every - {"sun", "texture"}
