"""Reconstruction with shared-weight kernels at several resolutions.

differs: Fan et al. 2021, section 5.2, blend a U-Net's resolutions by eq. 7. Here the weights of a
coarser level come from the finer one, the blend is one softmax over what a pixel can take (itself,
its kernels, the coarser level), and the re-modulated result is resolved with its neighbours and
the previous output, which smooths edges as supersampling would and holds the picture still. Every
step is a convex combination: no light is invented.
"""

from __future__ import annotations

from dataclasses import dataclass

from stillray.models_spec.loader import PyramidKernels

#: Neighbours of the resolve in the order of their logits: (rows down, columns right).
NEIGHBOURS = ((-1, -1), (-1, 0), (-1, 1), (0, -1), (0, 1), (1, -1), (1, 0), (1, 1))


#: Weight that keeps 0/0 out of windows that hold only padding, samples.
TINY = 1e-20


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
        itself and its kernels, against the coarser level at logit 0.
    resolve
        At the finest level the eight `NEIGHBOURS` and the previous output, against the pixel
        itself at logit 0; empty elsewhere.
    """

    importance: slice
    pool: slice
    blend: slice
    resolve: slice


def level_layout(level: int, levels: int, options: PyramidKernels) -> LevelLayout:
    """The layout of a level, 0 being the finest."""
    kernels = len(options.kernel_sizes)
    coarsest = level == levels - 1
    counts = (
        kernels,
        0 if coarsest else 1,
        kernels if coarsest else kernels + 1,
        len(NEIGHBOURS) + 1 if level == 0 else 0,
    )
    starts = [sum(counts[:index]) for index in range(5)]
    return LevelLayout(*(slice(a, b) for a, b in zip(starts, starts[1:], strict=False)))


def level_logits(level: int, levels: int, options: PyramidKernels) -> int:
    """Planes that the network gives at a level, 0 being the finest."""
    return level_layout(level, levels, options).resolve.stop
