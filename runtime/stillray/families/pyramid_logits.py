"""What the logits of a kernel pyramid are for, level by level.

See `stillray.families.kernel_pyramid`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from stillray.families.views import View
from stillray.model_spec.decoders import PyramidKernels

#: Neighbours of a pixel in the order of their logits: (rows down, columns right).
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


@dataclass(frozen=True)
class LevelLayout:
    """Where the logits of one level lie in its planes.

    Attributes
    ----------
    importance
        One map a kernel.
    pool
        Weights for the next coarser level; empty at the coarsest.
    blend
        What a pixel takes: at the coarsest level its kernels, against itself at logit 0; elsewhere
        itself and its kernels, against the coarser level at logit 0. Itself by what it holds of a
        sample, if that is less than one.
    resolve
        At the finest level the eight `NEIGHBOURS` and the previous output, against the pixel
        itself at logit 0; empty elsewhere.
    sample_blend
        At the finest level how much this frame's sample counts beside what was accumulated, which
        holds it already; empty elsewhere.
    double
        At every level but the finest what each of the four finer pixels takes of the pixels beside
        its own and above or below it, see `stillray.families.pyramid_upsample`: four maps for the
        one, four for the other; empty at the finest.
    around
        Where the spec asks for it, what a pixel takes of its eight `NEIGHBOURS` at each of
        `distances`, as the blend's; empty elsewhere.
    features
        At the finest level what its last filters compare; empty elsewhere, and without filters.
    filters
        A pair a filter: what a pixel weighs to others, and to itself.
    distances
        Of the neighbours, in pixels of the level.
    filter_distances
        Of the filters, pixels.
    """

    importance: slice
    pool: slice
    blend: slice
    resolve: slice
    sample_blend: slice
    double: slice
    around: slice
    features: slice
    filters: slice
    distances: tuple[int, ...]
    filter_distances: tuple[int, ...]


def level_layout(level: int, levels: int, options: PyramidKernels) -> LevelLayout:
    """The layout of a level, 0 being the finest."""
    kernels = len(options.kernel_sizes) if level > 0 or options.finest_kernels else 0
    coarsest = level == levels - 1
    distances = options.finest_neighbours if level == 0 else (1,) * options.predicted
    filters = options.finest_filters if level == 0 else ()
    counts = (
        kernels,
        0 if coarsest else 1,
        kernels if coarsest else kernels + 1,
        len(NEIGHBOURS) + 1 if level == 0 else 0,
        1 if level == 0 else 0,
        0 if level == 0 else 8,
        len(NEIGHBOURS) * len(distances),
        options.filter_features if level == 0 else 0,
        2 * len(filters),
    )
    starts = [sum(counts[:index]) for index in range(len(counts) + 1)]
    importance, pool, blend, resolve, sample_blend, double, around, features, pairs = (
        slice(a, b) for a, b in pairwise(starts)
    )
    return LevelLayout(
        importance, pool, blend, resolve, sample_blend, double, around, features, pairs,
        distances, filters,
    )  # fmt: skip


def level_logits(level: int, levels: int, options: PyramidKernels) -> int:
    """Planes that a level's logits have, 0 being the finest."""
    return level_layout(level, levels, options).filters.stop


def logit_names(level: int, levels: int, options: PyramidKernels) -> list[str]:
    """What each plane of a level's logits is for, in their order: the same name, the same use."""
    layout = level_layout(level, levels, options)
    kernels = [f"{size}" for size in options.kernel_sizes]
    own = [] if level == levels - 1 else ["itself"]
    neighbours = [f"{down} {right}" for down, right in NEIGHBOURS]
    names = {
        "importance": kernels,
        "pool": ["to the coarser"],
        "blend": [*own, *kernels],
        "resolve": [*neighbours, "the last output"],
        "sample_blend": ["the new sample"],
        "double": [f"{index}" for index in range(8)],
        "around": [f"{name} by {far}" for far in layout.distances for name in neighbours],
        "features": [f"{index}" for index in range(options.filter_features)],
        "filters": [
            f"{far} {who}" for far in layout.filter_distances for who in ("others", "itself")
        ],
    }
    counted = {name: getattr(layout, name) for name in names}
    return [
        f"{use}: {name}"
        for use, given in names.items()
        for name in given[: counted[use].stop - counted[use].start]
    ]


def seen_from(view: View, level: int, levels: int, options: PyramidKernels) -> list[int]:
    """Where the planes of a level's logits are to be found in those of a frame seen otherwise.

    A neighbour to the left is one to the right there, and the finer pixel at the top left one at
    the bottom right.
    """
    layout = level_layout(level, levels, options)
    places = np.arange(layout.filters.stop)
    signs = np.array([-1 if view.rows else 1, -1 if view.columns else 1])
    others = [NEIGHBOURS.index((down, right)) for down, right in signs * np.array(NEIGHBOURS)]
    count = len(NEIGHBOURS)
    eights = [layout.around.start + index * count for index in range(len(layout.distances))]
    if level == 0:
        eights.append(layout.resolve.start)
    for start in eights:
        places[start : start + count] = [start + other for other in others]
    if level > 0:
        beside, above = layout.double.start, layout.double.start + 4
        places[layout.double] = [
            start + corner for start in (beside, above) for corner in view.corners
        ]
    return [int(place) for place in places]


def numbers(logits: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Logits with 0 where they are not numbers, which say nothing."""
    return [np.nan_to_num(level, nan=0.0, posinf=np.inf, neginf=-np.inf) for level in logits]
