"""Bright windows behind thin bars, painted into sequences of a camera that stays where it is."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.frame import Frame
from stillray.model_spec import ModelSpec
from stillray_training.bright_windows import Window, draw_window, reference_through
from stillray_training.fine_shapes import FINE, laid_over
from stillray_training.upscaling.clip import Clip, clip_of


def through_window(clip: Clip, spec: ModelSpec, rng: np.random.Generator) -> Clip:
    """A still clip with a window in it, which each frame meets where its samples lie.

    Parameters
    ----------
    clip
        Whose frames have jitter and every guide, and which nothing moves in.
    spec
        The model's: how far samples are bounded, and exposures.
    rng
        Draws the window.
    """
    reference, first = clip.references[0], clip.frames[0]
    assert reference is not None  # of a still clip
    scale = reference.shape[0] // first.shape[0]
    assert first.depth is not None
    size = reference.shape[::-1]
    depth = cv2.resize(first.depth, size, interpolation=cv2.INTER_NEAREST)
    window = draw_window(reference.color, depth, None, rng)
    frames = [frame_behind_bars(frame, window, scale) for frame in clip.frames]
    references: list[Frame | None] = [_reference(reference, window)] * len(clip.references)
    return clip_of(frames, references, spec, still=clip.still)


def frame_behind_bars(frame: Frame, window: Window, scale: int) -> Frame:
    """A frame of one sample a pixel at its jitter, with a window of the picture's size in it.

    Parameters
    ----------
    frame : (h, w)
        With jitter and every guide.
    window : (scale h, scale w)
        What it shows between bars has no specular albedo and no roughness.
    scale
        Pixels of the picture to one of the frame, along each axis.
    """
    assert frame.jitter is not None
    assert frame.albedo is not None
    assert frame.normal is not None
    assert frame.depth is not None
    assert frame.roughness is not None
    assert frame.specular_albedo is not None
    height, width = frame.shape
    x, y = map(float, frame.jitter)
    rows, columns = _points(height, y, scale), _points(width, x, scale)
    share = window.opening[rows][:, columns]
    met = share[..., None] > 0
    light = cv2.resize(window.light, (width, height), interpolation=cv2.INTER_AREA)
    lamp = window.lamp
    return replace(
        frame,
        color=np.where(met, lamp.radiance, frame.color * light[..., None]),
        albedo=np.where(met, lamp.albedo, frame.albedo),
        normal=np.where(met, lamp.normal, frame.normal),
        depth=np.where(share > 0, np.float32(lamp.distance), frame.depth),
        roughness=np.where(share > 0, np.float32(0), frame.roughness),
        specular_albedo=np.where(met, np.float32(0), frame.specular_albedo),
    )


def _points(size: int, jitter: float, scale: int) -> np.ndarray:
    """Along an axis of a frame, the points of an opening at which its samples lie."""
    samples = (np.arange(size) + 0.5 + jitter) * scale * FINE
    return np.clip(samples.astype(np.intp), 0, size * scale * FINE - 1)


def _reference(reference: Frame, window: Window) -> Frame:
    assert reference.albedo is not None
    assert reference.specular_albedo is not None
    share, none = window.lamp.coverage[..., None], np.float32(0)
    return replace(
        reference,
        color=reference_through(reference.color, window),
        albedo=laid_over(reference.albedo, window.lamp.albedo, share),
        specular_albedo=laid_over(reference.specular_albedo, none, share),
    )
