"""Samples of a heavy tail, painted into sequences: caustics in frame after frame."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray_training.draws import log_uniform
from stillray_training.heavy_tail import Tail, draw_tail, frame_with, reference_with
from stillray_training.small_lamps import usual_light
from stillray_training.upscaling.clip import Clip, clip_of

SAMPLES = (1.0, 32.0)  # a pixel of a frame: the more, the more of its pixels have a rare one


def with_tail(clip: Clip, spec: ModelSpec, rng: np.random.Generator) -> Clip:
    """A clip in which a part of the light comes as few samples that are far brighter than others.

    What they light is as bright as its albedo, which goes where surfaces go; how often they come
    stays where it is in the frame. References are given all of their mean: what a filter leaves of
    it is put back afterwards (`stillray.stages.rare_light`) where there are hundreds of pixels.

    Parameters
    ----------
    clip
        Whose last frame has a reference.
    spec
        The model's: how far samples are bounded, and exposures.
    rng
        Draws how often they come, how bright they are, and samples a pixel.
    """
    shown = clip.references[-1]
    assert shown is not None
    shape = clip.frames[0].shape
    like = cv2.resize(shown.color, shape[::-1], interpolation=cv2.INTER_AREA)
    tail, usual = draw_tail(like, rng), np.float32(usual_light(like))
    samples = log_uniform(rng, SAMPLES)
    frames = [
        frame_with(frame, replace(tail, light=usual * _albedo(frame)), samples, rng)
        for frame in clip.frames
    ]
    references = [
        None if reference is None else _reference(reference, tail, usual)
        for reference in clip.references
    ]
    return clip_of(frames, references, spec, still=clip.still)


def _reference(reference: Frame, tail: Tail, usual: np.float32) -> Frame:
    often = cv2.resize(tail.often, reference.shape[::-1], interpolation=cv2.INTER_LINEAR)
    own = replace(tail, often=often, light=usual * _albedo(reference))
    return replace(reference, color=reference_with(reference.color, own))


def _albedo(frame: Frame) -> np.ndarray:
    assert frame.albedo is not None
    return frame.albedo
