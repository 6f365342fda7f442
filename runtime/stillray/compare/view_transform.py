"""How scene-linear radiance becomes what a display shows, as a table that a page can carry."""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import cache

import numpy as np

from stillray.io.exr.openimageio import openimageio

#: Nodes a side of the table. With 33, greys come out within 1/255 of the transform itself, 99 of
#: 100 colours within 2/255, those far outside of the display's gamut within 10/255.
NODES = 33
#: A node's place, in [0, 1], is ``log2(STEEPNESS * radiance + 1) / STOPS``: evenly spaced in light
#: that is bright, and down to 0. The last node is at 128 times white.
STEEPNESS, STOPS = 64, 13
_CONFIG = "ocio://default"  # comes with OpenColorIO, needs no file
_SPACE = "Linear Rec.709 (sRGB)"


@dataclass(frozen=True, kw_only=True, eq=False)
class ViewTransform:
    """A view of OpenColorIO, tabulated.

    Attributes
    ----------
    name
        As OpenColorIO calls the view.
    table
        Compressed bytes: a plane each of red, green and blue, of ``NODES`` cubed, blue's place
        running fastest.
    """

    name: str
    table: bytes


@cache
def aces_view() -> ViewTransform | None:
    """The default view of OpenColorIO's ACES configuration on an sRGB display.

    Radiance is taken to have the primaries of Rec. 709. None where OpenImageIO was built without
    OpenColorIO, or with one that has no such configuration.
    """
    oiio = openimageio()
    config = oiio.ColorConfig(_CONFIG)
    if config.geterror() or _SPACE not in config.getColorSpaceNames():
        return None
    display = config.getDefaultDisplayName()
    view = config.getDefaultViewName(display)
    places = np.linspace(0, 1, NODES)
    light = ((2 ** (STOPS * places) - 1) / STEEPNESS).astype(np.float32)
    lattice = np.stack(np.meshgrid(light, light, light, indexing="ij"), -1)
    shown = oiio.ImageBufAlgo.ociodisplay(
        oiio.ImageBuf(lattice.reshape(1, -1, 3)), display, view, _SPACE,
        unpremult=False, colorconfig=_CONFIG,
    )  # fmt: skip
    if shown.has_error:
        return None
    steps = np.rint(255 * np.clip(shown.get_pixels(oiio.FLOAT), 0, 1)).astype(np.uint8)
    return ViewTransform(name=view, table=zlib.compress(steps.reshape(-1, 3).T.tobytes()))
