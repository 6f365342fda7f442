# SPDX-License-Identifier: GPL-3.0-or-later
"""What the panel's buttons do, and scripts can call."""

import bpy

from . import passes
from .sequence import SequenceJob, files_of


class StillraySetUpPasses(bpy.types.Operator):
    """Turn on the passes that stillray looks at, in every view layer that is rendered"""

    bl_idname = "stillray.set_up_passes"
    bl_label = "Set Up Passes"
    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        done = passes.set_up(context.scene)
        self.report({"INFO"}, "; ".join(done) or "All passes are on")
        return {"FINISHED"}


class StillrayDenoiseAnimation(bpy.types.Operator):
    """Denoise a rendered sequence of OpenEXR multilayer files; the renders stay as they are"""

    bl_idname = "stillray.denoise_animation"
    bl_label = "Denoise Rendered Frames"

    input_filepath: bpy.props.StringProperty(
        name="Input Filepath",
        description="File to denoise. If not specified, uses the render file path and frame range "
        "from the scene",
        subtype="FILE_PATH",
    )
    output_filepath: bpy.props.StringProperty(
        name="Output Filepath",
        description="If not specified, a folder named denoised beside the renders",
        subtype="FILE_PATH",
    )

    def execute(self, context):
        """Without a window: all at once."""
        if not self._begin(context):
            return {"CANCELLED"}
        self._job.wait()
        return self._end()

    def invoke(self, context, event):
        """From a button: in the background, with progress; Esc stops it."""
        if not self._begin(context):
            return {"CANCELLED"}
        manager = context.window_manager
        manager.progress_begin(0, self._job.count)
        self._timer = manager.event_timer_add(0.1, window=context.window)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._job.cancel()
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        job = self._job
        context.window_manager.progress_update(job.done)
        context.workspace.status_text_set(f"stillray: {job.done} of {job.count} frames (Esc stops)")
        if job.running:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
        return self._end()

    def cancel(self, context):
        """Blender closes meanwhile."""
        self._job.cancel()
        self._job.wait()

    def _begin(self, context) -> bool:
        from stillray import InputError

        scene = context.scene
        settings, motion = scene.stillray, not scene.render.use_motion_blur
        try:
            files = files_of(scene, self.input_filepath, self.output_filepath)
            lacks = passes.missing_in_file(files.sources[0], temporal=settings.temporal)
        except (FileNotFoundError, InputError) as error:
            self.report({"ERROR"}, f"stillray: {error}")
            return False
        for lack in lacks:
            self.report({"WARNING"}, f"stillray: {lack}")
        self._job = SequenceJob(
            files,
            quality=settings.quality,
            ensemble=settings.ensemble,
            temporal=settings.temporal,
            motion=motion,
            filter_spread=passes.filter_spread_of(scene),
        )
        self._job.start()
        return True

    def _end(self):
        job = self._job
        if job.error:
            self.report({"ERROR"}, f"stillray: {job.error}")
            return {"CANCELLED"}
        if job.cancelled:
            self.report({"WARNING"}, f"stillray: stopped after {job.done} of {job.count} frames")
            return {"CANCELLED"}
        self.report({"INFO"}, f"stillray: {job.done} frames denoised")
        return {"FINISHED"}


def register() -> None:
    for operator in (StillraySetUpPasses, StillrayDenoiseAnimation):
        bpy.utils.register_class(operator)


def unregister() -> None:
    for operator in (StillrayDenoiseAnimation, StillraySetUpPasses):
        bpy.utils.unregister_class(operator)
