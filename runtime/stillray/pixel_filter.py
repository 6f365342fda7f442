"""How wide a renderer's pixel filter is, as one number that its kinds share."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from stillray.errors import InputError

# Of the window 0.35875 - 0.48829 cos 2 pi t + 0.14128 cos 4 pi t - 0.01168 cos 6 pi t over its
# length (Harris 1978, 4 terms), by its integral and that times the square of the distance.
_WINDOW_DEVIATION = math.sqrt(
    1 / 12 + (-0.48829 + 0.14128 / 4 - 0.01168 / 9) / (2 * math.pi**2 * 0.35875)
)
#: Standard deviations in pixels, of a filter that a renderer calls so many pixels wide. Widths of
#: Gaussian and Blackman-Harris are those of Cycles (intern/cycles/scene/film.cpp): a Gaussian's
#: deviation is a quarter of it, a Blackman-Harris window reaches so far to each side.
_SPREADS: dict[str, Callable[[float], float]] = {
    "box": lambda width: width / math.sqrt(12),
    "triangle": lambda width: width / math.sqrt(24),
    "gaussian": lambda width: width / 4,
    "blackman-harris": lambda width: _WINDOW_DEVIATION * 2 * width,
}
_USUAL_WIDTHS = {"box": 1.0, "triangle": 2.0, "gaussian": 1.5, "blackman-harris": 1.5}
BOX_SPREAD = _SPREADS["box"](_USUAL_WIDTHS["box"])
SOFT_SPREAD = _SPREADS["blackman-harris"](_USUAL_WIDTHS["blackman-harris"])
#: Standard deviation of a filter, in pixels; beyond it is taken for a mistake.
MOST_SPREAD = 4.0


def filter_spread(kind: str, width: float | None = None) -> float:
    """Standard deviation of a pixel filter, in pixels.

    Parameters
    ----------
    kind
        ``box``, ``triangle``, ``gaussian`` or ``blackman-harris``.
    width
        Pixels, above 0: of a box or triangle all of it, of the others as Cycles has it. None: the
        usual, 1 of a box, 2 of a triangle, 1.5 of the others, which are Blender's.

    Raises
    ------
    InputError
        There is no such filter, or its width is none.
    """
    if kind not in _SPREADS:
        raise InputError(f"pixel filter must be of {', '.join(_SPREADS)}, got {kind}")
    width = _USUAL_WIDTHS[kind] if width is None else width
    if not 0 < width < math.inf:
        raise InputError(f"width of a pixel filter must be above 0 pixels, got {width:g}")
    return check_spread(_SPREADS[kind](width))


def cycles_spread(kind: str, width: float) -> float:
    """Standard deviation of a filter as Cycles calls it, in pixels.

    Parameters
    ----------
    kind
        ``BOX``, which Cycles takes for one pixel whatever its width, ``GAUSSIAN`` or
        ``BLACKMAN_HARRIS``.
    width
        Pixels, above 0.

    Raises
    ------
    InputError
        There is no such filter, or its width is none.
    """
    name = kind.lower().replace("_", "-")
    return filter_spread(name, None if name == "box" else width)


def filter_sharpness(spread: float | None) -> float:
    """How nearly a filter is a box, whose glints end with their pixel.

    1 of a box of one pixel, of a sharper filter, and where nobody said; 0 of Blender's usual one,
    and of softer ones; between them by the spread.
    """
    if spread is None:
        return 1.0
    return min(max((SOFT_SPREAD - spread) / (SOFT_SPREAD - BOX_SPREAD), 0.0), 1.0)


def check_spread(spread: float) -> float:
    """A standard deviation in pixels, as it was given.

    Raises
    ------
    InputError
        It is none of a pixel filter.
    """
    array = np.asarray(spread)
    if array.ndim or array.dtype.kind not in "fiu" or not 0 <= array <= MOST_SPREAD:  # NaN is not
        raise InputError(f"filter_spread must be 0 to {MOST_SPREAD:g} pixels, got {spread}")
    return float(spread)


def parse_filter(text: str) -> float:
    """Standard deviation of a filter that a user names: ``box``, ``gaussian:2`` or a number.

    Raises
    ------
    InputError
        It is none of them.
    """
    kind, colon, width = text.strip().lower().partition(":")
    try:
        if kind in _SPREADS:
            return filter_spread(kind, float(width) if colon else None)
        return check_spread(float(text))
    except ValueError:  # what is out of range, too
        raise InputError(
            f"pixel filter must be {', '.join(_SPREADS)}, with a width in pixels as in "
            f"gaussian:2 or without, or its standard deviation, 0 to {MOST_SPREAD:g} pixels, "
            f"got {text}"
        ) from None
