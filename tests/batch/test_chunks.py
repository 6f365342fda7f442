"""A shot in chunks over Dask: the same pictures, whatever happens to the workers."""

import json
import os
import signal
import threading
from dataclasses import replace

import numpy as np
import pytest

from stillray.batch.chunks import ShotSettings, denoise_chunk, split
from stillray.batch.file_layout import Layout
from stillray.batch.resume import Recipe, file_digest
from stillray.batch.shot import Selection, ShotFrame, plan_shot
from stillray.cli import main
from stillray.errors import InputError
from stillray.io.exr.read import read_exr, read_metadata
from stillray.models.registry import find_model
from tests.batch.dask_processes import dask_processes, wait_for
from tests.batch.test_resume import write_frame

FRAMES = 16
FAST = ("denoise", "shot.##.exr", "-m", "wskp-3s")


@pytest.fixture
def shot(tmp_path, monkeypatch):
    """A sequence without gaps, in the current folder."""
    monkeypatch.chdir(tmp_path)
    for number in range(1, FRAMES + 1):
        write_frame(tmp_path / f"shot.{number:02d}.exr", number)
    return tmp_path


def pictures(folder, pattern="clean.##.exr"):
    return {
        number: read_exr(path).color
        for number in range(1, FRAMES + 1)
        if (path := folder / pattern.replace("##", f"{number:02d}")).is_file()
    }


def listed(numbers, tmp_path, *, unwritten=()):
    return [
        ShotFrame(
            number=n,
            source=tmp_path / f"{n}",
            companions={},
            output=None if n in unwritten else tmp_path / f"o{n}",
        )
        for n in numbers
    ]


def test_split_gives_each_chunk_the_frames_before_it_that_it_remembers(tmp_path):
    # frames 1 and 2 are a lead-in that a user asked for, 9 is missing
    numbers = [*range(1, 9), *range(10, 15)]
    chunks = split(listed(numbers, tmp_path, unwritten=(1, 2)), 4, memory=2)
    found = {
        name: [job.number if job.output else -job.number for job in jobs]
        for name, jobs in chunks.items()
    }
    assert found == {
        "3-6": [-1, -2, 3, 4, 5, 6],
        # nothing is remembered across the gap
        "7-8,10-11": [-5, -6, 7, 8, 10, 11],
        "12-14": [-10, -11, 12, 13, 14],
    }


def test_split_makes_paths_that_hold_in_other_folders(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_frame(tmp_path / "s.1.exr", 1)
    write_frame(tmp_path / "a.1.exr", 1)
    (jobs,) = split(plan_shot(["s.#.exr"], "c.#.exr", {"albedo": "a.#.exr"}), 9, memory=0).values()
    assert jobs[0].source == tmp_path / "s.1.exr"
    assert jobs[0].companions == {"albedo": tmp_path / "a.1.exr"}
    assert jobs[0].output == tmp_path / "c.1.exr"
    with pytest.raises(InputError, match="chunk must be 1 frame or more, got 0"):
        split(jobs, 0, memory=0)


def work_of(**changes):
    digest = file_digest(find_model("wskp-3s").path)
    recipe = Recipe(**{"model": "wskp-3s", "model_digest": digest} | changes)
    return ShotSettings(model="wskp-3s", recipe=recipe, layout=Layout(), memory=3)


def test_chunk_keeps_what_is_finished_and_tells_what_it_did_before_it_failed(shot):
    jobs = split(plan_shot(["shot.##.exr"], "clean.##.exr"), 6, memory=3)["7-12"]
    first = denoise_chunk(jobs, 1, work=work_of())
    assert [done.step.job.number for done in first.done] == list(range(4, 13))
    assert (first.already, first.error) == (0, None)
    stamp = (shot / "clean.08.exr").stat().st_mtime_ns
    (shot / "clean.09.exr").unlink()
    (shot / "clean.12.exr").unlink()
    source = (shot / "shot.12.exr").read_bytes()
    (shot / "shot.12.exr").write_bytes(source[:-200])
    again = denoise_chunk(jobs, 1, work=work_of())
    assert again.already == 4
    assert "shot.12.exr" in again.error
    written = [done.step.job.number for done in again.done if done.step.writes]
    assert written == [9]
    assert (shot / "clean.08.exr").stat().st_mtime_ns == stamp


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"model_digest": "of another file"}, "workers must have the same file of the model"),
        ({"version": "0.0.1"}, "workers must have stillray 0.0.1"),
    ],
)
def test_worker_that_would_make_other_pictures_refuses(shot, change, words):
    jobs = split(plan_shot(["shot.##.exr"], "clean.##.exr"), 6, memory=3)["7-12"]
    with pytest.raises(InputError, match=words):
        denoise_chunk(jobs, 1, work=work_of(**change))
    assert not list(shot.glob("clean.*"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--chunk", "4"), "chunk must be given with --scheduler or --workers"),
        (("--workers", "0"), "workers must be 1 or more, got 0"),
        (("--workers", "2", "--scheduler", "tcp://a:1"), "must not be given with a scheduler"),
        (("--workers", "2", "--chunk", "0"), "chunk must be 1 frame or more, got 0"),
    ],
)
def test_options_that_do_not_go_together(shot, capsys, options, words):
    assert main([*FAST, "-o", "clean.##.exr", *options]) == 2
    assert words in capsys.readouterr().err


def test_without_dask_the_extra_is_named(shot, capsys, monkeypatch):
    monkeypatch.setattr("stillray.batch.farm.find_spec", lambda name: None)
    assert main([*FAST, "-o", "clean.##.exr", "--workers", "2"]) == 2
    assert "pip install 'stillray[farm]'" in capsys.readouterr().err


def test_scheduler_that_does_not_answer_is_named(shot, capsys, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("stillray.batch.farm.ANSWER_SECONDS", 0.5)
    assert main([*FAST, "-o", "clean.##.exr", "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert "scheduler must answer, got tcp://127.0.0.1:9" in capsys.readouterr().err


def test_a_killed_worker_loses_nothing(shot, capsys):
    """Two workers, one killed half way; then a broken frame; then nothing left to do."""
    pytest.importorskip("distributed")
    # the memory reaches back to the first frame, so that chunks have the very same history
    command = [*FAST, "--chunk", "4", "--warm-up", "32", "--json"]
    assert main([*FAST, "-o", "alone.##.exr", "--warm-up", "32", "-q"]) == 0
    alone = pictures(shot, "alone.##.exr")
    source = (shot / "shot.11.exr").read_bytes()
    with dask_processes(shot, workers=2) as (address, workers):
        stamps = {}

        def kill():
            wait_for(lambda: len(list(shot.glob("clean.*"))) >= 5)
            workers[0].send_signal(signal.SIGSTOP)  # whatever it is doing, it will not finish it
            stamps.update({p: p.stat().st_mtime_ns for p in shot.glob("clean.*")})
            workers[0].send_signal(signal.SIGKILL)

        killer = threading.Thread(target=kill)
        killer.start()
        capsys.readouterr()
        assert main([*command, "-o", "clean.##.exr", "--scheduler", address]) == 0
        killer.join()
        *frames, summary = map(json.loads, capsys.readouterr().out.splitlines())
        assert workers[0].wait(timeout=300) == -signal.SIGKILL
        # what was finished when it died is the same file still
        assert stamps
        assert {path: path.stat().st_mtime_ns for path in stamps} == stamps
        told = {f["number"] for f in frames if f["event"] == "frame" and f["output"]}
        assert len(told) + summary["frames_done_already"] == FRAMES
        found = pictures(shot)
        assert found.keys() == alone.keys()
        for number, picture in alone.items():
            np.testing.assert_array_equal(found[number], picture, err_msg=str(number))
        assert not list(shot.glob(".*.part"))
        # one machine knows them for its own, and so does the scheduler
        assert main([*command[:4], "--warm-up", "32", "--resume", "-o", "clean.##.exr"]) == 0
        assert f"{FRAMES} frames done already" in capsys.readouterr().out

        for number in (10, 11, 12, 15):
            os.unlink(shot / f"clean.{number:02d}.exr")
        (shot / "shot.11.exr").write_bytes(source[:-100])
        assert main([*command, "-o", "clean.##.exr", "--scheduler", address]) == 2
        said = capsys.readouterr().err
        assert said.startswith("error: frames ")
        assert "shot.11.exr" in said
        (shot / "shot.11.exr").write_bytes(source)
        assert main([*command, "-o", "clean.##.exr", "--scheduler", address]) == 0
    found = pictures(shot)
    for number, picture in alone.items():
        np.testing.assert_array_equal(found[number], picture, err_msg=str(number))
    assert "stillray:digest" in {a.name for a in read_metadata(shot / "clean.11.exr").extra_attribs}


def test_local_workers_make_the_same_pictures(shot, capsys):
    pytest.importorskip("distributed")
    command = [*FAST, "--frames", "1-6", "--warm-up", "9", "-q"]
    assert main([*command, "-o", "alone.##.exr"]) == 0
    assert main([*command, "-o", "clean.##.exr", "--workers", "2", "--chunk", "4"]) == 0
    alone, found = pictures(shot, "alone.##.exr"), pictures(shot)
    assert found.keys() == alone.keys() == set(range(1, 7))
    for number, picture in alone.items():
        np.testing.assert_array_equal(found[number], picture)


def test_chunk_is_the_nearer_to_one_machine_the_more_frames_it_runs_before(shot):
    def apart(memory):
        chunk = list(split(jobs, 13, memory=memory).values())[1]
        assert denoise_chunk(chunk, 1, work=replace(work_of(), memory=memory)).error is None
        found = pictures(shot)[14]
        return np.abs(found - alone[14]).mean() / alone[14].mean()

    jobs = plan_shot(["shot.##.exr"], "clean.##.exr", selection=Selection(frames="1-14"))
    whole = next(iter(split(jobs, FRAMES, memory=FRAMES).values()))
    denoise_chunk(whole, 1, work=replace(work_of(), memory=FRAMES))
    alone = pictures(shot)
    cold, warm = apart(0), apart(8)
    assert 0 < warm < 0.3 * cold
    assert apart(13) == 0
