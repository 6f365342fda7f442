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
from dataclasses import dataclass

import cv2
import numpy as np

from stillray.arrays.extend import extended
from stillray.arrays.strips import Strips, planes_of
from stillray.families.albedo_average import averaged
from stillray.families.cost import kernel_pyramid_cost
from stillray.families.finest_filters import filter_finest
from stillray.families.gaussian import share_of_bright
from stillray.families.layer_filter import Outputs
from stillray.families.logit_maps import LogitMaps, holds_nan, without_nan
from stillray.families.pyramid_level import Level, pooled
from stillray.families.pyramid_logits import NEIGHBOURS, level_layout, seen_from
from stillray.families.pyramid_resolve import Finest, tone
from stillray.families.pyramid_upsample import Doubled
from stillray.families.temporal_kernels import Looks, TemporalKernels
from stillray.families.views import View
from stillray.model_spec.decoders import PyramidKernels
from stillray.model_spec.loader import ModelSpec
from stillray.model_spec.networks import PyramidNetwork
from stillray.models.steps import InSteps, Output
from stillray.stages.recall import Recall
from stillray.stages.sample_counts import SampleCounts
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
        filters = max(sum(spec.decoder.finest_filters), sum(spec.decoder.albedo_filters))
        looks = Looks(
            reach=3 * (coarsest - 1) + radius * coarsest + filters + 1,
            receptive_field=receptive_field(spec.network),
            alignment=coarsest,
            sample=True,
            previous_output=True,
            sharp=spec.decoder.sharp_recall,
        )
        super().__init__(spec, looks)

    def recall(self, counts: SampleCounts) -> Recall | None:
        """By what a frame of so many samples takes of the last output, see `TemporalKernels`."""
        options = self._options
        if not options.recall_noise:
            return None
        return Recall(limit=options.recall_noise, power=options.recall_power, counts=counts)

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
        if not (tone(light, self._options) or self._options.filter_tone):
            return outputs
        outputs = without_nan(outputs)
        finest = _finest(light, outputs, self._options, strips)
        shares = None if finest.shares is None else finest.shares.copy()
        return [*outputs, Brightness(shares=shares, toned=finest.all_toned(light, strips))]


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
) -> Finest:
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
        pooled(pyramid[-1], maps[level], pool, strips, coarse)
        pyramid.append(coarse)
    coarser: Doubled | None = None
    for level in reversed(range(1, levels)):
        layout = level_layout(level, levels, options)
        padded = (3, *(size + 2 for size in pyramid[level].shape[1:]))
        blended = strips.workspace.array(f"blended {level}", padded)
        Level(pyramid[level], coarser, maps[level], layout, options).blended(strips, blended)
        coarser = Doubled(blended, maps[level], layout.double)
    top = Level(pyramid[0], coarser, maps[0], finest, options)
    albedo: np.ndarray | None = None
    if options.albedo_filters and light.remodulation_albedo is not None:
        neighbours = slice(finest.resolve.start, finest.resolve.start + len(NEIGHBOURS))
        albedo = averaged(
            light.remodulation_albedo, maps[0], neighbours, options.albedo_filters, strips
        )
    if not finest.filter_distances:
        return Finest(top, albedo=albedo)
    size = pyramid[0].shape[1:]
    filtered, shares = filter_finest(
        lambda rows, out: top.blend(rows, out, strips.workspace),
        (size[0], size[1]), maps[0], finest, strips,
        _share(shares, light.exposure, options.filter_tone),
    )  # fmt: skip
    return Finest(top, filtered, shares, albedo)


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
