"""How many samples a pixel a frame has, and how much the past counts beside them.

The history counts in frames: a pixel of a frame adds 1 to what it holds, less if it is an outlier.
Where a frame says how many samples a pixel it has, two things follow. A past of frames with fewer
samples counts as fewer frames like this one. And in a frame whose pixels differ, each counts by its
samples. So what is held at a pixel is brought to frames like this pixel of this frame, accumulated
as ever, with all that is ruled there on outliers and on how much of a past is kept, and brought
back to frames like the mean of this one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stillray.arrays.bounds import at_least
from stillray.arrays.strips import Strips

#: Share of the mean's samples that a pixel counts as at least, if it has any: float32 holds what
#: is divided by it, and what is filled in still weighs less.
LEAST_SHARE = 1e-3
#: Samples a pixel up to which a last output weighs as much as the network says, and a past of the
#: albedo as much as the specification.
FEW_SAMPLES = 2.0
MOST_SCALE = 1e6  # a change of samples between frames beyond which a past is all or nothing


@dataclass(frozen=True, kw_only=True, eq=False)
class SampleCounts:
    """The samples of one frame.

    Attributes
    ----------
    mean
        Samples a pixel, mean of the pixels that have any; where the frame does not say, that of
        the frame before; None where that did not say either.
    share : (h, w) float32 or None
        Each pixel's samples by the mean, above 0; 1 where a pixel has none: it is filled in, and
        what that weighs does not depend on it. None where the pixels do not differ.
    past_scale
        Frames like this one that a frame of the past counts as.
    """

    mean: float | None = None
    share: np.ndarray | None = None
    past_scale: float = 1.0

    @classmethod
    def of(
        cls, samples: float | np.ndarray | None, before: float | None, strips: Strips | None = None
    ) -> SampleCounts:
        """What a frame says, beside what is known of the past.

        Parameters
        ----------
        samples : number or (h, w) float32 or None
            As in `stillray.Frame`.
        before
            The ``mean`` of the frame before; None if it is not known, or there is none. A past
            that never said counts as frames like this one.
        strips
            Where the work runs; None for the caller's thread.
        """
        share: np.ndarray | None = None
        mean = mean_samples(samples, before)
        if isinstance(samples, np.ndarray):
            strips = strips or Strips(1)
            strips.watch.look()
            sampled = samples > 0  # NaN is not
            if mean is not None and sampled.any():
                share = _shares(samples, sampled, mean, strips)
        scale = 1.0
        if before is not None and mean is not None:
            scale = min(max(before / mean, 1 / MOST_SCALE), MOST_SCALE)
        return cls(mean=mean, share=share, past_scale=scale)

    def told(self, share: float = 1.0) -> float:
        """Samples a pixel of a frame, for the network; 1 where nobody said, as in training.

        Parameters
        ----------
        share
            Of the samples, where they are more than one, see `stillray.model_spec.ModelSpec`'s
            ``told_samples``.
        """
        if self.mean is None:
            return 1.0
        return max(share * self.mean, min(self.mean, 1.0))

    def past_weight(self, power: float, rows: slice) -> np.ndarray | float | None:
        """What a past weighs beside a frame's samples: ``(samples / FEW_SAMPLES) ** -power``, to 1.

        A number, or ``(h, w)`` of some rows where pixels differ; None where nobody said.
        """
        if self.mean is None or not power:
            return None
        if self.share is None:
            return float(max(self.mean / FEW_SAMPLES, 1.0) ** -power)
        times = np.maximum(self.share[rows] * np.float32(self.mean / FEW_SAMPLES), np.float32(1))
        weight: np.ndarray = times ** np.float32(-power)
        return weight

    def albedo_frames(self, most: float) -> float:
        """Frames that an albedo's past counts as, of ``most``: of many samples it needs none."""
        return most if self.mean is None else most / max(self.mean / FEW_SAMPLES, 1.0)

    def held_by_pixel(self, held: np.ndarray, rows: slice) -> None:
        """Bring what the past holds, ``(h, w)`` of some rows, to frames like its pixels."""
        if self.past_scale != 1:
            held *= np.float32(self.past_scale)
        if self.share is not None:
            held /= self.share[rows]

    def weight_by_pixel(self, weight: np.ndarray, rows: slice) -> np.ndarray:
        """Weights of some rows as they were before `by_frame`."""
        return weight if self.share is None else weight / self.share[rows]

    def by_frame(self, held: np.ndarray, rows: slice) -> None:
        """Bring frames like these pixels, ``(h, w)`` of some rows, to frames like the mean."""
        if self.share is not None:
            held *= self.share[rows]


def mean_samples(samples: float | np.ndarray | None, before: float | None) -> float | None:
    """Samples a pixel of a frame, as `SampleCounts` has them, see `SampleCounts.of`."""
    if samples is None:
        return before
    if not isinstance(samples, np.ndarray):
        return samples
    some = samples[samples > 0]  # NaN is not
    return float(some.mean(dtype=np.float64)) if some.size else before


def _shares(samples: np.ndarray, sampled: np.ndarray, mean: float, strips: Strips) -> np.ndarray:
    """Each pixel's samples by the mean, see `SampleCounts`."""
    share, unit = np.empty(samples.shape, np.float32), np.float32(mean)

    def work(rows: slice) -> None:
        part = np.where(sampled[rows], samples[rows] / unit, np.float32(1))
        at_least(part, LEAST_SHARE, out=share[rows])

    strips.run(work, *samples.shape)
    return share
