"""Reconstruction with shared-weight kernels at several resolutions.

differs: Fan et al. 2021, section 5.2, blend a U-Net's resolutions by eq. 7. Here the weights of a
coarser level come from the finer one, the blend is one softmax over what a pixel can take (itself,
its kernels, its neighbours, the coarser level, which is doubled by shares of the network's own),
the finest level is filtered along what looks alike (see `stillray.families.finest_filters`), and
the re-modulated result is resolved with its neighbours and the previous output, which smooths
edges as supersampling would and holds the picture still. Every step is a convex combination: no
light is invented.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stillray.arrays.bounds import at_most
from stillray.arrays.extend import extended
from stillray.arrays.resample import halve
from stillray.arrays.strips import Strips, interleave, planes_of, with_halo
from stillray.arrays.workspace import Workspace
from stillray.families.box_filter import box_means
from stillray.families.cost import kernel_pyramid_cost
from stillray.families.finest_filters import filter_finest
from stillray.families.gaussian import share_of_bright
from stillray.families.layer_filter import Outputs
from stillray.families.logit_maps import LogitMaps, holds_nan, without_nan
from stillray.families.pyramid_logits import (
    NEIGHBOURS,
    LevelLayout,
    level_layout,
    seen_from,
)
from stillray.families.pyramid_upsample import Doubled
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.families.views import View
from stillray.model_spec.decoders import PyramidKernels
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import PyramidNetwork
from stillray.models.steps import InSteps, Output
from stillray.stages.features import luminance_of_planes
from stillray.stages.state import Filterable
from stillray.timing import timed


def alignment(network: PyramidNetwork) -> int:
    """Height and width of the network's input must be multiples of this, pixels."""
    return 1 << (network.resolutions - 1)


def receptive_field(network: PyramidNetwork) -> int:
    """Pixels that one output of the network looks to each side."""
    radius = network.kernel_size // 2
    coarsest = len(network.widths) - 1
    # the longest way goes through the coarsest level: every convolution counts in its own pixels
    entries = radius + sum(radius << (level - 1) for level in range(1, coarsest + 1))
    down = sum(radius * count << level for level, count in enumerate(network.encoder_blocks))
    up = sum(radius * count << level for level, count in enumerate(network.decoder_blocks))
    # doubled pixels lie up to one coarser pixel off, and a pixel anywhere in its block
    way = entries + down + up + radius + (1 << coarsest)
    return network.block * way + network.block - 1


@dataclass(frozen=True, kw_only=True, eq=False)
class Brightness:
    """What of a color decides how it is filtered, for other layers to be filtered alike.

    Attributes
    ----------
    shares : (H, W) float32 or None
        What pixels weigh in the finest level's filters, see `share_of_bright`; of the size that
        the levels divide. None where brightness does not count there.
    toned : (h + 2, w + 2) float32 or None
        What tells brighter neighbours in the resolve; None where they are not told.
    """

    shares: np.ndarray | None = None
    toned: np.ndarray | None = None


_OWN = Brightness()


class KernelPyramidModel(TemporalKernels):
    """A model of the family ``kernel-pyramid``."""

    takes_integers = True

    def __init__(self, spec: ModelSpec) -> None:
        assert isinstance(spec.decoder, PyramidKernels)
        assert isinstance(spec.network, PyramidNetwork)
        self._options, coarsest = spec.decoder, alignment(spec.network)
        self._levels = spec.network.resolutions
        self.method = f"kernels at {self._levels} resolutions, resolved with the last output"
        self.cost = kernel_pyramid_cost(self._levels, spec.decoder)
        self.ensemble = spec.decoder.ensemble
        # doubling looks into the neighbouring cell: 1.5 cells of every level above the finest,
        # 1.5 (2 + 4 + ... + coarsest); then the largest kernel of the coarsest, and the resolve
        radii = (size // 2 for size in spec.decoder.kernel_sizes)
        radius = max(*radii, *spec.decoder.finest_neighbours, int(spec.decoder.predicted))
        filters = sum(spec.decoder.finest_filters)
        looks = Looks(
            reach=3 * (coarsest - 1) + radius * coarsest + filters + 1,
            receptive_field=receptive_field(spec.network),
            alignment=coarsest,
            sample=True,
            previous_output=True,
            sharp=spec.decoder.sharp_recall,
        )
        super().__init__(spec, looks)

    def reconstruct(
        self,
        light: Filterable,
        outputs: Outputs,
        strips: Strips,
        timings: dict[str, float],
    ) -> np.ndarray:
        """Filter, remodulate and resolve, see `TemporalKernels`.

        After the outputs comes, perhaps, what `frozen` found.
        """
        logits, frozen = outputs[: self._levels], outputs[self._levels :]
        brightness = frozen[0] if frozen else _OWN
        with timed(timings, "reconstruct"):
            return filter_pyramid(light, logits, self._options, strips, brightness)

    def seen_from(
        self, view: View, outputs: Sequence[Output], strips: Strips, name: str
    ) -> list[Output]:
        """Logits of a mirrored frame as those of the frame, see `TemporalKernels`."""
        found: list[Output] = []
        for level, given in enumerate(outputs):
            planes = given.integers if isinstance(given, InSteps) else given
            places = seen_from(view, level, self._levels, self._options)
            if len(planes) > len(places):  # the finest, by blocks of 2x2 pixels
                places = [4 * place + corner for place in places for corner in view.corners]
            kind = planes.dtype.type
            out = strips.workspace.array(f"{name}, level {level}", planes.shape, kind)
            seen = view.of_planes(planes, places, strips, out)
            found.append(InSteps(seen, given.steps) if isinstance(given, InSteps) else seen)
        return found

    def frozen(self, light: Filterable, outputs: Outputs, strips: Strips) -> Outputs:
        """Outputs by which other layers are filtered as the frame's light was.

        Which pixels are the brighter ones is for the color to say: layers add up to it only if
        theirs weigh the same.

        Returns
        -------
        list
            The outputs, then `Brightness` of the color, where that counts.
        """
        if not (_tone(light, self._options) or self._options.filter_tone):
            return outputs
        outputs = without_nan(outputs)
        finest = _finest(light, outputs, self._options, strips)
        shares = None if finest.shares is None else finest.shares.copy()
        return [*outputs, Brightness(shares=shares, toned=self._toned(finest, light, strips))]

    def _toned(self, finest: _Level, light: Filterable, strips: Strips) -> np.ndarray | None:
        """What tells brighter neighbours in the resolve, ``(h + 2, w + 2)``."""
        if not _tone(light, self._options):
            return None
        height, width = light.mean.shape[:2]
        toned = np.empty((height + 2, width + 2), np.float32)

        def work(rows: slice) -> None:
            unresolved = finest.unresolved(rows, light, strips.workspace)
            inside = finest.toned(unresolved, light, strips.workspace)[1:-1]
            toned[rows.start + 1 : rows.stop + 1] = inside

        strips.run(work, height, width)
        _repeat_border(toned, top=True, bottom=True)
        return toned


def _tone(light: Filterable, options: PyramidKernels) -> float:
    """What luminance is multiplied by before neighbours are compared; 0: they are not."""
    return options.resolve_tone * light.exposure * light.filter_sharpness


def filter_pyramid(
    light: Filterable,
    logits: Sequence[Output],
    options: PyramidKernels,
    strips: Strips,
    brightness: Brightness = _OWN,
) -> np.ndarray:
    """Filter, re-modulate and resolve a frame.

    Parameters
    ----------
    light
        What is filtered: irradiance >= 0 and samples > 0.
    logits
        One ``(planes, H, W)`` map a level, finest first, of the frame's size rounded up to
        `alignment`; any values, or `InSteps`. The frame is mirrored to that size. The finest may
        come by blocks, see `LogitMaps`, known by having the size of the next.
    options
        Kernel sizes and the bound of the logits.
    strips
        Where the work runs.
    brightness
        Of the light that the weights were made for; by default of this light.

    Returns
    -------
    (h, w, 3) float32
        Radiance: for every pixel a convex combination of the irradiance around it, accumulated
        and new, times the divisors of its 3x3 neighbours, and of the previous output.
    """
    image = _filtered(light, logits, options, strips, brightness)
    # A logit that is not a number says nothing: 0. It shows in the image, which is a fifth of the
    # logits to look through.
    if np.isnan(image.max()) and holds_nan(logits):
        image = _filtered(light, without_nan(logits), options, strips, brightness)
    return image


def _filtered(
    light: Filterable,
    logits: Sequence[Output],
    options: PyramidKernels,
    strips: Strips,
    brightness: Brightness,
) -> np.ndarray:
    height, width = light.mean.shape[:2]
    image = np.empty((height, width, 3), np.float32)
    finest = _finest(light, logits, options, strips, brightness.shares)

    def work(rows: slice) -> None:
        finest.resolve(rows, light, brightness.toned, image[rows], strips.workspace)

    strips.run(work, height, width)
    return image


def _finest(
    light: Filterable,
    logits: Sequence[Output],
    options: PyramidKernels,
    strips: Strips,
    shares: np.ndarray | None = None,
) -> _Level:
    """The finest level with all that it is blended of, filtered where the model does that."""
    levels = len(logits)
    by_blocks = levels > 1 and logits[0].shape[1:] == logits[1].shape[1:]
    maps = [
        LogitMaps(given, options.logit_bound, strips, by_blocks=by_blocks and level == 0)
        for level, given in enumerate(logits)
    ]
    mean, sample = _whole_blocks(light, maps[0].shape[1:], strips)
    finest = level_layout(0, levels, options)
    pyramid = [_blended_with_sample(mean, sample, maps[0], finest.sample_blend, strips)]
    for level in range(levels - 1):
        pool = level_layout(level, levels, options).pool
        # levels lie in the workspace of this thread from frame to frame
        coarse = strips.workspace.array(
            f"pyramid {level + 1}", (4, *(size // 2 for size in pyramid[-1].shape[1:]))
        )
        _pool(pyramid[-1], maps[level], pool, strips, coarse)
        pyramid.append(coarse)
    coarser: Doubled | None = None
    for level in reversed(range(1, levels)):
        layout = level_layout(level, levels, options)
        padded = (3, *(size + 2 for size in pyramid[level].shape[1:]))
        blended = strips.workspace.array(f"blended {level}", padded)
        _Level(pyramid[level], coarser, maps[level], layout, options).blended(strips, blended)
        coarser = Doubled(blended, maps[level], layout.double)
    top = _Level(pyramid[0], coarser, maps[0], finest, options)
    if finest.filter_distances:
        size = pyramid[0].shape[1:]
        filtered, shares = filter_finest(
            lambda rows, out: top.blend(rows, out, strips.workspace),
            (size[0], size[1]), maps[0], finest, strips,
            _share(shares, light.exposure, options.filter_tone),
        )  # fmt: skip
        top = replace(top, filtered=filtered, shares=shares)
    return top


def _share(
    shares: np.ndarray | None, exposure: float, tone: float
) -> Callable[[slice, np.ndarray, np.ndarray], None] | None:
    """How the finest level's filters learn what bright pixels weigh, see `filter_finest`."""
    if not tone:
        return None

    def share(rows: slice, light: np.ndarray, out: np.ndarray) -> None:
        if shares is None:
            share_of_bright(light, exposure, tone, out)
        else:
            out[...] = shares[rows]

    return share


def _whole_blocks(
    light: Filterable, size: tuple[int, ...], strips: Strips
) -> tuple[np.ndarray, np.ndarray | None]:
    """Mean and sample of a size that the levels divide, see `extended`."""
    mean, sample = light.mean, light.sample
    if mean.shape[:2] == size:
        return mean, sample
    mean = extended(mean, strips.workspace.array("extended", (*size, 4)), strips)
    if sample is not None:
        planes = strips.workspace.array("extended sample", (4, *size))
        for plane, target in zip(sample, planes, strict=True):
            extended(plane, target, strips)
        sample = planes
    return mean, sample


def _blended_with_sample(
    mean: np.ndarray,
    sample: np.ndarray | None,
    logits: LogitMaps,
    sample_blend: slice,
    strips: Strips,
) -> np.ndarray:
    """Light and samples as ``(4, h, w)``: what was accumulated, with more of the new sample.

    A past that no longer holds (a mirror's picture moves otherwise than the mirror, a shadow
    passes over a surface that stays) is known to the network, not to the geometry.
    """
    planes = strips.workspace.array("pyramid 0", (4, *mean.shape[:2]))

    def work(rows: slice) -> None:
        workspace = strips.workspace
        shape = (rows.stop - rows.start, mean.shape[1])
        past = planes_of(mean[rows], out=workspace.array("mean", (4, *shape)))
        if sample is None:
            planes[:, rows] = past
            return
        new = sample[:, rows]
        more, total = workspace.array("more", shape), workspace.array("total", shape)
        logits.weight(sample_blend.start, rows, more)
        held = np.add(more, 1, out=workspace.array("held", shape))
        more *= new[3]
        np.add(past[3], more, out=total)
        np.divide(total, held, out=planes[3, rows])
        more /= total
        rest = np.divide(past[3], total, out=total)
        # two products, since a difference would cancel where a firefly meets a dark past
        for light, own_sample, target in zip(past, new, planes[:3, rows], strict=False):
            np.multiply(light, rest, out=target)
            cv2.accumulateProduct(own_sample, more, target)

    strips.run(work, *mean.shape[:2])
    return planes


def _pool(
    fine: np.ndarray,
    logits: LogitMaps,
    pool: slice,
    strips: Strips,
    coarse: np.ndarray,
) -> None:
    """The next coarser level of ``(4, h, w)`` light and samples: weighted means of 2x2 blocks."""
    height, width = coarse.shape[1:]

    def work(rows: slice) -> None:
        workspace = strips.workspace
        source = slice(2 * rows.start, 2 * rows.stop)
        shape = (source.stop - source.start, 2 * width)
        weight, product = workspace.array("weight", shape), workspace.array("product", shape)
        logits.weight(pool.start, source, weight)
        total = halve(weight)
        weight *= fine[3, source]
        held = halve(weight)
        np.divide(held, total, out=coarse[3, rows])
        np.reciprocal(held, out=held)
        for channel in range(3):
            np.multiply(weight, fine[channel, source], out=product)
            np.multiply(halve(product), held, out=coarse[channel, rows])

    strips.run(work, height, width)


@dataclass(frozen=True, eq=False)
class _Level:
    """A level and what it is blended of.

    Attributes
    ----------
    planes : (4, h, w) float32
        Light and samples of the whole level.
    coarser
        The whole coarser level; None at the coarsest.
    logits
        Of the level.
    layout, options
        Of the logits.
    filtered : (3, h, w) float32 or None
        The finest level as its last filters left it, which is then not blended again.
    shares : (h, w) float32 or None
        What its pixels weighed in those filters, see `Brightness`.
    """

    planes: np.ndarray
    coarser: Doubled | None
    logits: LogitMaps
    layout: LevelLayout
    options: PyramidKernels
    filtered: np.ndarray | None = None
    shares: np.ndarray | None = None

    def blended(self, strips: Strips, result: np.ndarray) -> None:
        """The whole level with its border repeated, into ``(3, h + 2, w + 2)``."""
        height, width = self.planes.shape[1:]
        inner = result[:, 1:-1, 1:-1]
        strips.run(lambda rows: self.blend(rows, inner[:, rows], strips.workspace), height, width)
        _repeat_border(result, top=True, bottom=True)

    def resolve(
        self,
        rows: slice,
        light: Filterable,
        toned: np.ndarray | None,
        out: np.ndarray,
        workspace: Workspace,
    ) -> None:
        """Rows of the picture, ``(rows, w, 3)``: blended, remodulated and resolved."""
        padded = self.unresolved(rows, light, workspace)
        around: np.ndarray | None = None
        if toned is not None:
            around = toned[rows.start : rows.stop + 2].copy()
        elif _tone(light, self.options):
            around = self.toned(padded, light, workspace)
        past = None if light.previous is None else light.previous[rows]
        at = self.layout.resolve
        weights = workspace.array("weights", (at.stop - at.start, *out.shape[:2]))
        self.logits.weights(at, rows, weights)
        if around is not None:
            _weigh_brighter_less(around, weights[: len(NEIGHBOURS)], workspace)
        _resolve(padded, weights, past, out, workspace)

    def toned(self, padded: np.ndarray, light: Filterable, workspace: Workspace) -> np.ndarray:
        """What tells a picture's brighter pixels, ``(3, h, w)`` to ``(h, w)``: 1 + tone L."""
        toned = luminance_of_planes(padded, workspace.array("toned", padded.shape[1:]))
        toned *= _tone(light, self.options)
        toned += 1
        return toned

    def unresolved(self, rows: slice, light: Filterable, workspace: Workspace) -> np.ndarray:
        """Rows blended and remodulated, ``(3, rows + 2, w + 2)``: a pixel more on each side."""
        height, width = light.mean.shape[:2]
        # the resolve looks one pixel around; at the border of the frame that is repeated
        around, inner = with_halo(rows, 1, height)
        shape = (3, rows.stop - rows.start + 2, self.planes.shape[2] + 2)
        padded = workspace.array("padded", shape)
        top = 1 - inner.start
        filled = slice(top, top + around.stop - around.start)
        if self.filtered is None:
            self.blend(around, padded[:, filled, 1:-1], workspace)
        else:
            padded[:, filled, 1:-1] = self.filtered[:, around]
        if light.remodulation_albedo is not None:
            by = workspace.array("by", (3, around.stop - around.start, width))
            padded[:, filled, 1 : 1 + width] *= planes_of(light.remodulation_albedo[around], out=by)
        padded = padded[:, :, : width + 2]
        _repeat_border(padded, top=rows.start == 0, bottom=rows.stop == height)
        return padded

    def blend(self, rows: slice, out: np.ndarray, workspace: Workspace) -> None:
        """Rows of the level, ``(3, rows, w)``: itself, its kernels and the coarser level."""
        height, width = self.planes.shape[1:]
        shape = (rows.stop - rows.start, width)
        at = self.layout.blend
        shares = workspace.array("shares", (at.stop - at.start, *shape))
        self.logits.weights(at, rows, shares)
        others = list(shares)
        if self.coarser is None:  # itself at logit 0, then the kernels
            light = workspace.array("light", (3, *shape))
            np.copyto(light, self.planes[:3, rows])
        else:  # the coarser level at logit 0, then itself, then the kernels
            light = self.coarser.rows(rows, workspace)
            own = others.pop(0)
            # a sample that weighs less than one counts as little for its own pixel, see
            # docs/decisions.md: else a lone firefly of a first frame would lift it
            own *= at_most(self.planes[3, rows], 1, out=workspace.array("sample_weight", shape))
            for plane, sums in zip(self.planes, light, strict=False):
                cv2.accumulateProduct(plane[rows], own, sums)
        normal = workspace.array("normal", shape)
        np.add(shares[0], 1, out=normal)
        for share in shares[1:]:
            normal += share
        # none where the finest level has no kernels
        for index, (size, share) in enumerate(zip(self.options.kernel_sizes, others, strict=False)):
            near, inner = with_halo(rows, size // 2, height)
            strip = (near.stop - near.start, width)
            weight, product, box = (
                workspace.array(name, strip) for name in ("weight", "product", "box")
            )
            self.logits.weight(self.layout.importance.start + index, near, weight)
            weight *= self.planes[3, near]
            share /= box_means(weight, size, box)[inner]
            for plane, sums in zip(self.planes, light, strict=False):
                np.multiply(weight, plane[near], out=product)
                cv2.accumulateProduct(box_means(product, size, box)[inner], share, sums)
        if self.layout.distances:
            self._add_around(rows, light, normal, workspace)
        np.multiply(light, np.reciprocal(normal, out=normal), out=out)

    def _add_around(
        self, rows: slice, light: np.ndarray, normal: np.ndarray, workspace: Workspace
    ) -> None:
        """Add neighbours, each by a weight of its own, and the weights."""
        distances = self.layout.distances
        at = self.layout.around
        weights = workspace.array("weights", (at.stop - at.start, *normal.shape))
        for weight in self.logits.weights(at, rows, weights):
            normal += weight
        margin, count = max(distances), len(NEIGHBOURS)
        padded = _padded(self.planes[:3], rows, margin, workspace)
        for index, distance in enumerate(distances):
            crop = slice(margin - distance, distance - margin or None)
            near = padded[:, crop, crop]
            _add_neighbours(near, weights[count * index :][:count], light, distance)


def _padded(planes: np.ndarray, rows: slice, margin: int, workspace: Workspace) -> np.ndarray:
    """Rows of ``(3, h, w)`` with a margin of pixels on each side, repeated at the border."""
    height, width = planes.shape[1:]
    near, inner = with_halo(rows, margin, height)
    count = rows.stop - rows.start
    padded = workspace.array("neighbours", (3, count + 2 * margin, width + 2 * margin))
    top = margin - inner.start
    bottom = top + near.stop - near.start
    padded[:, top:bottom, margin:-margin] = planes[:, near]
    padded[..., :margin] = padded[..., margin : margin + 1]
    padded[..., -margin:] = padded[..., -margin - 1 : -margin]
    padded[:, :top] = padded[:, top : top + 1]
    padded[:, bottom:] = padded[:, bottom - 1 : bottom]
    return padded


def _repeat_border(padded: np.ndarray, *, top: bool, bottom: bool) -> None:
    """Fill the outermost pixels of ``(..., h + 2, w + 2)``: left, right, and where asked for."""
    padded[..., 0], padded[..., -1] = padded[..., 1], padded[..., -2]
    if top:
        padded[..., 0, :] = padded[..., 1, :]
    if bottom:
        padded[..., -1, :] = padded[..., -2, :]


def _add_neighbours(
    padded: np.ndarray, weights: np.ndarray, sums: np.ndarray, distance: int = 1
) -> None:
    """Add the eight neighbours, each by its weight, to ``(3, h, w)``.

    Parameters
    ----------
    padded : (3, h + 2 distance, w + 2 distance) float32
        With that many pixels more on each side.
    weights : (8, h, w) float32
        In the order of `NEIGHBOURS`.
    sums : (3, h, w) float32
        Added to.
    distance
        Of the neighbours, pixels.
    """
    height, width = weights.shape[1:]
    for plane, total in zip(padded, sums, strict=True):
        for weight, (down, right) in zip(weights, NEIGHBOURS, strict=True):
            moved = plane[distance * (1 + down) :, distance * (1 + right) :][:height, :width]
            cv2.accumulateProduct(moved, weight, total)


def _resolve(
    padded: np.ndarray,
    weights: np.ndarray,
    previous: np.ndarray | None,
    out: np.ndarray,
    workspace: Workspace,
) -> None:
    """Average pixels with their neighbours and the previous output.

    Parameters
    ----------
    padded : (3, h + 2, w + 2) float32
        Radiance, with one pixel more on each side.
    weights : (9, h, w) float32
        Of the neighbours and the previous output; changed.
    previous : (h, w, 4) float32 or None
        The previous output, and how much of it is valid.
    out : (h, w, 3) float32
        Written.
    """
    height, width = out.shape[:2]
    normal = workspace.array("normal", (height, width))
    np.add(weights[0], weights[1], out=normal)
    for weight in weights[2:-1]:
        normal += weight
    normal += 1
    past: np.ndarray | None = None
    if previous is not None:
        past = planes_of(previous, out=workspace.array("past", (4, height, width)))
        weights[-1] *= past[3]
        normal += weights[-1]
    np.reciprocal(normal, out=normal)
    resolved = workspace.array("resolved", (3, height, width))
    np.copyto(resolved, padded[:, 1:-1, 1:-1])
    _add_neighbours(padded, weights[: len(NEIGHBOURS)], resolved)
    if past is not None:
        for plane, total in zip(past, resolved, strict=False):
            cv2.accumulateProduct(plane, weights[-1], total)
    resolved *= normal
    interleave(resolved, out=out)


def _weigh_brighter_less(toned: np.ndarray, weights: np.ndarray, workspace: Workspace) -> None:
    """Multiply the weights of brighter neighbours by how much brighter they are, as displayed.

    A window sixty times as bright as the bar before it would show through a hundredth of a weight.

    Parameters
    ----------
    toned : (h + 2, w + 2) float32
        1 + tone L, see `_Level.toned`; made into its reciprocals.
    weights : (8, h, w) float32
        Of the neighbours; changed.
    """
    height, width = shape = weights.shape[1:]
    own, less = workspace.array("own tone", shape), workspace.array("less", shape)
    np.copyto(own, toned[1:-1, 1:-1])
    np.reciprocal(toned, out=toned)
    for weight, (down, right) in zip(weights, NEIGHBOURS, strict=True):
        cv2.multiply(own, toned[1 + down :, 1 + right :][:height, :width], dst=less)
        cv2.multiply(weight, at_most(less, 1, out=less), dst=weight)
