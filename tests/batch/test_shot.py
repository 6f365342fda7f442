"""Which frames of a shot are run, which are written, and where history begins anew."""

import numpy as np
import pytest

from stillray.batch.shot import Selection, ShotFrame, plan_shot, steps_to_run, window
from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels


def jobs(numbers, folder, *, unwritten=()):
    return [
        ShotFrame(
            number=n,
            source=folder / f"{n}",
            companions={},
            output=None if n in unwritten else folder / f"o{n}",
        )
        for n in numbers
    ]


def numbers(steps):
    return [step.job.number for step in steps]


def test_steps_warm_up_before_each_missing_frame_and_no_further(tmp_path):
    done = [True] * 90
    done[2] = done[80] = False
    steps = steps_to_run(jobs(range(90), tmp_path), done, memory=32)
    assert numbers(steps) == [0, 1, 2, *range(48, 81)]
    assert numbers(step for step in steps if step.writes) == [2, 80]
    assert numbers(step for step in steps if step.starts_anew) == [0, 48]


def test_steps_without_history_need_no_warm_up(tmp_path):
    done = [True, True, False, True]
    assert numbers(steps_to_run(jobs(range(4), tmp_path), done, memory=0)) == [2]


def test_steps_never_warm_up_across_a_missing_number(tmp_path):
    steps = steps_to_run(jobs([1, 5, 6], tmp_path), [True, True, False], memory=8)
    assert numbers(steps) == [5, 6]
    assert [step.starts_anew for step in steps] == [True, False]


def test_steps_with_all_frames_missing_run_once_and_begin_anew_at_gaps(tmp_path):
    steps = steps_to_run(jobs([1, 2, 5, 6], tmp_path), [False] * 4, memory=8)
    assert numbers(steps) == [1, 2, 5, 6]
    assert [step.starts_anew for step in steps] == [True, False, True, False]


def test_steps_run_the_lead_in_only_where_a_frame_needs_it(tmp_path):
    planned = jobs(range(3, 9), tmp_path, unwritten=(3, 4))
    assert numbers(steps_to_run(planned, [False] * 6, memory=2)) == [3, 4, 5, 6, 7, 8]
    done = [False, False, True, True, True, False]
    steps = steps_to_run(planned, done, memory=2)
    assert numbers(steps) == [6, 7, 8]
    assert numbers(step for step in steps if step.writes) == [8]


def test_window_ends_at_a_gap_and_at_the_memory(tmp_path):
    planned = jobs([1, 2, 5, 6, 7, 8], tmp_path)
    assert window(planned, 5, 2) == range(3, 6)
    assert window(planned, 5, 9) == range(2, 6)
    assert window(planned, 2, 9) == range(2, 3)


@pytest.fixture
def shot(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3, 4, 5, 8, 9):
        channels = {name: np.zeros((2, 3), np.float32) for name in "RGB"}
        write_channels(tmp_path / f"s.{number:02d}.exr", channels)
    return tmp_path


def planned_numbers(**options):
    planned = plan_shot(["s.##.exr"], "c.##.exr", selection=Selection(**options))
    return [(job.number, job.output is not None) for job in planned]


def test_plan_part_of_a_shot_with_frames_before_it(shot):
    assert planned_numbers(frames="4-5") == [(4, True), (5, True)]
    assert planned_numbers(frames="4-5", warm_up=2) == [
        (2, False), (3, False), (4, True), (5, True),
    ]  # fmt: skip
    # there is nothing before frame 1, and a gap before frame 8
    assert planned_numbers(frames="2,9", warm_up=8) == [
        (1, False), (2, True), (8, False), (9, True),
    ]  # fmt: skip
    assert planned_numbers(frames="1-5x2", warm_up=1) == [
        (1, True), (2, False), (3, True), (4, False), (5, True),
    ]  # fmt: skip


def test_plan_several_inputs_are_one_sequence_by_number(shot):
    planned = plan_shot(["s.02.exr", "s.01.exr"], "c.##.exr")
    assert [(job.source.name, job.output.name) for job in planned] == [
        ("s.01.exr", "c.01.exr"),
        ("s.02.exr", "c.02.exr"),
    ]


def test_plan_lead_in_needs_no_output_name_but_its_features(shot):
    for number in (4, 5):
        channels = {name: np.zeros((2, 3), np.float32) for name in "RGB"}
        write_channels(shot / f"a.{number}.exr", channels)
    planned = plan_shot(
        ["s.##.exr"], "c.##.exr", {"albedo": "a.#.exr"}, selection=Selection(frames="5", warm_up=1)
    )
    assert [job.companions["albedo"].name for job in planned] == ["a.4.exr", "a.5.exr"]
    with pytest.raises(InputError, match=r"a\.3\.exr: no such file"):
        plan_shot(
            ["s.##.exr"],
            "c.##.exr",
            {"albedo": "a.#.exr"},
            selection=Selection(frames="5", warm_up=2),
        )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "no file for frame 6-7"),
        ({"on_missing": "ignore"}, "on-missing must be error or skip, got ignore"),
        ({"warm_up": -1}, "warm-up must be 0 frames or more, got -1"),
        ({"frames": "6-7", "on_missing": "skip"}, "frames must be among 1-5,8-9"),
        ({"frames": "5-3"}, "count upwards"),
    ],
)
def test_plan_says_what_is_wrong(shot, options, words):
    with pytest.raises(InputError, match=words):
        planned_numbers(**options)


def test_plan_refuses_to_write_into_the_inputs_folder_under_their_names(shot):
    with pytest.raises(InputError, match="must not overwrite an input"):
        plan_shot(["s.##.exr"], ".", selection=Selection(frames="1-3"))
