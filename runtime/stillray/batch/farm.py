"""Tasks on Dask: on a scheduler of many machines, or in processes of this one.

A task must be idempotent: what it makes appears complete or not at all, and what is finished is
kept. So one that a lost worker had begun can simply be done again.
"""

from __future__ import annotations

import logging
import socket
import uuid
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any, TypeVar

from stillray.arrays.strips import available_threads
from stillray.errors import InputError

Item = TypeVar("Item")
Result = TypeVar("Result")

ANSWER_SECONDS = 10  # in which a scheduler must answer
#: Dask looks at itself a hundred times a second, which takes six per cent of a core from tasks of
#: minutes.
_QUIET = {"distributed.admin.tick.interval": "1s", "distributed.worker.profile.enabled": False}
_RETRIES = 3  # of a task that fails for another reason than bad input


def run_tasks(
    task: Callable[[Item, int], Result],
    items: Mapping[str, Item],
    on_end: Callable[[str, Result | None], None],
    *,
    workers: int = 2,
    scheduler: str | None = None,
    wait: Callable[[str], None] = lambda line: None,
) -> dict[str, str]:
    """Do a task for every item, wherever there is room.

    Parameters
    ----------
    task
        Called on a worker with an item and the threads that it should use; importable there.
    items
        By name.
    on_end
        Called here as each ends, with its name and the result; None for one that failed.
    workers
        Local processes, where no scheduler is given, 1 or more.
    scheduler
        Address of a running Dask scheduler, such as ``tcp://host:8786``.
    wait
        Called with a line for the user where there is nothing to do but to wait.

    Returns
    -------
    dict
        The items that could not be done, by name, and why.

    Raises
    ------
    InputError
        Dask is not installed, or the scheduler does not answer.
    """
    if find_spec("distributed") is None:
        raise InputError("a scheduler or several workers need Dask: pip install 'stillray[farm]'")
    from distributed import as_completed

    failures: dict[str, str] = {}
    run = uuid.uuid4().hex  # two runs on one scheduler must not take each other's results
    with _client(workers, scheduler) as (client, threads):
        if not client.nthreads():
            wait(f"{scheduler} has no worker yet: waiting for one")
        futures = {
            client.submit(
                _attempt, task, item, threads, key=f"{name}-{run}", retries=_RETRIES, pure=False
            ): name
            for name, item in items.items()
        }
        for future in as_completed(futures):
            name = futures[future]
            if future.status != "finished":
                failures[name] = _why(future)
                on_end(name, None)
                continue
            result, refusal = future.result()
            if refusal is not None:
                failures[name] = refusal
            on_end(name, result)
            future.release()  # the scheduler need not keep the result
    return failures


def _attempt(
    task: Callable[[Item, int], Result], item: Item, threads: int
) -> tuple[Result | None, str | None]:
    """The result, or why the input is bad: it stays so, and there is no use in trying again."""
    if not threads:
        from distributed import get_worker

        threads = max(1, available_threads() // get_worker().state.nthreads)
    try:
        return task(item, threads), None
    except InputError as error:
        return None, f"{error} (on {socket.gethostname()})"


def _why(future: Any) -> str:
    if future.status == "error":
        error = future.exception()
        return f"{type(error).__name__}: {error}"
    return "the scheduler has lost it"


@contextmanager
def _client(workers: int, scheduler: str | None) -> Iterator[tuple[Any, int]]:
    """A client, and the threads for each task; 0 where each worker must find out."""
    import dask
    from distributed import Client, LocalCluster

    if scheduler is not None:
        try:
            client = Client(scheduler, timeout=ANSWER_SECONDS)
        except (OSError, ValueError) as error:
            raise InputError(f"scheduler must answer, got {scheduler}: {error}") from None
        with client:
            yield client, 0
        return
    # what a worker says of its own end means nothing to a user: what failed is told here.
    # memory limits off: a worker that Dask kills for its memory would only start over
    with (
        dask.config.set(_QUIET),
        LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, memory_limit=0,
            dashboard_address=":0", silence_logs=logging.CRITICAL,
        ) as cluster,
        Client(cluster) as client,
    ):  # fmt: skip
        yield client, max(1, available_threads() // workers)
