# SPDX-License-Identifier: GPL-3.0-or-later
"""The panel in the Render properties."""

import bpy

from . import passes


class StillrayPanel(bpy.types.Panel):
    bl_idname = "RENDER_PT_stillray"
    bl_label = "stillray"
    bl_space_type = "PROPERTIES"
    bl_region_type = "WINDOW"
    bl_context = "render"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context) -> bool:
        return context.engine == "CYCLES"

    def draw_header(self, context) -> None:
        self.layout.prop(context.scene.stillray, "enabled", text="")

    def draw(self, context) -> None:
        scene, layout = context.scene, self.layout
        layout.use_property_split, layout.use_property_decorate = True, False
        settings = layout.column()
        settings.active = scene.stillray.enabled
        settings.prop(scene.stillray, "quality")
        settings.prop(scene.stillray, "ensemble")
        settings.prop(scene.stillray, "temporal")
        lacks = {
            f"{layer.name}: {lack}"
            for layer in scene.view_layers
            if layer.use
            for lack in passes.missing(scene, layer)
        }
        for lack in sorted(lacks):
            layout.label(text=lack, icon="ERROR")
        layout.operator("stillray.set_up_passes")
        layout.operator("stillray.denoise_animation")


def register() -> None:
    bpy.utils.register_class(StillrayPanel)


def unregister() -> None:
    bpy.utils.unregister_class(StillrayPanel)
