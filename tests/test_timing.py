from __future__ import annotations

import pytest

from stillray import timing


@pytest.fixture
def clock(monkeypatch):
    """Seconds that pass when a test says so."""
    now = [100.0]
    monkeypatch.setattr(timing.time, "perf_counter", lambda: now[0])

    def wait(seconds):
        now[0] += seconds

    return wait


def test_a_stage_that_runs_twice_adds_up(clock):
    timings: dict[str, float] = {}
    for _ in range(2):
        with timing.timed(timings, "a"):
            clock(0.25)
    assert timings == {"a": 500.0}


def test_stages_of_one_pass_share_its_time_as_the_threads_spent_it(clock):
    timings = {"b": 1000.0}
    with timing.timed_pass(timings) as part:
        for name, seconds in (("a", 0.25), ("b", 1.0), ("a", 0.75)):
            with part(name):
                clock(seconds)
        clock(2.0)  # waiting for the last strip: 4 seconds in all, half of them in each stage
    assert timings == {"a": 2000.0, "b": 3000.0}


def test_a_pass_without_work_takes_no_stage_s_time(clock):
    timings: dict[str, float] = {}
    with timing.timed_pass(timings):
        clock(1.0)
    assert timings == {}
