"""Cycles as its users have it: its defaults, no denoiser, every pass that a denoiser takes."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import bpy


def prepare(size: tuple[int, int]) -> Any:
    """An empty scene with settings and passes; returns it.

    Left as Blender has them: pixel filter (Blackman-Harris, 1.5 pixels), clamping (indirect 10),
    bounces, light tree. Off: adaptive sampling and denoising, for the number of samples to be
    the same everywhere; and motion blur, which Cycles' motion vectors exclude.

    Parameters
    ----------
    size
        Width and height in pixels.
    """
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine, scene.cycles.device = "CYCLES", "CPU"
    scene.cycles.use_denoising = scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_animated_seed = False
    scene.render.use_motion_blur = False
    scene.render.use_persistent_data = True
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_vector = True
    layer.cycles.denoising_store_passes = True
    image = scene.render.image_settings
    image.media_type = "MULTI_LAYER_IMAGE"
    image.file_format, image.color_depth, image.exr_codec = "OPEN_EXR_MULTILAYER", "16", "ZIP"
    return scene


def render(path: Path, *, frame: int, samples: int, seed: int, noise: float = 0.0) -> None:
    """Write one frame; keep it if it is there already, so that a run can be taken up again.

    Parameters
    ----------
    path
        The multilayer EXR.
    frame
        Number on Blender's time line.
    samples
        Samples a pixel.
    seed
        Other seeds give other noise: input and reference must not share any.
    noise
        Cycles' noise threshold, at which a pixel takes no more samples; 0 for as many everywhere.
    """
    if path.exists():
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    scene = bpy.context.scene
    scene.cycles.use_adaptive_sampling, scene.cycles.adaptive_threshold = noise > 0, noise
    scene.frame_set(frame)
    scene.cycles.samples, scene.cycles.seed = samples, seed
    unfinished = path.with_name(f".{path.name}")
    scene.render.filepath = str(unfinished)
    start = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    unfinished.rename(path)
    print(f"{path}: {samples} samples a pixel, {time.perf_counter() - start:.1f} s", flush=True)
