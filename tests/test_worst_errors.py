from __future__ import annotations

import os

import pytest

from tests.operator_errors import OPERATORS
from tests.worst_errors import SECONDS, search


@pytest.mark.parametrize("operator", OPERATORS, ids=lambda operator: operator.name)
def test_no_input_is_found_that_an_operator_computes_badly(operator):
    seconds = float(os.environ.get(SECONDS, 0)) / len(OPERATORS)
    # a new seed a run where the search is long, so that it looks elsewhere
    seed = int.from_bytes(os.urandom(4)) if seconds else 0
    found = search(operator, steps=40, seconds=seconds, seed=seed)
    assert found.worst <= operator.limit, f"seed {seed}"
