"""Training patches from rendered sequences.

A sequence goes through the runtime's own repair, demodulation, reprojection and accumulation, so
that a network learns from exactly what it will see. Its last frame is accumulated from several
starting frames: pixels then hold one sample, a few, or many.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stillray.arrays.strips import Strips, interleave
from stillray.io.exr.read_write import read_exr
from stillray.model_spec import ModelSpec
from stillray.pipeline.denoiser import Denoiser
from stillray.stages import features as encode
from stillray.stages.prepare import History, Prepared, prepare
from stillray.stages.previous_output import recalled
from stillray_training.quiet import quiet_frame
from stillray_training.simulate.sequence import is_complete

STARTS = (1, 3, 8)  # frames accumulated before the last one is learned from
_AT_BORDER = 0.3  # share of patches that touch the top or bottom, and the left or right
_FLAT = 0.05  # relative contrast of a reference patch below which there is little to learn


@dataclass(frozen=True, kw_only=True, eq=False)
class Example:
    """The last frame of a sequence as the network will meet it, and its reference."""

    mean: np.ndarray  # (h, w, 4) irradiance and samples
    sample: np.ndarray  # (h, w, 4) irradiance of this frame and what it is worth
    exposure: float
    divisor: np.ndarray  # (h, w, 3) what radiance was divided by
    modulator: np.ndarray  # (h, w, 3) what the result is multiplied by
    albedo: np.ndarray  # (h, w, 3)
    normal: np.ndarray  # (h, w, 3)
    depth: np.ndarray  # (h, w)
    depth_unit: float
    previous: np.ndarray  # (h, w, 4) radiance of the previous output, and how much of it is valid
    reference: np.ndarray  # (h, w, 3) radiance
    quiet: bool = False  # see `stillray_training.quiet`


@dataclass(frozen=True, kw_only=True, eq=False)
class Batch:
    """Patches as the network and the decoder take them, ``(n, c, h, w)`` float32."""

    features: np.ndarray
    irradiance: np.ndarray
    samples: np.ndarray
    new: np.ndarray
    worth: np.ndarray
    divisor: np.ndarray  # what the result is multiplied by
    previous: np.ndarray
    valid: np.ndarray
    reference: np.ndarray
    exposure: np.ndarray  # (n, 1, 1, 1)


def find_sequences(folder: Path) -> list[Path]:
    """Folders of finished sequences, sorted by name."""
    return sorted(path for path in folder.iterdir() if path.is_dir() and is_complete(path))


def load_examples(sequence: Path, spec: ModelSpec, strips: Strips) -> list[Example]:
    """The last frame of a sequence, accumulated from each of the starting frames; then, quiet."""
    (reference_path,) = sorted(sequence.glob("ref_*.exr"))[-1:]
    frames = [read_exr(path) for path in sorted(sequence.glob("frame_*.exr"))]
    reference = read_exr(reference_path).color
    # of its own for every sequence, the same every time
    rng = np.random.default_rng([spec.training.seed, zlib.crc32(sequence.name.encode())])
    runs = [frames[-count:] for count in STARTS]
    runs.append([quiet_frame(frames[-1], reference, rng)])
    examples: list[Example] = []
    for run in runs:
        history: History | None = None
        for frame in run:
            prepared = prepare(frame, spec, history, strips, {}, wants_sample=True)
            history = prepared.history
        assert history is not None
        assert prepared.divisor is not None
        assert prepared.modulator is not None
        assert prepared.albedo is not None
        assert prepared.normal is not None
        assert prepared.depth is not None
        shared = examples[0] if examples else None  # one frame: its features are held once
        examples.append(
            Example(
                mean=history.mean,
                sample=_sample(prepared),
                exposure=history.exposure,
                divisor=shared.divisor if shared else prepared.divisor,
                modulator=prepared.modulator,
                albedo=shared.albedo if shared else prepared.albedo,
                normal=shared.normal if shared else prepared.normal,
                depth=shared.depth if shared else prepared.depth,
                depth_unit=prepared.depth_unit,
                previous=np.broadcast_to(np.float32(0), history.mean.shape),
                reference=reference,
                quiet=len(examples) == len(STARTS),
            )
        )
    return examples


def _sample(prepared: Prepared) -> np.ndarray:
    if prepared.sample is None:
        return prepared.history.mean
    return interleave(prepared.sample, out=np.empty_like(prepared.history.mean))


def previous_outputs(sequence: Path, model: Path, strips: Strips) -> list[np.ndarray]:
    """What a model, run as users run it, remembers at the last frame of a sequence.

    Returns
    -------
    list of (h, w, 4) arrays
        For each of the starting frames: radiance of the previous output at the pixels of the last
        frame, and how much of it is valid.
    """
    frames = [read_exr(path) for path in sorted(sequence.glob("frame_*.exr"))]
    remembered = []
    with Denoiser(model, threads=1) as denoiser:
        for count in STARTS:
            denoiser.reset()
            for frame in frames[-count:-1]:
                denoiser.denoise(frame)
            prepared = prepare(
                frames[-1],
                denoiser.model.spec,
                denoiser.history,
                strips,
                {},
                wants_sample=True,
                recalls=True,
            )
            previous = recalled(denoiser.history, prepared, denoiser.model.spec, strips, {})
            remembered.append(
                np.zeros((*frames[-1].shape, 4), np.float32) if previous is None else previous
            )
    return remembered


class PatchSampler:
    """Draws augmented patches; the n-th batch depends on the seed and n only.

    Parameters
    ----------
    examples
        What to draw from; may be replaced one by one between batches.
    spec
        The model's specification.
    """

    def __init__(self, examples: list[Example], spec: ModelSpec) -> None:
        # places, not examples: those are replaced when previous outputs are renewed
        self._examples = examples
        self._noisy = [place for place, one in enumerate(examples) if not one.quiet]
        self._quiet = [place for place, one in enumerate(examples) if one.quiet]
        self._spec = spec

    def batch(self, step: int) -> Batch:
        """The batch of one training step."""
        recipe = self._spec.training
        rng = np.random.default_rng([recipe.seed, step])
        patches = [self._patch(rng) for _ in range(recipe.batch)]
        return Batch(**{name: np.stack([patch[name] for patch in patches]) for name in patches[0]})

    def _patch(self, rng: np.random.Generator) -> dict[str, np.ndarray]:
        size = self._spec.training.patch
        quiet = rng.random() < self._spec.training.quiet_share
        places = self._quiet if quiet else self._noisy
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
        modulator = turn(example.modulator[window])[..., order]
        previous = turn(example.previous[window]).copy()
        previous[..., :3] = previous[..., order] * gain
        albedo: np.ndarray | None = turn(example.albedo[window])[..., order]
        normal: np.ndarray | None = turn(example.normal[window]) @ _random_rotation(rng)
        depth: np.ndarray | None = turn(example.depth[window])
        if rng.random() < recipe.drop_feature:
            # no albedo: what is filtered is radiance
            divisor = turn(example.divisor[window])[..., order]
            mean[..., :3] *= divisor
            sample[..., :3] *= divisor
            modulator, albedo = np.ones_like(divisor), None
        if rng.random() < recipe.drop_feature:
            normal = None
        if rng.random() < recipe.drop_feature:
            depth = None
        stops = rng.uniform(-recipe.exposure_stops, recipe.exposure_stops)
        exposure = float(example.exposure * 2**stops)
        light = encode.tone_map(encode.luminance(mean), exposure)
        features = np.zeros((len(spec.network.features), *light.shape), np.float32)
        encode.feature_planes(
            mean,
            encode.local_luminance(light, spec.transfer),
            exposure,
            spec.temporal,
            spec.network.features,
            sample=encode.luminance(sample),
            albedo=albedo,
            normal=normal,
            depth=depth,
            depth_unit=example.depth_unit,
            out=features,
        )
        encode.previous_planes(previous, modulator, exposure, spec.network.features, out=features)
        return {
            "features": features,
            "irradiance": _chw(mean[..., :3]),
            "samples": mean[None, ..., 3],
            "new": _chw(sample[..., :3]),
            "worth": sample[None, ..., 3],
            "divisor": _chw(modulator),
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
