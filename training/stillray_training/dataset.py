"""Training patches from rendered sequences.

A sequence goes through the runtime's own repair, demodulation, reprojection and accumulation, so
that a network learns from exactly what it will see. Its last frame is accumulated from several
starting frames: pixels then hold one sample, a few, or many. Where the frame comes in independent
blocks of samples, it is also seen alone with 2 to 32 samples a pixel, and with hundreds to
thousands, whose noise is that of 32 made smaller.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from stillray.arrays.strips import Strips, interleave
from stillray.errors import InputError
from stillray.families.contract import Context, Request
from stillray.families.registry import kernels_of
from stillray.frame import Frame
from stillray.io.exr.read_write import read_exr
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray.stages import features as encode
from stillray.stages.decide import Wants
from stillray.stages.prepare import prepare
from stillray.stages.state import History, Prepared
from stillray_training.blocks import mean_frame, read_blocks
from stillray_training.quiet import fireflies, quiet_frame, uneven_frame
from stillray_training.shade import moving_shade
from stillray_training.simulate.sequence import is_complete
from stillray_training.targets import read_target

STARTS = (1, 3, 8)  # frames accumulated before the last one is learned from
#: How examples differ, and how often a patch is of that kind.
NOISY, STILL, QUIET = "noisy", "still", "quiet"
_STILLS = 3  # examples of a few samples a pixel, of each sequence that has blocks
_UNEVEN = 2  # and of those whose noise lies in a part of the picture
_QUIETS = 2  # and of hundreds to thousands
_LIT = 3  # and after frames of as many samples, of a camera and things that stay
_MOST_SAMPLES = 4096
_FIREFLIES = 0.4  # share of quiet examples that have some
_WANDERING = 0.5  # share of those, of all with a past, whose past has them too, one pixel away a frame
_CHANGING = 0.7  # share of pasts that stay in whose frames the light changes
_LIT_SAMPLES = (2.0, 256.0)  # of a frame after others
_FEW = 8.0  # below it the guides of such a frame are those of one block, as noisy as its light
_NOISE_LEFT = 0.3  # most of a past's noise that its last output is given
_QUIET_PAST = 0.5  # share of quiet examples that have a past
_SAMPLES_KNOWN = 0.5  # share of patches whose frames say how many samples they have
_AT_BORDER = 0.3  # share of patches that touch the top or bottom, and the left or right
_FLAT = 0.05  # relative contrast of a reference patch below which there is little to learn


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
    sequence: str = ""  # name of its folder
    frames: int = 1  # accumulated


@dataclass(frozen=True, kw_only=True, eq=False)
class Batch:
    """Patches as the network and the decoder take them, ``(n, c, h, w)`` float32."""

    features: np.ndarray
    irradiance: np.ndarray
    samples: np.ndarray
    new: np.ndarray
    # as the whole models that are exported call their inputs
    worth: np.ndarray  # what samples weigh
    divisor: np.ndarray  # the albedo that the result is multiplied by
    previous: np.ndarray
    valid: np.ndarray
    reference: np.ndarray
    exposure: np.ndarray  # (n, 1, 1, 1)


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


def load_examples(sequence: Path, spec: ModelSpec, strips: Strips) -> list[Example]:
    """The last frame of a sequence, accumulated from each of the starting frames; then others.

    Raises
    ------
    InputError
        The sequence lacks its frames or its reference.
    """
    frames = [read_exr(path) for path in sorted(sequence.glob("frame_*.exr"))]
    if not frames:
        raise InputError(f"{sequence}: must hold frames, frame_0000.exr and on")
    reference, spp = read_target(sequence)
    examples = _all_examples(sequence, frames, reference, spp, spec, strips)
    return [replace(example, sequence=sequence.name) for example in examples]


def _all_examples(
    sequence: Path,
    frames: list[Frame],
    reference: np.ndarray,
    spp: float,
    spec: ModelSpec,
    strips: Strips,
) -> list[Example]:
    # of its own for every sequence, the same every time
    rng = np.random.default_rng([spec.training.seed, zlib.crc32(sequence.name.encode())])
    examples = []
    for count in STARTS:
        example = _example(frames[-count:], reference, spec, strips)
        examples.append(replace(example, spp=spp, frames=count))
    blocks = read_blocks(sequence, frames[-1], spp)
    if len(blocks) == 1:
        quiet = _example([quiet_frame(frames[-1], reference, rng)], reference, spec, strips)
        return [*examples, replace(quiet, kind=QUIET)]
    whole = mean_frame(blocks)
    for index, (frame, samples) in enumerate(_stills(blocks, rng, _STILLS + _UNEVEN)):
        if index >= _STILLS:
            assert whole.albedo is not None
            frame = uneven_frame(frame, reference, whole.albedo, rng)
        example = _example([frame], reference, spec, strips)
        examples.append(replace(example, spp=samples, kind=STILL))
    for frame, samples in _quiets(blocks, reference, rng):
        examples.append(_quiet_example(frame, samples, reference, spec, strips, rng))
    for _ in range(_LIT):
        examples.append(_lit_example(blocks, reference, spec, strips, rng))
    return examples


def _quiet_example(
    frame: Frame,
    samples: float,
    reference: np.ndarray,
    spec: ModelSpec,
    strips: Strips,
    rng: np.random.Generator,
) -> Example:
    """A quiet frame, perhaps with fireflies, alone or after frames as quiet without any."""
    shining = rng.random() < _FIREFLIES
    past = rng.random() < _QUIET_PAST
    run = [frame]
    if shining:
        light = fireflies(reference, rng)
        frame = replace(frame, color=np.where(light > 0, light, frame.color))
        run = [frame]
        if past:
            still = np.zeros((*frame.shape, 2), np.float32)
            last = replace(frame, motion=still)
            quiet = replace(last, color=reference.astype(np.float32))
            run = [quiet] * int(rng.integers(2, 9)) + [last]
            if rng.random() < _WANDERING:
                run = _wandering(run, light, rng)
    example = replace(_example(run, reference, spec, strips), spp=samples, kind=QUIET)
    if shining and past:
        # the last output of frames without fireflies: the picture as it should be
        valid = np.ones((*frame.shape, 1), np.float32)
        return replace(example, previous=np.concatenate([reference, valid], -1))
    return _with_blurred_past(example, rng) if past else example


def _wandering(run: list[Frame], light: np.ndarray, rng: np.random.Generator) -> list[Frame]:
    """Frames before the last with its fireflies ``(h, w, 3)`` too, one pixel on from each to each."""
    way = rng.integers(-1, 2, 2)
    past = []
    for age, frame in zip(range(len(run) - 1, 0, -1), run, strict=False):
        there = np.roll(light, tuple(way * age), (0, 1))
        past.append(replace(frame, color=np.where(there > 0, there, frame.color)))
    return [*past, run[-1]]


def _lit_example(
    blocks: list[tuple[Frame, float]],
    reference: np.ndarray,
    spec: ModelSpec,
    strips: Strips,
    rng: np.random.Generator,
) -> Example:
    """The last of some frames of as many samples each; light may have changed from each to each.

    A network that has only seen pasts that were right learns to trust those that no longer are.
    """
    samples = float(np.exp(rng.uniform(*np.log(_LIT_SAMPLES))))
    order = rng.permutation(len(blocks))[: int(rng.integers(2, len(blocks) + 1))]
    shades = [np.ones((*reference.shape[:2], 1), np.float32)] * len(order)
    if rng.random() < _CHANGING:
        shades = moving_shade(reference.shape[:2], len(order), rng)
    still = np.zeros((*reference.shape[:2], 2), np.float32)
    whole = mean_frame(blocks)
    run = []
    for shade, (frame, count) in zip(shades, (blocks[index] for index in order), strict=True):
        # the noise of so many samples: each frame has its own
        noise = np.nan_to_num(frame.color) - reference
        color = reference + np.float32(np.sqrt(count / samples)) * noise
        guides = frame if samples < _FEW else whole
        color = np.maximum(color, 0) * shade
        run.append(replace(guides, color=color, motion=still, samples=samples))
    example = _example(run, reference * shades[-1], spec, strips)
    left = np.float32(_NOISE_LEFT * rng.random())
    before = reference * shades[-2] + left * (run[-2].color - reference * shades[-2])
    valid = np.ones((*reference.shape[:2], 1), np.float32)
    previous = np.concatenate([before, valid], -1)
    return replace(example, spp=samples, kind=STILL, previous=previous)


def _stills(
    blocks: list[tuple[Frame, float]], rng: np.random.Generator, number: int
) -> Iterator[tuple[Frame, float]]:
    """So many frames of 2 samples a pixel to all that there are, and their counts."""
    for _ in range(number):
        most = sum(count for _, count in blocks)
        wanted = np.exp(rng.uniform(np.log(2), np.log(most)))
        chosen: list[tuple[Frame, float]] = []
        count = 0.0
        for index in rng.permutation(len(blocks)):
            if not chosen or count + blocks[index][1] <= wanted:
                chosen.append(blocks[index])
                count += blocks[index][1]
        yield mean_frame(chosen), count


def _quiets(
    blocks: list[tuple[Frame, float]], reference: np.ndarray, rng: np.random.Generator
) -> Iterator[tuple[Frame, float]]:
    """Frames of more samples than were taken: the noise of all of them, made smaller."""
    whole, most = mean_frame(blocks), sum(count for _, count in blocks)
    for _ in range(_QUIETS):
        count = float(np.exp(rng.uniform(np.log(2 * most), np.log(_MOST_SAMPLES))))
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


def _example(run: list[Frame], reference: np.ndarray, spec: ModelSpec, strips: Strips) -> Example:
    history: History | None = None
    for frame in run:
        prepared = prepare(frame, spec, history, strips, Wants(sample=True))
        history = prepared.history
    assert history is not None
    assert prepared.demodulation_albedo is not None
    assert prepared.remodulation_albedo is not None
    assert prepared.albedo is not None
    assert prepared.normal is not None
    assert prepared.depth is not None
    return Example(
        mean=history.mean,
        sample=_sample(prepared),
        exposure=history.exposure,
        demodulation_albedo=prepared.demodulation_albedo.astype(np.float16),
        remodulation_albedo=prepared.remodulation_albedo.astype(np.float16),
        albedo=prepared.albedo.astype(np.float16),
        normal=prepared.normal.astype(np.float16),
        depth=prepared.depth,
        depth_unit=prepared.depth_unit,
        previous=np.broadcast_to(np.float32(0), history.mean.shape),
        reference=reference,
    )


def _sample(prepared: Prepared) -> np.ndarray:
    if prepared.sample is None:
        return prepared.history.mean
    return interleave(prepared.sample, out=np.empty_like(prepared.history.mean))


def previous_outputs(sequence: Path, model: Path, strips: Strips) -> dict[int, np.ndarray]:
    """What a model, run as users run it, remembers at the last frame of a sequence.

    Returns
    -------
    dict of (h, w, 4) arrays
        By how many frames are accumulated: radiance of the previous output at the pixels of the
        last frame, and how much of it is valid.
    """
    frames = [read_exr(path) for path in sorted(sequence.glob("frame_*.exr"))]
    remembered = {}
    with Denoiser(model, threads=1) as denoiser:
        family = kernels_of(denoiser.model.spec)
        for count in STARTS[1:]:  # one frame has no past
            denoiser.reset()
            for frame in frames[-count:-1]:
                denoiser.denoise(frame)
            context = Context(strips=strips)
            plan = family.plan(frames[-1], denoiser.state, Request(), context)
            _, previous = family.prepare(plan, context)
            if previous is not None:
                remembered[count] = previous
    return remembered


class PatchSampler:
    """Draws augmented patches; the n-th batch depends on the seed and n only.

    Parameters
    ----------
    examples
        What to draw from; may be replaced one by one between batches.
    spec
        The model's specification.

    Raises
    ------
    InputError
        An example is smaller than a patch.
    """

    def __init__(self, examples: list[Example], spec: ModelSpec) -> None:
        size = spec.training.patch
        for one in examples:
            if min(one.reference.shape[:2]) < size:
                raise InputError(
                    f"{one.sequence}: must have {size} x {size} pixels or more, the size of a "
                    f"patch, got {one.reference.shape[:2]}"
                )
        # places, not examples: those are replaced when previous outputs are renewed
        self._examples = examples
        self._places: dict[str, list[int]] = {}
        for place, one in enumerate(examples):
            self._places.setdefault(one.kind, []).append(place)
        self._spec = spec

    def batch(self, step: int) -> Batch:
        """The batch of one training step."""
        recipe = self._spec.training
        rng = np.random.default_rng([recipe.seed, step])
        patches = [self._patch(rng) for _ in range(recipe.batch)]
        return Batch(**{name: np.stack([patch[name] for patch in patches]) for name in patches[0]})

    def _patch(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        size = self._spec.training.patch
        recipe = self._spec.training
        drawn = rng.random()
        kind = QUIET if drawn < recipe.quiet_share else NOISY
        if recipe.quiet_share <= drawn < recipe.quiet_share + recipe.still_share:
            kind = STILL
        places = self._places.get(kind) or self._places[NOISY]
        for _ in range(8):  # look for a patch in which there is something to learn
            example = self._examples[places[rng.integers(len(places))]]
            height, width = example.reference.shape[:2]
            top, left = (_offset(rng, length - size) for length in (height, width))
            window = (slice(top, top + size), slice(left, left + size))
            light = example.reference[window].mean(axis=-1)
            if light.std() > _FLAT * light.mean() and light.mean() > 0:
                break
        return self._augment(example, window, rng)

    def _augment(
        self, example: Example, window: tuple[slice, slice], rng: np.random.Generator
    ) -> dict[str, np.ndarray]:
        spec, recipe = self._spec, self._spec.training
        turn = _random_turn(rng)
        order = rng.permutation(3)
        gain = np.exp(rng.normal(size=3) * 0.15).astype(np.float32)
        mean = turn(example.mean[window]).copy()
        mean[..., :3] = mean[..., order] * gain
        sample = turn(example.sample[window]).copy()
        sample[..., :3] = sample[..., order] * gain
        reference = turn(example.reference[window])[..., order] * gain
        remodulation = turn(example.remodulation_albedo[window])[..., order].astype(np.float32)
        previous = turn(example.previous[window]).copy()
        previous[..., :3] = previous[..., order] * gain
        albedo: np.ndarray | None = turn(example.albedo[window])[..., order].astype(np.float32)
        normal: np.ndarray | None = turn(example.normal[window]).astype(np.float32)
        normal = normal @ _random_rotation(rng)
        depth: np.ndarray | None = turn(example.depth[window])
        if rng.random() < recipe.drop_feature:
            # no albedo: what is filtered is radiance
            demodulation = turn(example.demodulation_albedo[window])[..., order].astype(np.float32)
            mean[..., :3] *= demodulation
            sample[..., :3] *= demodulation
            remodulation, albedo = np.ones_like(demodulation), None
        if rng.random() < recipe.drop_feature:
            normal = None
        if rng.random() < recipe.drop_feature:
            depth = None
        # whoever does not say how many samples a frame has is taken to have one
        spp = example.spp if rng.random() < _SAMPLES_KNOWN else 1.0
        stops = rng.uniform(-recipe.exposure_stops, recipe.exposure_stops)
        exposure = float(example.exposure * 2**stops)
        light = encode.tone_map(encode.luminance(mean), exposure)
        features = np.zeros((len(spec.network.features), *light.shape), np.float32)
        given = encode.FeatureInputs(
            mean=mean,
            local=encode.local_luminance(light, spec.transfer),
            exposure=exposure,
            sample=encode.luminance(sample),
            albedo=albedo,
            normal=normal,
            depth=depth,
            depth_unit=example.depth_unit,
            frame_samples=spp,
        )
        encode.feature_planes(given, spec.temporal, spec.network.features, out=features)
        encode.previous_planes(
            previous, remodulation, exposure, spec.network.features, out=features
        )
        return {
            "features": features,
            "irradiance": _chw(mean[..., :3]),
            "samples": mean[None, ..., 3],
            "new": _chw(sample[..., :3]),
            "worth": sample[None, ..., 3],
            "divisor": _chw(remodulation),
            "previous": _chw(previous[..., :3]),
            "valid": previous[None, ..., 3],
            "reference": _chw(reference),
            "exposure": np.full((1, 1, 1), exposure, np.float32),
        }


def _offset(rng: np.random.Generator, room: int) -> int:
    """Where a patch begins: anywhere, and often enough at the border of the frame.

    Where the camera moves, new pixels of one sample appear beside what was accumulated, there and
    nowhere else; drawn evenly, a patch almost never held a border.
    """
    room = max(room, 0)
    border = rng.random()
    if border < _AT_BORDER:
        return 0 if border < _AT_BORDER / 2 else room
    return int(rng.integers(0, room + 1))


def _chw(image: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(image.transpose(2, 0, 1), dtype=np.float32)


class _random_turn:  # noqa: N801  a function with its choice drawn beforehand
    """One of the eight symmetries of the square, the same for all of a patch's buffers."""

    def __init__(self, rng: np.random.Generator) -> None:
        self._quarters = int(rng.integers(4))
        self._mirror = bool(rng.integers(2))

    def __call__(self, image: np.ndarray) -> np.ndarray:
        turned = np.rot90(image, self._quarters)
        return np.ascontiguousarray(turned[:, ::-1] if self._mirror else turned)


def _random_rotation(rng: np.random.Generator) -> np.ndarray:
    """A uniformly random rotation: normals come in any renderer's space."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q *= np.sign(np.diag(r))
    if np.linalg.det(q) < 0:
        q[:, 0] = -q[:, 0]
    return q.astype(np.float32)
