"""A sequence to learn from: frames at their size, and references of each at the picture's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families.target_grid import dilated
from stillray.frame import Frame
from stillray.io.exr.read import read_exr
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import FeatureFilters
from stillray.stages import features
from stillray.stages.accumulate import bounded
from stillray.stages.repair import repair_feature
from stillray_training.blocks import frame_paths
from stillray_training.simulate.sequence import RECORD


@dataclass(frozen=True, kw_only=True, eq=False)
class Clip:
    """A sequence, one entry a frame.

    Attributes
    ----------
    frames
        With every buffer, zeros where a sequence has no roughness or specular albedo; motion is
        dilated.
    references
        Color, albedo and specular albedo of the picture's size; None where there is none.
    exposures
        1 / radiance, steadied as the runtime does.
    depth_units
        See `stillray.stages.features.depth_scale`.
    still
        Whether nothing moves but the jitter: all frames have the same reference.
    """

    frames: list[Frame]
    references: list[Frame | None]
    exposures: list[float]
    depth_units: list[float]
    still: bool = False


_CLEANER = 4.0  # octaves of noise that means may lose
_NEEDED = ("motion", "depth", "albedo", "normal")
_GUIDES = (*_NEEDED, "roughness", "specular_albedo")


def load_clip(sequence: Path, spec: ModelSpec, strips: Strips) -> Clip:
    """Read a rendered sequence; targets, where there are some, take the place of references.

    Where nothing moves, the last frame's reference is that of all.

    Raises
    ------
    InputError
        The last frame has no reference, one is not of the picture's size or has no albedo, or a
        frame has no guides.
    """
    assert isinstance(spec.decoder, FeatureFilters)
    record = json.loads((sequence / RECORD).read_text())
    paths = frame_paths(sequence)
    frames = []
    for path in paths:
        frame = _frame(path, record)
        assert frame.motion is not None
        assert frame.depth is not None
        frames.append(replace(frame, motion=dilated(frame.motion, frame.depth, strips)))
    height, width = (length * spec.decoder.scale for length in frames[0].shape)

    def reference(path: Path) -> Frame | None:
        return _reference(sequence, _number(path), (height, width))

    last, shared = reference(paths[-1]), _stands_still(record)
    if last is None:
        raise InputError(f"{sequence}: the last frame must have a reference, it is missing")
    references = [*(last if shared else reference(path) for path in paths[:-1]), last]
    return clip_of(frames, references, spec, still=shared and _is_jittered(frames))


def clip_of(
    frames: Sequence[Frame], references: list[Frame | None], spec: ModelSpec, *, still: bool
) -> Clip:
    """A clip of frames with depth, exposed and bounded one after the other as the runtime does."""
    bounded_frames: list[Frame] = []
    exposures: list[float] = []
    units: list[float] = []
    for frame in frames:
        assert frame.depth is not None
        own = features.frame_exposure(features.luminance(frame.color), spec.transfer)
        if exposures:
            own = features.steady_exposure(own, exposures[-1], spec.transfer)
        exposures.append(own)
        color = bounded(frame.color, own, spec.transfer, spec.temporal)
        bounded_frames.append(replace(frame, color=color))
        units.append(features.depth_scale(frame.depth))
    return Clip(
        frames=bounded_frames,
        references=references,
        exposures=exposures,
        depth_units=units,
        still=still,
    )


def _frame(path: Path, record: dict[str, Any]) -> Frame:
    """A frame with every guide, repaired as the runtime hands them on, and its jitter.

    Roughness and specular albedo are zeros where there are none, and jitter is where a record says
    nothing: as the network reads what is not given.
    """
    frame = read_exr(path)
    if not frame.given.issuperset(_NEEDED):
        raise InputError(f"{path}: must have {', '.join(_NEEDED)}")
    nothing = np.zeros((*frame.shape, 3), np.float32)
    rough, glossy = (
        other if guide is None else repair_feature(guide, 0.0, 1.0)
        for guide, other in ((frame.roughness, nothing[..., 0]), (frame.specular_albedo, nothing))
    )
    frame = replace(frame, roughness=rough, specular_albedo=glossy)
    if frame.jitter is not None:
        return frame
    cameras = record.get("cameras")
    jitter = cameras[_number(path)]["jitter"] if cameras else (0, 0)
    return replace(frame, jitter=np.array(jitter, np.float32))


def _stands_still(record: dict[str, Any]) -> bool:
    """Whether neither the camera nor anything else of a sequence moves, as far as it tells."""
    places = [camera.get("camera_to_world") for camera in record.get("cameras", ())]
    moving = record.get("moving", True)
    return not moving and bool(places) and all(place == places[0] for place in places)


def _is_jittered(frames: Sequence[Frame]) -> bool:
    """Whether samples lie elsewhere in their pixels from frame to frame."""
    places = [frame.jitter.tolist() for frame in frames if frame.jitter is not None]
    return any(place != places[0] for place in places)


def _number(path: Path) -> int:
    return int(path.stem.split("_")[1])


def _reference(sequence: Path, number: int, size: tuple[int, int]) -> Frame | None:
    """What a frame should show, of the picture's size; None where there is none."""
    path = sequence / f"ref_{number:04d}.exr"
    if not path.is_file():
        return None
    reference = read_exr(path)
    height, width = size
    target = sequence / f"target_{number:04d}.exr"
    shown = read_exr(target) if target.is_file() else reference
    albedo = shown.albedo if reference.albedo is None else reference.albedo
    larger = reference.shape[0] // height
    fits = larger > 0 and reference.shape == (larger * height, larger * width)
    if not fits or albedo is None:
        raise InputError(f"{path}: must have albedo and the size {size} or a multiple of it")
    glossy = reference.specular_albedo
    if glossy is None:
        glossy = np.zeros_like(albedo)

    def mean(image: np.ndarray) -> np.ndarray:
        # one rendered for a larger picture serves: a pixel is the mean of those that it covers
        return cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA)

    return Frame(color=mean(shown.color), albedo=mean(albedo), specular_albedo=mean(glossy))


def of_several_samples(clip: Clip, count: int, rng: np.random.Generator) -> Clip:
    """A still clip of ``count`` frames that are means of as many of its own as there are for each,
    or fewer.

    Their samples lie all over their pixels, as those of most renderers do, so they have no jitter.
    Half of the clips are nearer to their reference, up to a sixteenth of the noise.
    """
    most = len(clip.frames) // count
    each = int(2 ** rng.uniform(0, np.log2(most + 1)))
    noise = 2 ** -rng.uniform(0, _CLEANER) if rng.random() < 0.5 else 1.0
    first = int(rng.integers(len(clip.frames) - count * each + 1))
    size, reference = clip.frames[0].shape[::-1], clip.references[0]
    assert reference is not None  # of a still clip
    wanted = cv2.resize(reference.color, size, interpolation=cv2.INTER_AREA)
    frames = []
    for start in range(first, first + count * each, each):
        frame = _mean(clip.frames[start : start + each])
        frames.append(replace(frame, color=wanted + np.float32(noise) * (frame.color - wanted)))
    return replace(
        clip,
        frames=frames,
        references=clip.references[:count],
        exposures=clip.exposures[:count],
        depth_units=clip.depth_units[:count],
    )


def _mean(frames: list[Frame]) -> Frame:
    """One frame of the samples of several of the same view."""

    def of(name: str) -> np.ndarray:
        found: np.ndarray = np.mean([getattr(frame, name) for frame in frames], axis=0)
        return found.astype(np.float32)

    buffers: dict[str, Any] = {name: of(name) for name in ("color", *_GUIDES)}
    return replace(frames[0], **buffers, jitter=np.zeros(2, np.float32))
