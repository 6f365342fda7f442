"""Learning while denoising: a step of Adam a frame, and a guard that never lets it do harm.

Choi et al. 2024, section 4.3. The step itself is a graph (`stillray_training.online.step`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from stillray.families.contract import Engine

#: Height and width of what one step learns from, pixels: the graph's own.
CROP = 128
#: Steps between looks at whether learning has helped.
_CHECK_EVERY = 16
# Of the loss with the weights of the last look: more, and those come back.
_WORSE = 1.05
#: Steps after which the rate is half of what it was. differs: Choi et al. 2024 keep it; but what
#: halves agree on is not the truth, and after some hundred steps more is lost than won.
_HALVED = 32
_MOST = 1e3  # of a weight: no ReLU network that filters has any near it


@dataclass(frozen=True, kw_only=True, eq=False)
class Learned:
    """What outlives cuts.

    Attributes
    ----------
    weights, first, second : (n,) float32
        Weights of the network, and both moments of their slopes.
    steps
        How many there were, dropped ones among them.
    adam_steps
        How many the moments hold.
    kept : (n,) float32
        Weights at the last look that found them no worse than those before.
    """

    weights: np.ndarray
    first: np.ndarray
    second: np.ndarray
    steps: int
    adam_steps: int
    kept: np.ndarray

    @classmethod
    def begin(cls, weights: np.ndarray) -> Learned:
        """Nothing is learned yet."""
        none = np.zeros_like(weights)
        return cls(weights=weights, first=none, second=none, steps=0, adam_steps=0, kept=weights)


@dataclass(frozen=True, eq=False)
class Lesson:
    """What a frame can teach.

    Attributes
    ----------
    features : (1, n, H, W) float32
        As the network sees them; at least as large as the frame.
    shape
        Height and width of the frame, pixels.
    halves
        Gives what both halves have accumulated, of some rows and columns: ``(6, rows, columns)``
        float32, as the network sees pilots.
    """

    features: np.ndarray
    shape: tuple[int, int]
    halves: Callable[[tuple[slice, slice]], np.ndarray]


class Learner:
    """One step a frame.

    Parameters
    ----------
    engine
        Where the graph ``"train_step"`` runs.
    rate
        Of Adam, at the first step.
    seed
        With the number of steps it chooses the part of a frame that is learned from.
    """

    def __init__(self, engine: Engine, *, rate: float, seed: int) -> None:
        self._engine, self._rate, self._seed = engine, rate, seed

    def step(self, before: Learned, lesson: Lesson) -> tuple[Learned, str]:
        """Learn from a part of a frame.

        A step is dropped where its loss or its weights are not finite or have grown beyond all
        use. Every `_CHECK_EVERY` steps a part that this frame does not teach tells whether the
        weights have become worse than at the last look; those come back then, and the moments,
        which led astray, begin anew.

        Returns
        -------
        Learned
            What is learned now.
        str
            Why the step, or those since the last look, were dropped; empty if they were not.
        """
        rng = np.random.default_rng([self._seed, before.steps])
        counted = replace(before, steps=before.steps + 1)
        rate = self._rate / (1 + before.steps / _HALVED)
        after = self._adam(counted, crop_of(lesson, rng), rate)
        if after is None:
            # moments that are not finite would never heal
            return replace(Learned.begin(before.kept), steps=counted.steps), "no finite step"
        if after.steps % _CHECK_EVERY:
            return after, ""
        held_back = crop_of(lesson, rng)
        now, then = (self._loss(weights, held_back) for weights in (after.weights, before.kept))
        if math.isfinite(now) and now <= then * _WORSE:
            return replace(after, kept=after.weights), ""
        back = replace(Learned.begin(before.kept), steps=after.steps)
        return back, f"loss on a held-back part rose from {then:.4g} to {now:.4g}"

    def _adam(self, before: Learned, crop: dict[str, np.ndarray], rate: float) -> Learned | None:
        found = self._run(before, crop, rate)
        after = replace(
            before,
            weights=found["next_weights"],
            first=found["next_first"],
            second=found["next_second"],
            adam_steps=before.adam_steps + 1,
        )
        arrays = (after.weights, after.first, after.second, found["loss"])
        if not all(np.isfinite(array).all() for array in arrays):
            return None
        return None if np.abs(after.weights).max() > _MOST else after

    def _loss(self, weights: np.ndarray, crop: dict[str, np.ndarray]) -> float:
        return float(self._run(Learned.begin(weights), crop, 0.0)["loss"])

    def _run(
        self, state: Learned, crop: dict[str, np.ndarray], rate: float
    ) -> dict[str, np.ndarray]:
        return self._engine.run(
            "train_step",
            {
                "weights": state.weights[None],
                "first": state.first[None],
                "second": state.second[None],
                "step": np.array([state.adam_steps + 1], np.float32),
                "rate": np.array([rate], np.float32),
                **crop,
            },
        )


def crop_of(lesson: Lesson, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Some part of a frame, `CROP` pixels high and wide: inputs of the graph.

    A frame that is smaller is carried on by its last row and column, which do not count.
    """
    sizes = [min(size, CROP) for size in lesson.shape]
    top, left = (
        int(rng.integers(size - part + 1)) for size, part in zip(lesson.shape, sizes, strict=True)
    )
    rows, columns = slice(top, top + sizes[0]), slice(left, left + sizes[1])
    sides: Sequence[tuple[int, int]] = [(0, CROP - part) for part in sizes]
    inside = np.pad(np.ones((1, 1, *sizes), np.float32), [(0, 0), (0, 0), *sides])
    features = lesson.features[..., rows, columns]
    return {
        "features": np.pad(features, [(0, 0), (0, 0), *sides], mode="edge"),
        "halves": np.pad(
            lesson.halves((rows, columns))[None], [(0, 0), (0, 0), *sides], mode="edge"
        ),
        "inside": inside,
    }
