"""A real scheduler, two worker processes, one of which is killed while it renders."""

from __future__ import annotations

import os
import signal
import threading

import numpy as np
import pytest

pytest.importorskip("mitsuba")
pytest.importorskip("distributed")

from stillray.io.exr.read import read_channels
from stillray_training.simulate.farm import run_farm, run_here
from stillray_training.simulate.jobs import Job
from stillray_training.simulate.sequence import SequenceOptions, is_complete
from tests.batch.dask_processes import dask_processes, wait_for

OPTIONS = SequenceOptions(frames=2, height=16, width=20, reference_spp=16)
JOBS = [
    Job(scene="tabletop", seed=seed, effects=("texture",) if seed % 2 else (), options=OPTIONS)
    for seed in range(6)
]


@pytest.fixture
def scheduler(tmp_path):
    """A scheduler's address and its two workers."""
    with dask_processes(tmp_path, workers=2) as running:
        yield running


def test_a_killed_worker_loses_nothing_and_nothing_is_rendered_twice(scheduler, tmp_path):
    address, workers = scheduler
    root = tmp_path / "out"
    root.mkdir()
    stamps: dict[str, int] = {}

    def kill() -> None:
        wait_for(lambda: len(list(root.glob("*/sequence.json"))) >= 1)
        wait_for(lambda: len(list(root.glob("*"))) >= 2)
        for path in root.glob("*/*"):
            if is_complete(path.parent) and not path.name.startswith("."):
                stamps[str(path)] = path.stat().st_mtime_ns
        workers[0].send_signal(signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    done: list[int] = []
    failures = run_farm(
        JOBS, root, "scalar_rgb", lambda job: done.append(job.seed), scheduler=address
    )
    killer.join()
    assert failures == {}
    assert sorted(done) == list(range(6))
    assert workers[0].wait(timeout=300) == -signal.SIGKILL
    folders = sorted(root.iterdir())
    assert [folder.name for folder in folders] == [f"tabletop-{seed:04d}-0" for seed in range(6)]
    assert all(is_complete(folder) for folder in folders)
    # what was finished before the kill is the same file still
    assert stamps
    for name, stamp in stamps.items():
        assert os.stat(name).st_mtime_ns == stamp
    # and all pixels are those of an undisturbed run
    calm = tmp_path / "calm"
    calm.mkdir()
    assert run_here(JOBS, calm, "scalar_rgb", lambda job: None) == {}
    for folder in folders:
        for name in ("frame_0000.exr", "frame_0001.exr", "ref_0001.exr"):
            one, two = read_channels(folder / name), read_channels(calm / folder.name / name)
            for channel, plane in one.items():
                np.testing.assert_array_equal(plane, two[channel])
        assert len(list(folder.glob("[fr]*.exr"))) == 3


def test_a_scene_that_cannot_be_rendered_is_reported_and_the_others_are(tmp_path):
    bad = Job(scene=str(tmp_path / "lost.xml"), options=OPTIONS)
    failures = run_here([bad, JOBS[0]], tmp_path, "scalar_rgb", lambda job: None)
    assert list(failures) == [f"{tmp_path.name}-0000"]
    assert is_complete(tmp_path / "tabletop-0000-0")
