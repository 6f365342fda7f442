# SPDX-License-Identifier: GPL-3.0-or-later
"""stillray in Blender: clean Cycles frames as they are rendered, or rendered sequences later.

Nothing of Blender is changed but what `register` adds, and `unregister` takes all of it away.
"""

from . import hook, operators, panel, settings

_PARTS = (settings, operators, panel, hook)


def register() -> None:
    for part in _PARTS:
        part.register()


def unregister() -> None:
    for part in reversed(_PARTS):
        part.unregister()
