"""A real scheduler, two worker processes, one of which is killed while it renders."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

pytest.importorskip("mitsuba")
pytest.importorskip("distributed")

from stillray.exr import read_channels
from stillray.training.simulate.farm import run_farm, run_here
from stillray.training.simulate.jobs import Job
from stillray.training.simulate.sequence import SequenceOptions, is_complete

OPTIONS = SequenceOptions(frames=2, height=16, width=20, reference_spp=16)
JOBS = [
    Job(scene="tabletop", seed=seed, effects=("texture",) if seed % 2 else (), options=OPTIONS)
    for seed in range(6)
]


@pytest.fixture
def start():
    """Starts processes of Dask, which end with the test."""
    processes = []

    def run(*args):
        environment = {**os.environ, "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "10s"}
        processes.append(
            subprocess.Popen(
                [sys.executable, "-m", "distributed.cli." + args[0], *args[1:], "--no-dashboard"],
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                env=environment,
            )
        )
        return processes[-1]

    yield run
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def scheduler(start, tmp_path):
    """A scheduler and two workers as processes of their own: address and workers."""
    contact = tmp_path / "scheduler.json"
    start("dask_scheduler", "--port", "0", "--host", "127.0.0.1", "--scheduler-file", str(contact))

    def announced():
        # the file is there before it is written
        return contact.is_file() and contact.read_text().rstrip().endswith("}")

    wait_for(announced)
    address = json.loads(contact.read_text())["address"]
    options = ("--nthreads", "1", "--no-nanny")
    workers = [
        start("dask_worker", address, *options, "--local-directory", str(tmp_path / f"worker{i}"))
        for i in range(2)
    ]
    return address, workers


def wait_for(condition, seconds: float = 60.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


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
    assert workers[0].wait() == -signal.SIGKILL
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
