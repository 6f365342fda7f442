"""Examples to learn from: last frames of rendered sequences as a network will meet them.

A sequence goes through the runtime's own repair, demodulation, reprojection and accumulation, so
that a network learns from exactly what it will see. Its last frame is accumulated from several
starting frames: pixels then hold one sample, a few, or many. Where the frame comes in independent
blocks of samples, it is also seen alone with 2 to 32 samples a pixel, after frames of as many whose
light may have been another, and with hundreds to thousands, whose noise is that of 32 made smaller.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave, planes_of
from stillray.arrays.workspace import Workspace
from stillray.errors import InputError
from stillray.families.contract import Context, Request
from stillray.families.registry import kernels_of
from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray.pipeline.prefilter import Prefilter
from stillray.stages.decide import Wants
from stillray.stages.prepare import prepare
from stillray.stages.previous_output import resample
from stillray.stages.recall import Compared, believed
from stillray.stages.reproject import positions_of
from stillray.stages.sample_counts import SampleCounts
from stillray.stages.state import History, Prepared
from stillray_training.blocks import alike_frames, mean_frame
from stillray_training.draws import log_uniform
from stillray_training.film import (
    DEVIATIONS,
    film_variance,
    frame_through_film,
    through_film,
    widened,
)
from stillray_training.quiet import fireflies, quiet_frame, uneven_frame
from stillray_training.rendered import Rendered, numbered, read_rendered
from stillray_training.shade import moving_shade
from stillray_training.simulate.sequence import is_complete

STARTS = (1, 3, 8)  # frames accumulated before the last one is learned from
#: How examples differ, and how often a patch is of that kind.
NOISY, STILL, QUIET = "noisy", "still", "quiet"
_STILLS = 3  # examples of a few samples a pixel, of each sequence that has blocks
_STILLS_ALONE = 6  # the same, where nothing else is learned from
_UNEVEN = 2  # and of those whose noise lies in a part of the picture
_WIDE = 0.45  # share of the others that come through a wider pixel filter
_QUIETS = 2  # and of hundreds to thousands
_LIT = 3  # and after frames of as many samples, of a camera and things that stay
_MOST_SAMPLES = 4096
_FIREFLIES = 0.4  # share of quiet examples that have some
_WANDERING = 0.5  # share of those with a past whose past has them too, one pixel on a frame
_CHANGING = 0.7  # share of pasts that stay in whose frames the light changes
_LIT_SAMPLES = (2.0, 256.0)  # of a frame after others
_PAST = 4  # most frames before it
_NOISE_LEFT = 0.3  # most of a past's noise that its last output is given
_LOOKED = 0.5  # share of those that were looked at between pixels, as a moving camera does
_LOOKS = 3  # at most, there and back
_QUIET_PAST = 0.5  # share of quiet examples that have a past


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """The last frame of a sequence as the network will meet it, and its reference."""

    mean: np.ndarray  # (h, w, 4) irradiance and samples
    sample: np.ndarray  # (h, w, 4) irradiance of this frame and what it weighs
    exposure: float
    demodulation_albedo: np.ndarray  # (h, w, 3) what radiance was divided by
    remodulation_albedo: np.ndarray  # (h, w, 3) what the result is multiplied by
    albedo: np.ndarray  # (h, w, 3)
    normal: np.ndarray  # (h, w, 3)
    depth: np.ndarray  # (h, w)
    depth_unit: float
    previous: np.ndarray  # (h, w, 4) radiance of the previous output, and how much of it is valid
    reference: np.ndarray  # (h, w, 3) radiance
    spp: float = 1.0  # samples a pixel of each frame
    kind: str = NOISY  # or STILL or QUIET
    sequence: Path = Path()  # its folder
    draw: int = 0  # which drawing of the sequence it is of, see `load_examples`
    frames: int = 1  # accumulated
    recalled: np.ndarray | None = None  # (h, w) what the last output weighs; None: 1
    rendered_spread: float | None = None  # of the render's pixel filter, pixels; None: not known
    film_variance: float = 0.0  # what a wider film added to that, square pixels

    @property
    def filter_spread(self) -> float | None:
        """Standard deviation of the pixel filter, in pixels; None where it is not known."""
        return widened(self.rendered_spread, self.film_variance)


def find_sequences(folder: Path) -> list[Path]:
    """Folders of finished sequences, sorted by name.

    Raises
    ------
    InputError
        There is no such folder.
    """
    if not folder.is_dir():
        raise InputError(f"data must be a folder of sequences, got {folder}")
    return sorted(path for path in folder.iterdir() if path.is_dir() and is_complete(path))


class Runtime:
    """What the runtime does to a frame before a network sees it.

    Parameters
    ----------
    spec
        Of the model.
    strips
        Where the work runs.
    """

    def __init__(self, spec: ModelSpec, strips: Strips) -> None:
        self.spec, self._strips = spec, strips
        name = spec.prefilter.albedo
        self._prefilter = Prefilter(name, 1, None, "float32") if name else None

    def close(self) -> None:
        """Close the network of its prefilter, if it has one."""
        if self._prefilter is not None:
            self._prefilter.close()

    def prefiltered(self, frame: Frame) -> Frame:
        """A frame whose albedo is as the model takes it."""
        if self._prefilter is None:
            return frame
        return self._prefilter.denoised(frame, Context(strips=self._strips), None)

    def looked_up(self, output: np.ndarray, times: int, rng: np.random.Generator) -> np.ndarray:
        """An output ``(h, w, 4)`` after so many looks between its pixels, there and back."""
        height, width = output.shape[:2]
        still = np.zeros((height, width, 2), np.float32)
        here = positions_of(still, slice(0, height))
        sharp = kernels_of(self.spec).sharp
        for _ in range(times):
            way = rng.random(2, dtype=np.float32)
            for positions in (here + way, here - way):
                valid = _valid_output(output[..., :3])  # each is an output, wherever it was seen
                output = resample(valid, positions, self._strips, sharp=sharp)
        return output

    def recall(
        self, example: Example, previous: np.ndarray, color: np.ndarray, samples: float
    ) -> Example:
        """An example before which some output ``(h, w, 4)`` was the last.

        ``color`` ``(h, w, 3)`` is the frame's, of so many samples a pixel.
        """
        recall = kernels_of(self.spec).recall(SampleCounts(mean=samples))
        if recall is None:
            return replace(example, previous=previous)
        sample = planes_of(example.sample)
        seen = Compared(
            previous, previous, np.maximum(color, np.float32(0)), example.exposure, sample[3]
        )
        found = recall.share(seen, self._strips, Workspace())
        out = np.empty_like(example.mean)
        left = believed(example.mean, sample, found.agreed, self._strips, out)
        return replace(example, previous=previous, recalled=found.output, mean=left)

    def example(self, run: list[Frame], reference: np.ndarray) -> Example:
        """The last of some frames in a row, and what it is to become."""
        history: History | None = None
        takes = (*self.spec.inputs.required, *self.spec.inputs.optional)
        for frame in run:
            frame = self.prefiltered(frame.for_inputs(takes))
            prepared = prepare(frame, self.spec, history, self._strips, Wants(sample=True))
            history = prepared.history
        assert history is not None
        return Example(
            mean=history.mean,
            sample=_sample(prepared),
            exposure=history.exposure,
            demodulation_albedo=_albedo(prepared.demodulation_albedo, prepared),
            remodulation_albedo=_albedo(prepared.remodulation_albedo, prepared),
            albedo=_albedo(prepared.albedo, prepared),
            normal=_given(prepared.normal, (*frame.shape, 3)).astype(np.float16),
            depth=_given(prepared.depth, frame.shape),
            depth_unit=prepared.depth_unit,
            previous=np.broadcast_to(np.float32(0), history.mean.shape),
            reference=reference,
        )


def load_examples(sequence: Path, spec: ModelSpec, strips: Strips, draw: int = 0) -> list[Example]:
    """The last frame of a sequence, accumulated from each of the starting frames; then others.

    Parameters
    ----------
    sequence
        Its folder.
    spec
        Of the model that is to learn from them.
    strips
        Where the work runs.
    draw
        Another number: other blocks, counts and paintings of the same sequence, as many and of the
        same kinds.

    Raises
    ------
    InputError
        The sequence lacks its frames or its reference.
    """
    rendered = read_rendered(sequence, spec.training, draw=draw)
    # of its own for every sequence, the same every time
    name = zlib.crc32(sequence.name.encode())
    rng = np.random.default_rng([spec.training.seed, name, *numbered(draw)])
    with closing(Runtime(spec, strips)) as runtime:
        return [
            replace(example, sequence=sequence, draw=draw, rendered_spread=rendered.spread)
            for example in _all_examples(rendered, runtime, rng)
        ]


def _all_examples(rendered: Rendered, runtime: Runtime, rng: np.random.Generator) -> list[Example]:
    frames, blocks, reference = rendered.frames, rendered.blocks, rendered.reference
    examples = []
    alone = runtime.spec.training.alone
    for count in STARTS[:1] if alone else STARTS:
        example = runtime.example(frames[-count:], reference)
        examples.append(replace(example, spp=rendered.spp, frames=count))
    if len(blocks) == 1:
        quiet = runtime.example([quiet_frame(frames[-1], reference, rng)], reference)
        return [*examples, replace(quiet, kind=QUIET)]
    whole = mean_frame(blocks)
    stills = _STILLS_ALONE if alone else _STILLS
    for index, (frame, samples) in enumerate(_stills(blocks, rng, stills + _UNEVEN)):
        if index >= stills:
            frame = uneven_frame(frame, reference, whole.albedo, rng)
        wanted, added = reference, 0.0
        if index < stills and rng.random() < _WIDE:
            deviation = rng.uniform(*DEVIATIONS)
            frame = frame_through_film(frame, deviation)
            wanted, added = through_film(reference, deviation), film_variance(deviation)
        example = replace(runtime.example([frame], wanted), film_variance=added)
        examples.append(replace(example, spp=samples, kind=STILL))
    for frame, samples in _quiets(blocks, reference, rng):
        examples.append(_quiet_example(frame, samples, reference, runtime, rng))
    for _ in range(0 if alone else _LIT):
        examples.append(_lit_example(blocks, reference, runtime, rng))
    return examples


def _quiet_example(
    frame: Frame,
    samples: float,
    reference: np.ndarray,
    runtime: Runtime,
    rng: np.random.Generator,
) -> Example:
    """A quiet frame, perhaps with fireflies, alone or after frames as quiet without any."""
    # no albedo is above 1
    shining = rng.random() < _FIREFLIES and runtime.spec.training.layer == "color"
    past = not runtime.spec.training.alone and rng.random() < _QUIET_PAST
    run = [frame]
    if shining:
        light = fireflies(reference, rng)
        frame = _lit_by(frame, light)
        run = [frame]
        if past:
            still = np.zeros((*frame.shape, 2), np.float32)
            last = replace(frame, motion=still)
            quiet = replace(last, color=reference.astype(np.float32))
            run = [quiet] * int(rng.integers(2, 9)) + [last]
            if rng.random() < _WANDERING:
                run = _wandering(run, light, rng)
    example = replace(runtime.example(run, reference), spp=samples, kind=QUIET)
    if shining and past:
        # the last output of frames without fireflies: the picture as it should be
        return runtime.recall(example, _valid_output(reference), run[-1].color, samples)
    if not past:
        return example
    example = _with_blurred_past(example, rng)
    return runtime.recall(example, example.previous, frame.color, samples)


def _wandering(run: list[Frame], light: np.ndarray, rng: np.random.Generator) -> list[Frame]:
    """A run whose last frame's fireflies ``(h, w, 3)`` came one pixel on with every frame."""
    way = rng.integers(-1, 2, 2)
    past = []
    for age, frame in zip(range(len(run) - 1, 0, -1), run, strict=False):
        there = np.roll(light, tuple(way * age), (0, 1))
        past.append(_lit_by(frame, there))
    return [*past, run[-1]]


def _lit_by(frame: Frame, light: np.ndarray) -> Frame:
    """A frame with fireflies ``(h, w, 3)``, 0 where there is none."""
    return replace(frame, color=np.where(light > 0, light, frame.color))


def _valid_output(image: np.ndarray) -> np.ndarray:
    """An image as a previous output, ``(h, w, 4)``, that is valid everywhere."""
    return cv2.cvtColor(np.ascontiguousarray(image, np.float32), cv2.COLOR_RGB2RGBA)


def _lit_example(
    blocks: list[tuple[Frame, float]],
    reference: np.ndarray,
    runtime: Runtime,
    rng: np.random.Generator,
) -> Example:
    """The last of some frames of as many samples each; light may have changed from each to each.

    A network that has only seen pasts that were right learns to trust those that no longer are.
    """
    # two frames at least
    fewest = sorted(count for _, count in blocks)[1]
    samples = max(log_uniform(rng, _LIT_SAMPLES), fewest)
    frames = alike_frames(blocks, reference, samples, int(rng.integers(2, _PAST + 2)), rng)
    shades = [np.ones((*reference.shape[:2], 1), np.float32)] * len(frames)
    if rng.random() < _CHANGING:
        shades = moving_shade(reference.shape[:2], len(frames), rng)
    run = [
        replace(frame, color=frame.color * shade)
        for frame, shade in zip(frames, shades, strict=True)
    ]
    example = runtime.example(run, reference * shades[-1])
    before = reference * shades[-2]
    before = before + np.float32(_NOISE_LEFT * rng.random()) * (run[-2].color - before)
    previous = _valid_output(before)
    if rng.random() < _LOOKED:
        previous = runtime.looked_up(previous, int(rng.integers(1, _LOOKS + 1)), rng)
    example = runtime.recall(example, previous, run[-1].color, samples)
    return replace(example, spp=samples, kind=STILL, frames=len(run))


def _stills(
    blocks: list[tuple[Frame, float]], rng: np.random.Generator, number: int
) -> Iterator[tuple[Frame, float]]:
    """So many frames of 1 sample a pixel to all that there are, and their counts."""
    most = sum(count for _, count in blocks)
    fewest = min(count for _, count in blocks)
    for _ in range(number):
        wanted = max(float(np.exp(rng.uniform(0, np.log(most)))), fewest)
        chosen: list[tuple[Frame, float]] = []
        count = 0.0
        for index in rng.permutation(len(blocks)):
            if count + blocks[index][1] <= wanted:
                chosen.append(blocks[index])
                count += blocks[index][1]
        yield mean_frame(chosen), count


def _quiets(
    blocks: list[tuple[Frame, float]], reference: np.ndarray, rng: np.random.Generator
) -> Iterator[tuple[Frame, float]]:
    """Frames of more samples than were taken: the noise of all of them, made smaller."""
    whole, most = mean_frame(blocks), sum(count for _, count in blocks)
    for _ in range(_QUIETS):
        count = log_uniform(rng, (2 * most, _MOST_SAMPLES))
        noise = np.float32(np.sqrt(most / count))
        color = reference + noise * (whole.color - reference)
        yield replace(whole, color=color.astype(np.float32), motion=None), count


def _with_blurred_past(example: Example, rng: np.random.Generator) -> Example:
    """As if frames as quiet had come before: each look at the past has blurred it a little."""
    frames = float(rng.integers(1, 16))
    mean, previous = example.mean.copy(), np.empty_like(example.mean)
    previous[..., :3] = mean[..., :3] * example.remodulation_albedo
    previous[..., 3] = 1
    for image in (mean, previous):
        for _ in range(int(rng.integers(1, 4))):
            # bilinear, a part of a pixel off, there and back
            ways = [np.array([part, 1 - part], np.float32) for part in rng.random(2)]
            across, down = (np.convolve(way, way[::-1]).astype(np.float32) for way in ways)
            light = np.ascontiguousarray(image[..., :3])
            image[..., :3] = cv2.sepFilter2D(
                light, -1, across, down, borderType=cv2.BORDER_REPLICATE
            )
    own = example.sample[..., 3:]
    light = (frames * mean[..., :3] + own * example.sample[..., :3]) / (frames + own)
    mean = np.concatenate([light, own + frames], -1)
    return replace(example, mean=mean, previous=previous)


def _given(feature: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    """A feature as examples keep it; zeros, which nobody reads, where the model takes none."""
    return np.zeros(shape, np.float32) if feature is None else feature


def _albedo(albedo: np.ndarray | None, prepared: Prepared) -> np.ndarray:
    """As examples keep it; of a frame without albedo that of white, which changes nothing."""
    white = np.ones((*prepared.history.mean.shape[:2], 3), np.float16)
    return white if albedo is None else albedo.astype(np.float16)


def _sample(prepared: Prepared) -> np.ndarray:
    if prepared.sample is None:
        return prepared.history.mean
    return interleave(prepared.sample, out=np.empty_like(prepared.history.mean))


class Remembered(NamedTuple):
    """What a model remembers at the last frame of a sequence, as `Example` has it.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Accumulated light and samples, looked up beside edges of its output as the runtime does, and
        believed as far as that agrees.
    previous : (h, w, 4) float32
        Radiance of the last output at the pixels of this frame, and how much of it is valid.
    recalled : (h, w) float32 or None
        What it weighs in the picture, see `stillray.stages.recall`; None: all of it.
    """

    mean: np.ndarray
    previous: np.ndarray
    recalled: np.ndarray | None


def remembered(sequence: Path, denoiser: Denoiser, strips: Strips) -> dict[int, Remembered]:
    """What a model, run as users run it, remembers at the last frame of a sequence.

    Parameters
    ----------
    sequence
        Its folder.
    denoiser
        The model, opened once for many sequences; left with the state of this one.
    strips
        Where the rest runs.

    Returns
    -------
    dict
        By how many frames are accumulated.
    """
    spec = denoiser.model.spec
    rendered = read_rendered(sequence, spec.training, with_blocks=False)
    frames = [replace(frame, filter_spread=rendered.spread) for frame in rendered.frames]
    found = {}
    family = kernels_of(spec)
    with closing(Runtime(spec, strips)) as runtime:
        last = runtime.prefiltered(frames[-1])
    for count in STARTS[1:]:  # one frame has no past
        denoiser.reset()
        for frame in frames[-count:-1]:
            denoiser.denoise(frame)
        context = Context(strips=strips)
        plan = family.plan(last, denoiser.state, Request(), context)
        prepared, previous = family.prepare(plan, context)
        if previous is not None:
            # what is believed lies where the next frame's will
            found[count] = Remembered(prepared.mean.copy(), previous, prepared.recalled)
    return found
