"""The logits of one level of a kernel pyramid, whatever they come as, read where they are used."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache

import cv2
import numpy as np

from stillray.arrays.strips import Strips
from stillray.families.box_filter import bounded_exp
from stillray.families.depth_to_space import DepthToSpace
from stillray.families.pyramid_logits import numbers
from stillray.models.steps import InSteps, Output, Steps, numbers_of


class LogitMaps:
    """Maps of logits, bounded, and the weights that they stand for.

    Parameters
    ----------
    given : (planes, h, w) float32, or `InSteps` of them
        As the network gave them; a NaN stays one.
    bound
        The largest magnitude of a logit.
    strips
        Where the work runs.
    by_blocks
        Whether ``given`` are four planes of half the size for each, see `DepthToSpace`.

    Attributes
    ----------
    shape
        Of the maps.
    """

    def __init__(
        self,
        given: np.ndarray | InSteps,
        bound: float,
        strips: Strips,
        *,
        by_blocks: bool = False,
    ) -> None:
        self._steps = given.steps if isinstance(given, InSteps) else None
        maps = given.integers if isinstance(given, InSteps) else given
        self._maps: np.ndarray | DepthToSpace = DepthToSpace(maps, strips) if by_blocks else maps
        self._bound = bound
        self.shape = self._maps.shape

    def weights(self, places: slice, rows: slice, out: np.ndarray) -> np.ndarray:
        """The exponentials of some maps' rows, ``(n, rows, w)``: written to ``out`` and returned.

        Columns beyond those of ``out`` are left out.
        """
        if self._steps is not None:
            self._look_up(places, rows, _exponentials(self._steps, self._bound), out)
            return out
        if isinstance(self._maps, np.ndarray) and len(out) > 1 and out.flags.c_contiguous:
            # few calls for much: each waits for the interpreter's lock
            exponents = self.numbers(places, rows, out).reshape(-1, out.shape[2])
            cv2.exp(exponents, dst=exponents)
            return out
        for place, target in zip(range(places.start, places.stop), out, strict=True):
            bounded_exp(self._maps[place, rows][:, : out.shape[2]], self._bound, target)
        return out

    def weight(self, place: int, rows: slice, out: np.ndarray) -> np.ndarray:
        """As `weights`, of one map: ``(rows, w)``."""
        self.weights(slice(place, place + 1), rows, out[None])
        return out

    def numbers(self, places: slice, rows: slice, out: np.ndarray) -> np.ndarray:
        """As `weights`, the logits themselves."""
        if self._steps is not None:
            self._look_up(places, rows, _bounded(self._steps, self._bound), out)
            return out
        bound = np.float32(self._bound)
        np.clip(self._maps[places, rows][..., : out.shape[2]], -bound, bound, out=out)
        return out

    def _look_up(self, places: slice, rows: slice, table: np.ndarray, out: np.ndarray) -> None:
        for place, target in zip(range(places.start, places.stop), out, strict=True):
            cv2.LUT(self._maps[place, rows][:, : out.shape[2]], table, dst=target)


def holds_nan(outputs: Sequence[Output]) -> bool:
    """Whether a network gave what is no number; integers always are some."""
    return any(bool(np.isnan(each.max())) for each in outputs if not isinstance(each, InSteps))


def without_nan(outputs: Sequence[Output]) -> list[Output]:
    """Logits with 0 where they are not numbers, which say nothing."""
    return [each if isinstance(each, InSteps) else numbers([each])[0] for each in outputs]


@cache
def _bounded(steps: Steps, bound: float) -> np.ndarray:
    """What each integer stands for, bounded."""
    return np.clip(numbers_of(steps), np.float32(-bound), np.float32(bound))


@cache
def _exponentials(steps: Steps, bound: float) -> np.ndarray:
    """The weight of each integer."""
    exact: np.ndarray = np.exp(_bounded(steps, bound).astype(np.float64))
    return exact.astype(np.float32)
