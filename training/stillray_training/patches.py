"""Training patches, drawn from examples and augmented."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stillray.errors import InputError
from stillray.model_spec import ModelSpec
from stillray.model_spec.planes import PIXEL_FILTER
from stillray.stages import features as encode
from stillray_training.examples import NOISY, QUIET, STILL, Example
from stillray_training.redrawn import Redrawn

_SAMPLES_KNOWN = 0.5  # share of patches whose frames say how many samples they have
_FILTER_KNOWN = 0.6  # and, to networks that ask, what pixel filter they have
_AT_BORDER = 0.3  # share of patches that touch the top or bottom, and the left or right
#: Share of patches that are the one of two with more edges: errors are there.
BUSIER = 0.5
#: Height and width of the patches of `small_share`: a level or two of a pyramid has a pixel then.
SMALL = (32, 48, 64)
_FLAT = 0.05  # relative contrast of a reference patch below which there is little to learn


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
    recalled: np.ndarray  # what the last output weighs in the resolve, a share
    reference: np.ndarray
    exposure: np.ndarray  # (n, 1, 1, 1)


class PatchSampler:
    """Draws augmented patches; the n-th batch depends on the seed and n only.

    Parameters
    ----------
    examples
        What to draw from; may be replaced one by one between batches.
    spec
        The model's specification.
    redrawn
        The same examples, where they change with the steps.

    Raises
    ------
    InputError
        An example is smaller than a patch.
    """

    def __init__(
        self, examples: list[Example], spec: ModelSpec, redrawn: Redrawn | None = None
    ) -> None:
        size = spec.training.patch
        for one in examples:
            if min(one.reference.shape[:2]) < size:
                raise InputError(
                    f"{one.sequence}: must have {size} x {size} pixels or more, the size of a "
                    f"patch, got {one.reference.shape[:2]}"
                )
        # places, not examples: those are replaced when previous outputs are renewed
        self._examples, self._redrawn = examples, redrawn
        self._places: dict[str, list[int]] = {}
        for place, one in enumerate(examples):
            self._places.setdefault(one.kind, []).append(place)
        self._spec = spec

    def batch(self, step: int) -> Batch:
        """The batch of one training step."""
        recipe = self._spec.training
        rng = np.random.default_rng([recipe.seed, step])
        size = recipe.patch
        if recipe.small_share and rng.random() < recipe.small_share:
            size = min(size, int(rng.choice(SMALL)))
        patches = [self._patch(size, step, rng) for _ in range(recipe.batch)]
        return Batch(**{name: np.stack([patch[name] for patch in patches]) for name in patches[0]})

    def _patch(self, size: int, step: int, rng: np.random.Generator) -> dict[str, np.ndarray]:
        recipe = self._spec.training
        drawn = rng.random()
        kind = QUIET if drawn < recipe.quiet_share else NOISY
        if recipe.quiet_share <= drawn < recipe.quiet_share + recipe.still_share:
            kind = STILL
        places = self._places.get(kind) or self._places[NOISY]
        example, window, edges = self._window(places, size, step, rng)
        if rng.random() < BUSIER:
            other, elsewhere, more = self._window(places, size, step, rng)
            if more > edges:
                example, window = other, elsewhere
        return self._augment(example, window, rng)

    def _window(
        self, places: list[int], size: int, step: int, rng: np.random.Generator
    ) -> tuple[Example, tuple[slice, slice], float]:
        """A patch of one of some examples, in which there is something to learn, and its edges."""
        for _ in range(8):
            place = places[rng.integers(len(places))]
            example = self._redrawn.at(place, step) if self._redrawn else self._examples[place]
            height, width = example.reference.shape[:2]
            top, left = (_offset(rng, length - size) for length in (height, width))
            window = (slice(top, top + size), slice(left, left + size))
            light = example.reference[window].mean(axis=-1)
            if light.std() > _FLAT * light.mean() and light.mean() > 0:
                break
        shown = np.log(light + 0.05 / example.exposure)
        edges = np.abs(np.diff(shown, axis=0)).mean() + np.abs(np.diff(shown, axis=1)).mean()
        return example, window, float(edges)

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
        by = turn(example.demodulation_albedo[window])[..., order].astype(np.float32)
        demodulation: np.ndarray | None = by
        if rng.random() < recipe.drop_feature:
            # no albedo: what is filtered is radiance
            mean[..., :3] *= by
            sample[..., :3] *= by
            remodulation, albedo, demodulation = np.ones_like(by), None, None
        if rng.random() < recipe.drop_feature:
            normal = None
        if rng.random() < recipe.drop_feature:
            depth = None
        # whoever does not say how many samples a frame has is taken to have one, and so is albedo:
        # see `stillray.pipeline.prefilter.guides_of`
        known = rng.random() < _SAMPLES_KNOWN and recipe.layer != "albedo"
        spp = example.spp if known else 1.0
        spread = None
        if PIXEL_FILTER in spec.network.features and rng.random() < _FILTER_KNOWN:
            spread = example.filter_spread
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
            filter_spread=spread,
            demodulation_albedo=demodulation,
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
            "recalled": _recalled(example, window, turn),
            "reference": _chw(reference),
            "exposure": np.full((1, 1, 1), exposure, np.float32),
        }


def _recalled(
    example: Example,
    window: tuple[slice, slice],
    turn: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """What the last output weighs in a patch, ``(1, h, w)``."""
    if example.recalled is None:
        height, width = example.reference[window].shape[:2]
        return np.ones((1, height, width), np.float32)
    return turn(example.recalled[window])[None].astype(np.float32)


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
