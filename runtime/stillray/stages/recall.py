"""Recall: how much of the past a picture takes, pixel by pixel.

Geometry and blocks of light tell where a past no longer holds. What they cannot tell are single
pixels: petals before a window, a faucet's glint, an edge in a mirror, looked up a part of a pixel
off. Where a frame's samples are good, they tell. So the last output is compared with the frame's
own sample, in units of the noise of this frame, and counts less where they differ by more than
that, and what was accumulated with it. Noise is measured there as well: it is what they differ by
at most pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.bounds import at_least, at_most
from stillray.arrays.strips import STRIP_PIXELS, Strips, interleave, planes_of
from stillray.arrays.workspace import Workspace
from stillray.stages.sample_counts import SampleCounts

BLOCK = 16  # pixels, of which noise is measured together; windows are 3x3 blocks
#: Exposed radiance that is added where ratios are taken: black is no less than that.
DARK = 0.05
#: Logarithm of a ratio below which two lights are the same: emitters and skies have no noise, and
#: say nothing about it.
LEAST_APART = 0.01
#: Share of a window's pixels that say something, at which the whole frame's noise counts as much.
LITTLE_TOLD = 0.02
#: Noise has a longer tail the larger it is: its reach is ``noise (1 + TAIL noise)``.
TAIL = 4.0
#: Noise at which a frame that does not tell its samples is taken to have few of them.
USUAL_NOISE = 0.4
_BRIGHTEST = np.float32(1e30)  # exposed, of what is compared: ratios of two such are numbers
_MEAN = np.full((1, 3), 1 / 3, np.float32)  # of channels


@dataclass(frozen=True, eq=False)
class Compared:
    """What is compared, pixel by pixel.

    Attributes
    ----------
    output : (h, w, 4) float32
        The last output at these pixels: radiance, finite and >= 0; its last channel is not looked
        at.
    known : (h, w, 4) float32
        Its last channel is above 0 where there is a last output; may be ``output``.
    color : (h, w, 3) float32
        Radiance of this frame, finite and >= 0.
    exposure
        1 / radiance.
    worth : (h, w) float32 or None
        What this frame's samples weigh, > 0, above 1 as 1: a firefly is no news; None: 1.
    """

    output: np.ndarray
    known: np.ndarray
    color: np.ndarray
    exposure: float
    worth: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Recalled:
    """What is taken of a past, ``(h, w)`` float32 in [0, 1] each.

    Attributes
    ----------
    agreed
        How far the last output agrees with the frame's samples: a share of what the past holds.
        Where there is none it counts as black: hardly any, but of dark samples.
    output
        What the last output weighs in a picture, as a share of what a network says: ``agreed``, or
        less where the frame has many samples.
    """

    agreed: np.ndarray
    output: np.ndarray


@dataclass(frozen=True, kw_only=True, eq=False)
class Recall:
    """By what a frame takes of the past.

    Attributes
    ----------
    limit, power
        ``recall_noise``, and ``recall_power`` where there is one, of a decoder's specification,
        see `stillray.model_spec.decoders`.
    counts
        The frame's samples.
    """

    limit: float
    power: float = 0.0
    counts: SampleCounts = SampleCounts()  # noqa: RUF009  a value that nobody can change

    def share(self, seen: Compared, strips: Strips, workspace: Workspace) -> Recalled:
        """What is taken of the past.

        With ``a`` the mean over channels of ``|log((p + DARK) / (s + DARK))|``, of the exposed last
        output ``p`` and this frame's sample ``s``, and the noise ``n`` around, see `_noise`: they
        agree as far as ``1 / (1 + x^2)``, ``x = max(a / (n (1 + TAIL n)) - limit, 0)``, or nearer
        to 1 where the sample is worth less. The last output weighs that times what the past weighs
        beside the frame's samples, see `SampleCounts.past_weight`. Where nobody told those,
        ``n / USUAL_NOISE`` stands for that, up to 1.

        Parameters
        ----------
        seen
            The last output and the frame.
        strips
            Where the work runs.
        workspace
            Where the result lies from frame to frame.
        """
        height, width = seen.color.shape[:2]
        agreed = workspace.array("agreed share", (height, width))
        output = workspace.array("recalled share", (height, width)) if self.power else agreed
        noise = _noise(seen, agreed, strips, workspace)
        strips.watch.look()
        reach = noise + np.float32(TAIL) * np.square(noise)
        of_noise = _by_pixel(reach, workspace.array("reach of noise", _whole(reach)))
        weight: np.ndarray | None = None
        if self.power and self.counts.mean is None:
            quiet = at_most(noise / np.float32(USUAL_NOISE), 1)
            weight = _by_pixel(quiet, workspace.array("share by noise", of_noise.shape))

        def work(rows: slice) -> None:
            kept = agreed[rows]
            kept /= of_noise[rows, :width]
            kept -= np.float32(self.limit)
            at_least(kept, 0, out=kept)
            np.square(kept, out=kept)
            kept += 1
            np.reciprocal(kept, out=kept)
            if seen.worth is not None:  # 1 - worth (1 - kept)
                kept -= 1
                kept *= at_most(seen.worth[rows], 1)
                kept += 1
            if not self.power:
                return
            told = self.counts.past_weight(self.power, rows)
            if weight is not None:
                told = weight[rows, :width]
            np.multiply(kept, 1 if told is None else told, out=output[rows])

        strips.run(work, height, width)
        return Recalled(agreed, output)


def believed(
    mean: np.ndarray, sample: np.ndarray, agreed: np.ndarray, strips: Strips, out: np.ndarray
) -> np.ndarray:
    """What was accumulated, of a past that counts as far as single pixels agree with it.

    What the past loses this frame's sample gains, up to what it would weigh in new pixels: of
    ``n`` samples with the mean ``m``, and a sample ``s`` that weighs ``w``, an agreement ``a``
    leaves ``a n + (1 - a) w`` samples, with the mean that those have of ``m`` and ``s``.

    Parameters
    ----------
    mean : (h, w, 4) float32
        Light, and the samples that pixels hold, this frame's among them.
    sample : (4, h, w) float32
        This frame's light, and what its samples weigh, > 0.
    agreed : (h, w) float32
        See `Recalled`.
    strips
        Where the work runs.
    out : (h, w, 4) float32
        Written and returned; not ``mean``.
    """

    def work(rows: slice) -> None:
        shape = (4, rows.stop - rows.start, mean.shape[1])
        held = planes_of(mean[rows], out=strips.workspace.array("held", shape))
        gained = strips.workspace.array("gained", shape[1:])
        product = strips.workspace.array("product", shape[1:])
        own = sample[:, rows]
        np.subtract(1, agreed[rows], out=gained)
        gained *= own[3]
        kept = held[3]
        kept *= agreed[rows]
        total = np.add(kept, gained, out=strips.workspace.array("total", shape[1:]))
        gained /= total
        kept /= total
        # two products, since a difference would cancel where a firefly meets a dark past
        for light, new in zip(held[:3], own[:3], strict=True):
            light *= kept
            light += np.multiply(new, gained, out=product)
        held[3] = total
        interleave(held, out=out[rows])

    strips.run(work, *agreed.shape)
    return out


def _noise(seen: Compared, apart: np.ndarray, strips: Strips, workspace: Workspace) -> np.ndarray:
    """The noise of blocks of 16x16 pixels, ``(rows, columns)``; fills what pixels differ by.

    Noise is the geometric mean of what differs at all, and is in the frame: what moved is little
    of it. It is that of the whole frame, or of the window around where that is more: beside a
    sunlit floor a dark corner is as noisy as it is.
    """
    height, width = apart.shape
    rows, columns = -(-height // BLOCK), -(-width // BLOCK)
    sums = workspace.array("sums of noise", (2, rows, columns))

    def compare(blocks: slice) -> None:
        some = slice(BLOCK * blocks.start, min(BLOCK * blocks.stop, height))
        _compare(seen, some, apart[some], strips.workspace)
        _add_up(apart[some], seen.known[some], sums[:, blocks], strips.workspace)

    strips.run(compare, rows, columns, pixels=STRIP_PIXELS // BLOCK**2)
    counted, total = (float(plane.sum(dtype=np.float64)) for plane in sums)
    usual = total / counted if counted > 0 else np.log(LEAST_APART)
    # beyond the frame there is nothing
    around = [cv2.blur(plane, (3, 3), borderType=cv2.BORDER_CONSTANT) for plane in sums]
    local = around[1] + np.float32(LITTLE_TOLD * usual)
    local /= around[0] + np.float32(LITTLE_TOLD)
    noise: np.ndarray = np.exp(at_least(local, usual))
    return noise


def _compare(seen: Compared, rows: slice, out: np.ndarray, workspace: Workspace) -> None:
    """How many times one light is the other, as a logarithm: of some rows, means of channels."""
    scale, dark = np.float32(seen.exposure), np.float32(DARK)
    shape = seen.color[rows].shape
    last, own = workspace.array("last light", shape), workspace.array("own light", shape)
    cv2.cvtColor(seen.output[rows], cv2.COLOR_RGBA2RGB, dst=last)
    with np.errstate(over="ignore"):
        for light, exposed in ((last, last), (seen.color[rows], own)):
            np.multiply(light, scale, out=exposed)
            at_most(exposed, _BRIGHTEST, out=exposed)
            exposed += dark
    last /= own
    np.log(last, out=last)
    np.abs(last, out=last)
    cv2.transform(last, _MEAN, dst=out)


def _add_up(apart: np.ndarray, known: np.ndarray, sums: np.ndarray, workspace: Workspace) -> None:
    """Means over blocks ``(2, rows, columns)`` of what says something, and of its logarithm."""
    shape = (BLOCK * sums.shape[1], BLOCK * sums.shape[2])
    told, logarithm = workspace.array("told", (2, *shape))
    inside = np.s_[: apart.shape[0], : apart.shape[1]]
    if apart.shape != shape:  # beyond the frame nothing says anything
        told.fill(0)
        logarithm.fill(0)
    here = told[inside]
    np.greater(apart, LEAST_APART, out=here, casting="unsafe")
    temporary = cv2.extractChannel(known, 3, dst=workspace.array("known", apart.shape))
    here *= temporary > 0
    np.log(at_least(apart, LEAST_APART, out=temporary), out=logarithm[inside])
    logarithm[inside] *= here
    size = sums.shape[2], sums.shape[1]
    for plane, target in zip((told, logarithm), sums, strict=True):
        cv2.resize(plane, size, dst=target, interpolation=cv2.INTER_AREA)


def _whole(blocks: np.ndarray) -> tuple[int, int]:
    """Height and width of the pixels of whole blocks."""
    return BLOCK * blocks.shape[0], BLOCK * blocks.shape[1]


def _by_pixel(blocks: np.ndarray, out: np.ndarray) -> np.ndarray:
    """Blocks at the resolution of their pixels."""
    size = out.shape[1], out.shape[0]
    return cv2.resize(blocks, size, dst=out, interpolation=cv2.INTER_LINEAR)
