"""A median without sorting: sorting runs on few accelerators, counting on all."""

from __future__ import annotations

import torch
from torch import Tensor

_WAYS = 32  # parts into which a round divides the range that holds the median
_ROUNDS = 6  # 32^6 parts of the range of logarithms: finer than float32


def masked_median(values: Tensor, counts: Tensor) -> tuple[Tensor, Tensor]:
    """The median of some of a list of numbers, the mean of both middle ones of an even count.

    Parameters
    ----------
    values : (n,)
        >= 0; below 1e-37 they are one.
    counts : (n,)
        1 where a value counts, else 0.

    Returns
    -------
    median, count
        Scalars; the median means nothing where none counts.
    """
    order = values.clamp(min=1e-37).log()  # several decades: equal steps in the logarithm
    count = counts.sum()
    most = torch.where(counts > 0, order, -100.0).max()
    least = torch.where(counts > 0, order, 100.0).min()
    low, step = least - 1, (most - least + 1) / _WAYS
    wanted = ((count - 1) / 2).floor()  # of so many the median is the next
    ladder = torch.arange(1, _WAYS + 1, dtype=torch.float32)
    for _ in range(_ROUNDS):
        below = ((order[:, None] <= low + step * ladder) * counts[:, None]).sum(0)
        low = low + step * (below <= wanted).to(torch.float32).sum()
        step = step / _WAYS
    first = _least(values, (order > low) & (counts > 0))
    # by the values: a logarithm taken anew may be rounded otherwise
    reached = ((values <= first) * counts).sum()
    next_one = _least(values, (values > first) & (counts > 0))
    second = torch.where(reached > (count / 2).floor(), first, next_one)
    return (first + second) / 2, count


def _least(values: Tensor, counts: Tensor) -> Tensor:
    return torch.where(counts, values, 3e38).min()
