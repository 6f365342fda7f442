# SPDX-License-Identifier: GPL-3.0-or-later
"""Denoises what Cycles has rendered, in memory, before anybody sees or saves it.

Blender has no place for denoisers of others, so two methods of Cycles' engine are wrapped:
``render`` tells what is rendered, once a view layer, and after ``render_frame_finish`` all view
layers and eyes are in the result, those too that Cycles keeps on disk meanwhile (renders larger
than its tiles). A render is never broken: what goes wrong is told, and the picture stays noisy.
"""

import atexit
import sys
import traceback
from contextlib import contextmanager
from typing import NamedTuple

import bpy
from bpy.app.handlers import persistent

from . import passes, result
from .streams import Shown, Streams

streams = Streams()
said: set[str] = set()  # once a render is enough


class _Rendered(NamedTuple):
    """What is known of a view layer while it is rendered."""

    scene: bpy.types.Scene
    layer: str
    camera: str
    number: int
    samples: int
    filter_spread: float


def denoise_result(engine, rendered: list[_Rendered]) -> None:
    """Clean every view layer and eye of an engine's result."""
    got = engine.get_result()
    size = got.resolution_x, got.resolution_y
    layers = {layer.name: layer for layer in got.layers}
    for job in rendered:
        for view in got.views:
            if engine.test_break():
                return
            engine.update_stats("stillray", " ".join(("Denoising", job.layer, view.name)))
            settings = job.scene.stillray
            frame = result.frame_of(
                layers[job.layer],
                size,
                view.name,
                job=job,
                motion=settings.temporal and not job.scene.render.use_motion_blur,
            )
            shown = Shown(job.scene.name, job.layer, view.name, job.camera)
            picture = streams.denoise(
                frame, shown, job.number, settings, lambda _: not engine.test_break()
            )
            result.put_picture(layers[job.layer], size, view.name, picture)


def _layer_rendered(engine, scene, layer) -> None:
    """Take note of a view layer that Cycles has rendered."""
    if engine.is_preview or not scene.stillray.enabled or not layer.cycles.use_denoising:
        return
    for lack in passes.missing(scene, layer):
        _tell(engine, f"{layer.name}: {lack}")
    job = _Rendered(
        scene,
        layer.name,
        "" if scene.camera is None else scene.camera.name,
        scene.frame_current,
        passes.samples_of(scene, layer),
        passes.filter_spread_of(scene),
    )
    # kept with the engine, as Cycles keeps its session: several renders may go on at once
    engine.stillray_rendered = [*getattr(engine, "stillray_rendered", []), job]


def _frame_rendered(engine) -> None:
    rendered, engine.stillray_rendered = getattr(engine, "stillray_rendered", []), []
    if rendered and not engine.test_break():
        denoise_result(engine, rendered)


def _wrapped_render(original):
    def render(engine, depsgraph):  # Blender counts the arguments
        # Cycles frees the graph when it has rendered, and then it may know no scene
        scene, layer = depsgraph.scene, depsgraph.view_layer
        original(engine, depsgraph)
        with _told(engine):
            _layer_rendered(engine, scene, layer)

    return render


def _wrapped_finish(original):
    def render_frame_finish(engine):
        original(engine)
        with _told(engine):
            _frame_rendered(engine)

    return render_frame_finish


@contextmanager
def _told(engine):
    """What goes wrong inside is told: a render must go on, whatever it is."""
    try:
        yield
    except Exception as error:
        if type(error).__name__ == "Cancelled":  # Esc, or the render window was closed
            return
        if type(error).__name__ != "InputError":
            traceback.print_exc()
        _tell(engine, f"not denoised: {error or type(error).__name__}")


def _tell(engine, text: str) -> None:
    line = f"stillray: {text}"
    engine.report({"WARNING"}, line)  # an error would end an animation before the frame is saved
    if line not in said:
        said.add(line)
        print(line, flush=True)


def _cycles():
    """Cycles' engine; None while its add-on is off."""
    return getattr(sys.modules.get("cycles"), "CyclesRender", None)


def _wrap() -> None:
    engine = _cycles()
    for name, wrapped in _METHODS.items():
        method = getattr(engine, name, None)
        if method is not None and not hasattr(method, _MARK):
            ours = wrapped(method)
            setattr(ours, _MARK, method)
            setattr(engine, name, ours)


@persistent
def _on_init(*_) -> None:
    said.clear()
    _wrap()  # Cycles' add-on may have been off until now
    if not bpy.app.background:
        streams.forget()  # anything may have changed; a command line goes on where it was


@persistent
def _on_end(*_) -> None:
    if not bpy.app.background:
        streams.close()


_METHODS = {"render": _wrapped_render, "render_frame_finish": _wrapped_finish}
_MARK = "stillray_original"  # an attribute of our methods: the one to put back
_HANDLERS = (("render_init", _on_init), ("render_complete", _on_end), ("render_cancel", _on_end))


def register() -> None:
    _wrap()
    atexit.register(streams.close)
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).append(handler)


def unregister() -> None:
    for name, handler in _HANDLERS:
        getattr(bpy.app.handlers, name).remove(handler)
    engine = _cycles()
    for name in _METHODS:
        method = getattr(engine, name, None)
        if hasattr(method, _MARK):
            setattr(engine, name, getattr(method, _MARK))
    streams.close()
    atexit.unregister(streams.close)
