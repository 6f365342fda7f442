"""Search for the inputs that an operator of the runtime computes worst.

A climb from random inputs: values are redrawn, made equal, or set to the ends of their range, and
what makes the error larger is kept. Bounded by steps in the tests; ``STILLRAY_SEARCH_SECONDS``
makes it as long as one likes, and `markdown` writes what it found.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from itertools import count

import numpy as np

from tests.operator_errors import OPERATORS, Inputs, Operator, narrowed

SECONDS = "STILLRAY_SEARCH_SECONDS"
_PATIENCE = 30  # steps without gain before a fresh start
_HEAD = """## Error of the operators

The largest error of each numeric operator against its definition in float64 loops
(`tests/oracles.py`, `tests/operator_errors.py`), over inputs that a search made as bad as it could:
radiance of 1e-20 to 1e30 in one window, samples of 1e-6 to 17, logits beyond their bound. "Random"
is the worst of 30 draws. Errors are relative to the value itself, whatever is beside it, except
where the table says otherwise. `{seconds}=600 pytest tests/test_worst_errors.py` searches longer.

| operator | random | searched | limit | relative to | inputs tried |
|---|---|---|---|---|---|
"""


@dataclass(frozen=True)
class Found:
    """The worst that was found: random inputs alone, and after the climb."""

    random: float
    worst: float
    tried: int


def search(operator: Operator, *, steps: int, seconds: float = 0.0, seed: int = 0) -> Found:
    """Climb for some steps, or for some seconds if that is longer."""
    rng = np.random.default_rng(seed)
    until = time.monotonic() + seconds
    random = max(
        operator.error(_variant(operator, index).draw(rng)) for index in range(min(steps, 30))
    )
    worst, tried = random, min(steps, 30)
    inputs, error, idle = operator.draw(rng), 0.0, 0
    for step in count():
        if step >= steps and time.monotonic() >= until:
            break
        if idle > _PATIENCE:
            inputs, error, idle = _variant(operator, step).draw(rng), 0.0, 0
        candidate = _moved(operator, inputs, rng)
        found = operator.error(candidate)
        tried += 1
        idle += 1
        if found > error:
            inputs, error, idle = candidate, found, 0
            worst = max(worst, found)
    return Found(random, worst, tried)


def markdown(seconds: float) -> str:
    """The table of all operators."""
    rows = []
    for operator in OPERATORS:
        found = search(operator, steps=100, seconds=seconds)
        unit = "the value" if operator.unit == "relative" else operator.unit
        rows.append(
            f"| {operator.name} | {found.random:.2g} | {found.worst:.2g} | {operator.limit:.2g} "
            f"| {unit} | {found.tried} |"
        )
    return _HEAD.format(seconds=SECONDS) + "\n".join(rows) + "\n"


def _variant(operator: Operator, index: int) -> Operator:
    """Wide and narrow ranges of radiance in turn: rounding and range fail differently."""
    return operator if index % 2 else narrowed(operator, 2 + index % 5)


def _moved(operator: Operator, inputs: Inputs, rng: np.random.Generator) -> Inputs:
    name = str(rng.choice(list(inputs)))
    array = inputs[name].copy()
    flat = array.reshape(-1)
    at = rng.choice(flat.size, max(1, int(flat.size * rng.choice([0.01, 0.1, 0.5]))), replace=False)
    _, low, high, _ = operator.ranges[name]
    kind = rng.integers(4)
    if kind == 0:
        flat[at] = operator.values(name, rng, at.size)
    elif kind == 1:
        flat[at] = operator.values(name, rng, 1)
    elif kind == 2:
        flat[at] = np.float32(low if rng.random() < 0.5 else high)
    else:
        flat[at] = np.clip(flat[at] * np.float32(1 + 1e-3 * rng.standard_normal()), low, high)
    return {**inputs, name: array}
