"""Running many jobs: in this process, in local processes, or on a Dask scheduler.

A task is idempotent: its files appear complete or not at all, finished ones are kept, and the same
job gives the same pixels. So a task that a lost worker had begun can simply be run again.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from stillray.errors import InputError
from stillray.training.simulate.jobs import Job, run_job
from stillray.training.simulate.variant import load_mitsuba

_WORKER_MEMORY = 3 << 30  # bytes set aside for a worker: a guess with room, not a measured peak

Failures = dict[str, str]  # job name to the reason


def default_workers(jobs: int) -> int:
    """As many local processes as cores, memory and jobs allow; 1 without Dask."""
    if find_spec("distributed") is None:
        return 1
    import psutil

    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    memory = int(psutil.virtual_memory().available // _WORKER_MEMORY)
    return max(1, min(cores, memory, jobs))


def run_here(
    jobs: list[Job], root: Path, variant: str | None, on_frame: Callable[[Job], None]
) -> Failures:
    """Run jobs one after the other in this process."""
    mi, _ = load_mitsuba(variant)
    failures = {}
    for job in jobs:
        try:
            run_job(mi, job, root, on_frame=lambda job=job: on_frame(job))  # type: ignore[misc]
        except InputError as error:
            if len(jobs) == 1:
                raise
            failures[f"{job.label}-{job.seed:04d}"] = str(error)
    return failures


def run_farm(
    jobs: list[Job],
    root: Path,
    variant: str | None,
    on_job: Callable[[Job], None],
    *,
    workers: int = 2,
    scheduler: str | None = None,
) -> Failures:
    """Run jobs on Dask.

    Parameters
    ----------
    jobs
        What to render; those that are finished are left out by the workers.
    root
        The output folder; on a scheduler of several machines, one that all of them see.
    variant
        The Mitsuba variant; None: each worker chooses.
    on_job
        Called as each job ends.
    workers
        Local processes, where no scheduler is given, 1 or more.
    scheduler
        Address of a running Dask scheduler, such as ``tcp://host:8786``.

    Returns
    -------
    dict
        The jobs that could not be rendered, and why.

    Raises
    ------
    InputError
        Dask is not installed, or the scheduler does not answer.
    """
    if find_spec("distributed") is None:
        raise InputError("workers above 1 need Dask: pip install 'stillray[farm]'")
    from distributed import as_completed

    failures: Failures = {}
    with _client(workers, scheduler) as (client, threads):
        futures = {
            client.submit(
                render_task, job, str(root.resolve()), variant, threads,
                key=f"{job.label}-{job.seed:04d}", retries=3,
            ): job
            for job in jobs
        }  # fmt: skip
        for future in as_completed(futures):
            job = futures[future]
            if future.status == "error":
                failures[future.key] = str(future.exception())
            elif reason := future.result():
                failures[future.key] = reason
            on_job(job)
    return failures


def render_task(job: Job, root: str, variant: str | None, threads: int) -> str | None:
    """What a worker runs; gives back why the job cannot be done, or None."""
    mi, _ = load_mitsuba(variant)
    if threads and not mi.variant().startswith("scalar"):
        import drjit as dr

        dr.set_thread_count(threads)
    try:
        run_job(mi, job, Path(root))
    except InputError as error:  # bad input stays bad: no use in trying again
        return str(error)
    return None


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[tuple[Any, int]]:
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=10)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler must answer, got {scheduler}: {error}") from None
        with client:
            yield client, 0
        return
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    # memory limits off: a worker that Dask kills for its memory would only start over
    with (
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, memory_limit=0,
            dashboard_address=":0",
        ) as cluster,
        Client(cluster) as client,
    ):  # fmt: skip
        yield client, max(1, cores // workers)
