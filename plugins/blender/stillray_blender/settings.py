# SPDX-License-Identifier: GPL-3.0-or-later
"""What an artist sets, kept with the scene."""

import bpy


class StillraySettings(bpy.types.PropertyGroup):
    enabled: bpy.props.BoolProperty(
        name="stillray",
        description="Denoise every final render of this scene before it is saved",
        default=False,
    )
    quality: bpy.props.EnumProperty(
        name="Quality",
        description="Which model denoises",
        items=(
            ("high", "High", "The best picture"),
            ("balanced", "Balanced", "Half the time of High"),
            ("fast", "Fast", "As quick as it gets"),
        ),
        default="high",
    )
    ensemble: bpy.props.IntProperty(
        name="Ensemble",
        description="How many pictures of a frame are averaged, for each of which the network sees "
        "it mirrored otherwise: a better picture, and each takes about as long as the first",
        default=1,
        min=1,
        max=4,
    )
    temporal: bpy.props.BoolProperty(
        name="Use Previous Frames",
        description="Animations: accumulate light along the Vector pass, for less noise",
        default=True,
    )


def register() -> None:
    bpy.utils.register_class(StillraySettings)
    bpy.types.Scene.stillray = bpy.props.PointerProperty(type=StillraySettings)


def unregister() -> None:
    del bpy.types.Scene.stillray
    bpy.utils.unregister_class(StillraySettings)
