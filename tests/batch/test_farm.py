"""Tasks over Dask, as `stillray denoise` and `stillray-simulate` hand them out."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("distributed")

#: Two tasks on two local workers, of which one fails whenever it is tried.
PROGRAM = """
import operator
from stillray.batch.farm import run_tasks

ended = {}
failures = run_tasks(operator.truediv, {"good": 0, "bad": "0"}, ended.__setitem__)
print(ended["good"], ended["bad"], *failures, failures["bad"].split(":")[0])
"""


def test_local_workers_end_without_a_word_of_dask():
    """Also as the program ends; and of a task that failed, which its caller is told."""
    done = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True)
    assert done.stderr == ""
    assert done.stdout == "0.0 None bad TypeError\n"
    assert done.returncode == 0
