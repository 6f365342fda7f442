"""What a training runs on: the device that learns, and processes that prepare for it.

A graphics card learns from a batch in less time than one core takes to draw it; drawn by several
processes ahead of it, in the same order and from the same numbers, batches are there in time.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor
from torch.utils._pytree import tree_flatten, tree_map
from torch.utils.data import DataLoader, Dataset

from stillray.errors import InputError

Item = TypeVar("Item")
Made = TypeVar("Made")
_ALIGNED = 32  # floats: kernels read vectors of them where they begin at a multiple
#: Whether the processor multiplies bfloat16 itself; where it does not, a step takes far longer.
_HAS_BFLOAT16 = any(
    torch.cpu.get_capabilities().get(name) for name in ("avx512_bf16", "amx_bf16", "bf16")
)


@dataclass(frozen=True)
class Machine:
    """Where a training runs.

    Attributes
    ----------
    device
        What learns.
    workers
        Processes that read sequences and draw batches; 0: this one does.
    minutes
        That it may take to learn.
    """

    device: torch.device = field(default_factory=lambda: torch.device("cpu"))
    workers: int = 0
    minutes: float = float("inf")

    @classmethod
    def named(cls, device: str, workers: int, minutes: float = float("inf")) -> Machine:
        """A device by PyTorch's name for it.

        Raises
        ------
        InputError
            There is no such device here, or fewer than no processes are asked for, or no time.
        """
        if not minutes > 0:
            raise InputError(f"minutes must be above 0, got {minutes:g}")
        if workers < 0:
            raise InputError(f"workers must be 0 or more, got {workers}")
        try:
            found = torch.device(device)
            torch.empty(0, device=found)
        except (RuntimeError, AssertionError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(
                f"device must be one that PyTorch finds here, cpu or cuda, got {device}: {reason}"
            ) from None
        return cls(found, workers, minutes)

    @property
    def has_bfloat16(self) -> bool:
        """Whether the device multiplies bfloat16 itself."""
        return _HAS_BFLOAT16 if self.device.type == "cpu" else True

    def made(self, function: Callable[[Item], Made], items: Sequence[Item]) -> Iterator[Made]:
        """A function of each item, in order, by all workers; they see this process as it is now.

        Raises
        ------
        InputError
            As the function's own: what else a process raises comes with its trace.
        """
        if not self.workers:
            return map(function, items)
        loader = DataLoader(
            _Calls(function, items),
            batch_size=None,
            collate_fn=_as_it_is,
            num_workers=min(self.workers, max(len(items), 1)),
            pin_memory=self.device.type == "cuda",
            multiprocessing_context="fork",
        )
        return _accepted(iter(loader))


class Batches:
    """The batches of a training, on its device.

    Parameters
    ----------
    draw
        The batch of a step: float32 arrays in lists and dictionaries.
    steps
        How many there are.
    machine
        Who draws them, and where they go.
    """

    def __init__(self, draw: Callable[[int], Any], steps: int, machine: Machine) -> None:
        self._draw, self._steps, self._machine = draw, steps, machine
        self._drawn: Iterator[_Packed] | None = None

    def __call__(self, step: int) -> Any:
        """As it was drawn, of tensors; steps are asked for one after the other."""
        if self._drawn is None:
            self._drawn = self._machine.made(self._packed, range(step, self._steps))
        return next(self._drawn).unpacked(self._machine.device)

    def forget(self) -> None:
        """Draw what follows anew: what it is drawn from has changed."""
        self._drawn = None

    def _packed(self, step: int) -> _Packed:
        return _Packed.of(self._draw(step))


class _Packed:
    """All arrays of a batch in one: a process hands on one piece of memory, a device gets one.

    Parameters
    ----------
    flat
        All values, and room between arrays.
    shapes
        The batch, with a shape in place of each array.
    """

    def __init__(self, flat: Tensor, shapes: Any) -> None:
        self._flat, self._shapes = flat, shapes

    @classmethod
    def of(cls, batch: Any) -> _Packed:
        arrays, _ = tree_flatten(batch)
        starts = list(accumulate((_room(array.shape) for array in arrays), initial=0))
        flat = np.zeros(starts[-1], np.float32)
        for start, array in zip(starts, arrays, strict=False):
            flat[start : start + array.size] = array.ravel()
        return cls(torch.from_numpy(flat), tree_map(np.shape, batch))

    def pin_memory(self) -> _Packed:
        """Where a device can fetch it from; the loader asks for it."""
        return _Packed(self._flat.pin_memory(), self._shapes)

    def unpacked(self, device: torch.device) -> Any:
        """The batch, of tensors on a device."""
        flat = self._flat.to(device, non_blocking=True)
        start = 0

        def taken(shape: tuple[int, ...]) -> Tensor:
            nonlocal start
            first, start = start, start + _room(shape)
            return flat[first : first + math.prod(shape)].view(shape)

        return tree_map(taken, self._shapes, is_leaf=lambda part: isinstance(part, tuple))


class _Calls(Dataset[Any]):
    """What a function makes of items, or how it refuses one."""

    def __init__(self, function: Callable[[Any], Any], items: Sequence[Any]) -> None:
        self._function, self._items = function, items

    def __len__(self) -> int:
        return len(self._items)

    def __getitem__(self, index: int) -> Any:
        try:
            return self._function(self._items[index])
        except InputError as error:  # raised here, it would be told with its trace
            return error


def _accepted(found: Iterator[Any]) -> Iterator[Any]:
    for made in found:
        if isinstance(made, InputError):
            raise made
        yield made


def _room(shape: Sequence[int]) -> int:
    return -(-math.prod(shape) // _ALIGNED) * _ALIGNED


def _as_it_is(made: Any) -> Any:
    return made
