"""Reconstruction with fused shared-weight kernels at several resolutions (Fan et al. 2021, 5.2).

Every resolution is filtered as `stillray.families.box_filter` does it, then they are blended from
the coarsest to the finest: a share of a block's own mean gives way to the coarser level,

    o = f - a U D f + a U c    (eq. 7)

with f the fine level, c the coarser, D the mean of 2x2 blocks and U their repetition.

differs: eq. 7 can leave the range of what it blends, below zero even, where a bright pixel lies
beside dark ones. The result is limited to the range of the block and of the coarser level, so that
no light is invented. Coarser levels hold means weighted by samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.extend import extended
from stillray.arrays.resample import double, halve
from stillray.arrays.strips import Strips, interleave, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.box_filter import bounded_exp, filter_planes
from stillray.families.cost import multi_resolution_cost
from stillray.families.kernel_pyramid import alignment, receptive_field
from stillray.families.pyramid_logits import numbers
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.model_spec.decoders import FusedKernels
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import PyramidNetwork
from stillray.stages.state import Filterable
from stillray.timing import timed, timed_pass

#: How a level is filtered, as `stillray.families.box_filter.filter_planes`: mean, logits (its own
#: first, then perhaps the blend's), rows and options to planes ``(3, rows, w)`` in the workspace.
LevelFilter = Callable[[np.ndarray, np.ndarray, slice, FusedKernels, Workspace], np.ndarray]


def level_planes(level: int, levels: int, options: FusedKernels) -> int:
    """Planes that the network gives at a level, 0 being the finest.

    An importance map a kernel, a fusion map a kernel, and, but at the coarsest, the logit of the
    blend with the coarser level.
    """
    return 2 * len(options.kernel_sizes) + (0 if level == levels - 1 else 1)


class MultiResolutionModel(TemporalKernels):
    """A model of the family ``multi-resolution-kernels``."""

    #: How a level is filtered, from as far as the largest of the kernel sizes reaches.
    level_filter: LevelFilter = staticmethod(filter_planes)

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, FusedKernels)
        assert isinstance(spec.network, PyramidNetwork)
        self._options, coarsest = spec.decoder, alignment(spec.network)
        sizes, self._levels = spec.decoder.kernel_sizes, len(spec.network.widths)
        self.method = (
            f"{len(sizes)} fused kernels at each of {spec.network.resolutions} resolutions"
        )
        self.cost = multi_resolution_cost(spec.network.resolutions, len(sizes))
        looks = Looks(
            # from the far side of its own cell of the coarsest level to that of the window
            reach=max(sizes) // 2 * coarsest + coarsest - 1,
            receptive_field=receptive_field(spec.network),
            alignment=coarsest,
        )
        super().__init__(spec, looks)

    def reconstruct(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """Filter and remodulate, see `TemporalKernels`.

        Parameters
        ----------
        light
            What is filtered.
        outputs
            One ``(planes, H, W)`` map a level, finest first, see `level_planes`, of the frame's
            size rounded up to the alignment; any values. The frame is mirrored to that size.
            After them, perhaps, what `frozen` found.
        strips, timings
            As `TemporalKernels` has them.
        """
        image = self._reconstructed(light, outputs, strips, timings)
        # a NaN logit says nothing: 0
        if np.isnan(image.max()) and any(np.isnan(level.max()) for level in outputs):
            return self._reconstructed(light, numbers(outputs), strips, timings)
        return image

    def frozen(
        self, light: Filterable, outputs: Sequence[np.ndarray], strips: Strips
    ) -> list[np.ndarray]:
        """Outputs by which other layers are filtered as the frame's light was.

        How far a blend goes is limited by the light that it meets. Layers add up to the color only
        if they go as far as the color did, whatever they meet themselves.

        Returns
        -------
        list of arrays
            The outputs, then how far each level but the coarsest gave way, ``(3, H, W)``, finest
            first.
        """
        options = self._options
        outputs = numbers(outputs)
        means = _resolutions(light.mean, outputs, options, strips)
        coarser = _level(_LevelInputs(means[-1], outputs[-1]), options, strips)
        found = []
        for mean, maps in reversed(list(zip(means[:-1], outputs[:-1], strict=True))):
            fine = _level(_LevelInputs(mean, maps), options, strips)
            steps = np.stack([double(_step(*planes)) for planes in zip(fine, coarser, strict=True)])
            coarser = _level(_LevelInputs(mean, maps, coarser), options, strips)
            shares = np.zeros_like(fine)
            np.divide(coarser - fine, steps, out=shares, where=steps != 0)
            found.append(np.clip(shares, 0, 1, out=shares))
        return [*outputs, *reversed(found)]

    def _reconstructed(
        self,
        light: Filterable,
        outputs: Sequence[np.ndarray],
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        options, levels = self._options, self._levels
        logits = outputs[:levels]
        frozen = [*outputs[levels:], None] if len(outputs) > levels else [None] * levels
        height, width = light.mean.shape[:2]
        image, by = np.empty((height, width, 3), np.float32), light.remodulation_albedo
        coarser: np.ndarray | None = None
        with timed(timings, "reconstruct"):
            means = _resolutions(light.mean, logits, options, strips)
            for level in reversed(range(1, levels)):
                this = _LevelInputs(means[level], logits[level], coarser, frozen[level])
                coarser = _level(this, options, strips, self.level_filter)
        finest = _LevelInputs(means[0], logits[0], coarser, frozen[0])
        with timed_pass(timings) as part:

            def work(blocks: slice) -> None:
                rows = slice(2 * blocks.start, 2 * blocks.stop)
                inside = slice(rows.start, min(rows.stop, height))
                with part("reconstruct"):
                    planes = _rows(finest, rows, options, strips.workspace, self.level_filter)
                    kept = planes[:, : inside.stop - inside.start, :width]
                    interleave(kept, out=image[inside])
                if by is not None:
                    with part("remodulate"):
                        image[inside] *= by[inside]

            strips.run(work, -(-height // 2), 2 * means[0].shape[1])
        return image


def _resolutions(
    mean: np.ndarray, logits: Sequence[np.ndarray], options: FusedKernels, strips: Strips
) -> list[np.ndarray]:
    """Light and samples of each level, ``(h, w, 4)``, finest first: weighted means of blocks."""
    size = logits[0].shape[1:]
    if mean.shape[:2] != size:
        mean = extended(mean, np.empty((*size, 4), np.float32), strips)
    means = [mean]
    for level in logits[1:]:
        means.append(_halved(means[-1], level.shape[1:], options, strips))
    return means


def _halved(
    fine: np.ndarray, shape: tuple[int, ...], options: FusedKernels, strips: Strips
) -> np.ndarray:
    height, width = shape
    coarse = np.empty((height, width, 4), np.float32)

    def work(rows: slice) -> None:
        workspace = strips.workspace
        source = fine[2 * rows.start : 2 * rows.stop]
        planes = planes_of(source, out=workspace.array("mean", (4, *source.shape[:2])))
        made = workspace.array("made", (4, rows.stop - rows.start, width))
        held = halve(planes[3], out=made[3])
        for plane, half in zip(planes[:3], made, strict=False):
            if options.weigh_samples:
                plane *= planes[3]
            halve(plane, out=half)
            if options.weigh_samples:
                half /= held
        interleave(made, out=coarse[rows])

    strips.run(work, height, width)
    return coarse


@dataclass(frozen=True, eq=False)
class _LevelInputs:
    """A level, and what it is blended with.

    Attributes
    ----------
    mean : (h, w, 4) float32
        Light and samples.
    logits : (planes, h, w) float32
    coarser : (3, h / 2, w / 2) float32 or None
        The coarser level, blended already; None for this level alone.
    frozen : (3, h, w) float32 or None
        The weights of the blend, if they are known already.
    """

    mean: np.ndarray
    logits: np.ndarray
    coarser: np.ndarray | None = None
    frozen: np.ndarray | None = None


def _level(
    level: _LevelInputs,
    options: FusedKernels,
    strips: Strips,
    level_filter: LevelFilter = filter_planes,
) -> np.ndarray:
    """`_rows` of a whole level, ``(3, h, w)``."""
    height, width = level.mean.shape[:2]
    result = np.empty((3, height, width), np.float32)

    def work(blocks: slice) -> None:
        rows = slice(2 * blocks.start, min(2 * blocks.stop, height))
        result[:, rows] = _rows(level, rows, options, strips.workspace, level_filter)

    # whole blocks of rows, but at the coarsest level, where there are none
    strips.run(work, -(-height // 2), 2 * width)
    return result


def _rows(
    level: _LevelInputs,
    rows: slice,
    options: FusedKernels,
    workspace: Workspace,
    level_filter: LevelFilter,
) -> np.ndarray:
    """Rows of a level, filtered and blended with the coarser level.

    Parameters
    ----------
    level
        All of it.
    rows
        Which rows; with a coarser level whole blocks.

    Returns
    -------
    (3, rows, w) float32
        In the workspace.
    """
    mean, logits, coarser, frozen = level.mean, level.logits, level.coarser, level.frozen
    near, own = with_halo(rows, max(options.kernel_sizes) // 2, len(mean))
    fine = level_filter(mean[near], logits[:, near], own, options, workspace)
    if coarser is None:
        return fine
    coarse = coarser[:, rows.start // 2 : rows.stop // 2]
    if frozen is not None:
        for plane, above, share in zip(fine, coarse, frozen[:, rows], strict=True):
            cv2.accumulateProduct(double(_step(plane, above)), share, plane)
        return fine
    alpha, held = workspace.array("alpha", fine.shape[1:]), workspace.array("held", fine.shape[1:])
    bounded_exp(logits[-1, rows], options.logit_bound, alpha)
    alpha /= np.add(alpha, 1, out=held)
    for plane, above in zip(fine, coarse, strict=True):
        _give_way(plane, above, alpha)
    return fine


def _give_way(fine: np.ndarray, coarser: np.ndarray, alpha: np.ndarray) -> None:
    """Blend one channel ``(h, w)`` with the coarser level by eq. 7, in place and within range."""
    upper, lower = fine[::2], fine[1::2]
    low, high = np.minimum(upper, lower), np.maximum(upper, lower)
    least = np.minimum(np.minimum(low[:, ::2], low[:, 1::2]), coarser)
    most = np.maximum(np.maximum(high[:, ::2], high[:, 1::2]), coarser)
    cv2.accumulateProduct(double(_step(fine, coarser)), alpha, fine)
    np.maximum(fine, double(least), out=fine)
    np.minimum(fine, double(most), out=fine)


def _step(fine: np.ndarray, coarser: np.ndarray) -> np.ndarray:
    """From the mean of each block to the coarser level."""
    return coarser - halve(fine)
