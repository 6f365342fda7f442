"""Examples that are drawn anew while a network learns.

Of a sequence there are a dozen examples: a few of the frames that its blocks of samples make, and
what is painted into it. Drawn once, a network learns them by heart, noise and all: after an hour it
was .2 dB better on them than on the same scenes with other samples (docs/decisions.md). Drawing a
sequence anew takes as long as a step or two of learning from it.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stillray.errors import InputError
from stillray_training.examples import Example


def draw_of(sequence: int, step: int, every: int, sequences: int) -> int:
    """How often a sequence has been drawn anew by a step: after every so many steps one is.

    Parameters
    ----------
    sequence
        Its place among all, from 0: they take turns.
    step
        From 0.
    every
        Steps from one drawing to the next, of whichever sequence; 0: none is.
    sequences
        How many there are.
    """
    if every == 0:
        return 0
    return max(-(-(step // every - sequence) // sequences), 0)


class Redrawn:
    """Examples whose sequences take turns in being drawn anew.

    What a step sees depends on the step alone, not on the steps before it: a training that is taken
    up again, and processes that draw batches of different steps, see the same.

    Parameters
    ----------
    examples
        Of whichever drawing; replaced in place.
    every
        See `draw_of`.
    load
        The examples of a sequence's folder and a drawing: as many as there are of it here, of the
        same kinds in the same order.
    """

    def __init__(
        self,
        examples: list[Example],
        every: int,
        load: Callable[[Path, int], list[Example]],
    ) -> None:
        self._examples, self._every, self._load = examples, every, load
        self._places: dict[Path, list[int]] = {}
        for place, example in enumerate(examples):
            self._places.setdefault(example.sequence, []).append(place)
        self._turns = {path: turn for turn, path in enumerate(self._places)}

    def at(self, place: int, step: int) -> Example:
        """An example as a step sees it.

        Raises
        ------
        InputError
            Its sequence's examples are no longer as many or of the same kinds: its files changed.
        """
        path = self._examples[place].sequence
        draw = draw_of(self._turns[path], step, self._every, len(self._turns))
        if draw != self._examples[place].draw:
            self._replace(path, draw)
        return self._examples[place]

    def _replace(self, path: Path, draw: int) -> None:
        fresh, places = self._load(path, draw), self._places[path]
        # a folder of data that is named twice counts twice
        again = fresh * (len(places) // max(len(fresh), 1))
        if [one.kind for one in again] != [self._examples[place].kind for place in places]:
            raise InputError(f"{path}: must stay as it is while a training reads it")
        for place, example in zip(places, again, strict=True):
            self._examples[place] = example
