"""A real Dask scheduler and workers, as processes of their own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

_SETTINGS = {
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "60s",
    # Looking at all threads while one starts can lock CPython 3.11.7 for good: its list of threads
    # is held while garbage is collected (gh-106883). A test waited for such a worker.
    "DASK_DISTRIBUTED__WORKER__PROFILE__ENABLED": "False",
}


@contextmanager
def dask_processes(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """The scheduler's address, and its workers; all end with the block."""
    processes: list[subprocess.Popen] = []

    def start(*args: str) -> subprocess.Popen:
        process = subprocess.Popen(
            [sys.executable, "-m", "distributed.cli." + args[0], *args[1:], "--no-dashboard"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env={**os.environ, **_SETTINGS},
        )
        processes.append(process)
        return process

    contact = folder / "scheduler.json"
    try:
        start(
            "dask_scheduler", "--port", "0", "--host", "127.0.0.1", "--scheduler-file", str(contact)
        )
        # the file is there before it is written
        wait_for(lambda: contact.is_file() and contact.read_text().rstrip().endswith("}"))
        address = json.loads(contact.read_text())["address"]
        options = ("--nthreads", "1", "--no-nanny")
        yield (
            address,
            [
                start("dask_worker", address, *options, "--local-directory", str(folder / f"w{i}"))
                for i in range(workers)
            ],
        )
    finally:
        for process in processes:
            process.kill()
            process.wait()


def wait_for(condition: Callable[[], bool], seconds: float = 300.0) -> None:
    """Return as soon as a condition holds; fail if it never does."""
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)
