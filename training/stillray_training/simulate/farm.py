"""Rendering many jobs: in this process, in local processes, or on a Dask scheduler.

Jobs are idempotent, as `stillray.batch.farm` wants its tasks: a sequence's files appear complete or
not at all, finished ones are kept, and the same job gives the same pixels.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from pathlib import Path

from stillray.arrays.strips import available_threads
from stillray.batch.farm import run_tasks
from stillray.errors import InputError
from stillray_training.simulate.jobs import Job, run_job
from stillray_training.simulate.variant import load_mitsuba

_WORKER_MEMORY = 3 << 30  # bytes set aside for a worker: a guess with room, not a measured peak

Failures = dict[str, str]  # job name to the reason


def default_workers(jobs: int) -> int:
    """As many local processes as cores, memory and jobs allow; 1 without Dask."""
    if find_spec("distributed") is None:
        return 1
    import psutil

    memory = int(psutil.virtual_memory().available // _WORKER_MEMORY)
    return max(1, min(available_threads(), memory, jobs))


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
            failures[_name(job)] = str(error)
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
    workers, scheduler
        As `stillray.batch.farm.run_tasks` takes them.

    Returns
    -------
    dict
        The jobs that could not be rendered, and why.

    Raises
    ------
    InputError
        Dask is not installed, or the scheduler does not answer.
    """
    items = {_name(job): job for job in jobs}
    return run_tasks(
        partial(render_task, root=str(root.resolve()), variant=variant),
        items,
        lambda name, _: on_job(items[name]),
        workers=workers,
        scheduler=scheduler,
    )


def render_task(job: Job, threads: int, *, root: str, variant: str | None) -> None:
    """What a worker runs."""
    mi, _ = load_mitsuba(variant)
    if not mi.variant().startswith("scalar"):
        import drjit as dr

        dr.set_thread_count(threads)
    run_job(mi, job, Path(root))


def _name(job: Job) -> str:
    return f"{job.label}-{job.seed:04d}"
