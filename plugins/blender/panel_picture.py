# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of the panel in the documentation, taken of a Blender that draws on no screen.

Xvfb :77 -screen 0 900x1500x24 -fbdir FOLDER &
DISPLAY=:77 LIBGL_ALWAYS_SOFTWARE=1 blender --factory-startup --window-geometry 0 0 900 1500 \\
    --python plugins/blender/panel_picture.py -- FOLDER/Xvfb_screen0 docs/blender-panel.png

Blender 4.2 or later with a window: Debian 13 has 4.3. Only the panel is there, no wheels.
"""

import struct
import sys
import traceback
from pathlib import Path

import bpy
import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import stillray_blender
from stillray_blender.panel import StillrayPanel

SCREEN, TARGET = map(Path, sys.argv[sys.argv.index("--") + 1 :])
HIGH = 940  # pixels, from the first row of the area to the end of the panel


def properties():
    """The area that shows them: the largest."""
    areas = bpy.context.window_manager.windows[0].screen.areas
    return max(areas, key=lambda area: area.width * area.height)


def switch():
    properties().type = "PROPERTIES"


def show():
    area = properties()
    area.spaces[0].context = "RENDER"
    area.tag_redraw()


def set_up():
    bpy.ops.stillray.set_up_passes()
    properties().tag_redraw()


def save():
    """What Xvfb holds, in the format of xwd: a header of numbers, colours, rows of BGRX."""
    data = SCREEN.read_bytes()
    header = struct.unpack(">25I", data[:100])
    begin, wide, high, row, colours = (header[index] for index in (0, 4, 5, 12, 19))
    rows = np.frombuffer(data, np.uint8, row * high, begin + 12 * colours).reshape(high, row)
    screen = rows[:, : 4 * wide].reshape(high, wide, 4)[..., 2::-1]
    area = properties()
    top = high - area.y - area.height
    part = screen[top : top + HIGH, area.x : area.x + area.width]
    image = bpy.data.images.new("panel", part.shape[1], part.shape[0])
    pixels = np.ones((*part.shape[:2], 4), np.float32)
    pixels[..., :3] = part[::-1] / np.float32(255)
    image.pixels.foreach_set(pixels.ravel())
    image.filepath_raw, image.file_format = str(TARGET), "PNG"
    image.save()
    bpy.ops.wm.quit_blender()


def begin():
    StillrayPanel.bl_options = set()  # open, as after a click on it
    stillray_blender.register()
    bpy.context.preferences.view.show_splash = False
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    scene.stillray.enabled = True
    scene.cycles.samples, scene.cycles.use_adaptive_sampling = 4, False


def step(left=[switch, show, set_up, save]):  # noqa: B006  what is left is kept in it
    try:
        left.pop(0)()
    except Exception:
        traceback.print_exc()
        bpy.ops.wm.quit_blender()
    return 3.0 if left else None  # seconds: time to draw


begin()
bpy.app.timers.register(step, first_interval=3.0)
