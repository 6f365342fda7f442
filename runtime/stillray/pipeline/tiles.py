"""Frames in tiles, so that the network and the reconstruction fit into a given memory.

What is global to a frame is found on the whole frame: exposure, the unit of depth, the past at
each pixel. Only what takes most of the memory is done a tile at a time: features, network and
reconstruction. A tile overlaps its neighbours by all that a pixel can see, and begins where the
coarsest level of a pyramid does, so that its pixels are those of the whole frame but for rounding.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from numbers import Real

from stillray.arrays.tiles import Tile, tiles_of
from stillray.errors import InputError
from stillray.families.contract import Traits

#: Bytes of a process that has loaded a model and denoised nothing: 115 to 130 MiB, and spare.
BASE_BYTES = 150 << 20
#: Bytes a pixel of the whole frame whatever it holds, and for each channel that is given: the
#: floor under any bound. They hold the buffers of the frame in work and of the next, what is
#: prepared, and the picture on its way out. Runs of three frames of 1920 x 1080 with kpyr-5-still
#: took 117 bytes a pixel with color alone and 433 with 12 channels; a tenth is spare.
PIXEL_BYTES, CHANNEL_BYTES = 15, 39
#: And where frames have a past, which holds the history and the last frame's buffers: of 1280 x 720
#: 530 with 12 channels of kpyr-5, which remembers its output, too.
PAST_PIXEL_BYTES, PAST_CHANNEL_BYTES = 60, 44
#: Bytes a pixel of a tile: features, network and reconstruction. 860 of kpyr-5 in floats and 630 of
#: kpyr-5-still in integers, and a tenth to spare. With a past what integers spare is left: the
#: floor takes some of it (1,929 MiB of 1,950 were taken where it was counted, 2,313 of 2,300).
TILE_BYTES, INTEGER_TILE_BYTES = 950, 690
#: More where several views of the frame are averaged, each of which is done after the other:
#: 340 measured.
VIEWS_BYTES = 380
_LEAST_INNER = 64  # pixels, and no less than the overlap: smaller tiles would be little else
_UNITS = {"": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}


def parse_memory(text: str) -> int:
    """Bytes of ``2G``, ``1.5G``, ``800M`` (powers of 1024).

    Raises
    ------
    InputError
        The text is no such amount.
    """
    hit = re.fullmatch(r"(\d+(?:\.\d+)?)\s*([KMGT]?)(?:i?B)?", text.strip(), re.IGNORECASE)
    if hit is None:
        raise InputError(f"max-memory must be an amount such as 2G or 800M, got {text}")
    return int(float(hit[1]) * _UNITS[hit[2].upper()])


def check_memory(max_memory: float | None) -> None:
    """Raise `InputError` where what should be bytes, or None, is no number above 0."""
    number = isinstance(max_memory, Real) and not isinstance(max_memory, bool)
    if max_memory is not None and not (number and max_memory > 0):
        raise InputError(
            f"max_memory must be a number of bytes above 0, such as 4 << 30, or None, "
            f"got {max_memory!r}"
        )


@dataclass(frozen=True, kw_only=True)
class MemoryUse:
    """What decides how much memory a frame takes, beside its size.

    Attributes
    ----------
    channels
        Numbers a pixel that are given: 3 for color alone, 6 with albedo.
    past
        Whether frames are accumulated.
    integers
        Whether the network computes in integers.
    """

    channels: int
    past: bool = True
    integers: bool = False

    def floor_bytes(self, shape: tuple[int, int]) -> int:
        """Bytes that a process takes however small its tiles are, of ``(height, width)`` pixels."""
        pixel, channel = PIXEL_BYTES, CHANNEL_BYTES
        if self.past:
            pixel, channel = PAST_PIXEL_BYTES, PAST_CHANNEL_BYTES
        height, width = shape
        return BASE_BYTES + (pixel + channel * self.channels) * height * width

    def tile_bytes(self, traits: Traits) -> int:
        """Bytes that a pixel of a tile takes."""
        of_views = VIEWS_BYTES if traits.views > 1 else 0
        spares = self.integers and not self.past
        return (INTEGER_TILE_BYTES if spares else TILE_BYTES) + of_views


def plan_tiles(
    shape: tuple[int, int], use: MemoryUse, traits: Traits, max_memory: float | None, name: str
) -> list[Tile]:
    """The largest tiles with which a process stays below a memory.

    Parameters
    ----------
    shape
        Height and width, pixels.
    use
        What else decides how much memory the frame takes.
    traits
        Of the model's family.
    max_memory
        Bytes; None for one tile of the whole frame.
    name
        Of the model, for errors.

    Raises
    ------
    InputError
        The model cannot be cut into tiles, or the memory does not hold the buffers of the whole
        frame and one small tile.
    """
    height, width = shape
    multiple, halo = traits.tile_alignment, traits.tile_overlap
    if max_memory is None:
        return tiles_of(shape, max(shape), 0, multiple)
    if halo is None:
        raise InputError(f"max_memory must not be given with {name}, which takes whole frames")
    fixed, of_tile = use.floor_bytes(shape), use.tile_bytes(traits)
    least = min(max(_LEAST_INNER, halo) + 2 * halo, max(shape))
    needed = fixed + of_tile * min(least, height) * min(least, width)
    if max_memory < needed:
        raise InputError(
            f"max_memory must be {math.ceil(needed / _UNITS['M'])}M or more for {width} x {height} "
            f"pixels with {name}, got {_told(max_memory)}"
        )
    pixels = (max_memory - fixed) // of_tile
    if pixels >= height * width:
        return tiles_of(shape, max(shape), halo, multiple)
    return tiles_of(shape, max(int(pixels**0.5), least), halo, multiple)


def _told(amount: float) -> str:
    """An amount of bytes as it may be given, ``1.5M``."""
    for unit in "TGMK":
        if amount >= _UNITS[unit]:
            return f"{amount / _UNITS[unit]:.4g}{unit}"
    return f"{amount:g} bytes"
