"""A whole frame as one module: from raw buffers and a state to a picture and the next state."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor, nn

from stillray.errors import InputError
from stillray.families.registry import kernels_of
from stillray.model_spec import ModelSpec
from stillray.model_spec.decoders import PyramidKernels
from stillray.stages.accumulate import FILLED_WEIGHT
from stillray.stages.prepare import LEAST_KEPT
from stillray.stages.repair import MAX_DEPTH, MAX_MOTION
from stillray_export.frame_graph.accumulation import (
    SampleCounts,
    accumulate,
    bound,
    sample_weight,
)
from stillray_export.frame_graph.albedo import accumulate_albedo
from stillray_export.frame_graph.dilation import follow_nearer
from stillray_export.frame_graph.encode import Prepared, feature_planes, filter_sharpness
from stillray_export.frame_graph.exposure import depth_scale, frame_exposure, steady_exposure
from stillray_export.frame_graph.lamps import restored
from stillray_export.frame_graph.light import local_luminance, tone_map
from stillray_export.frame_graph.lookup import grid
from stillray_export.frame_graph.rare_light import rare_light_gain
from stillray_export.frame_graph.recall import (
    believed,
    forget_uncovered,
    recall,
    recalled_share,
)
from stillray_export.frame_graph.reflections import follow_reflections, light_of
from stillray_export.frame_graph.rejection import Noise, compare, confidence
from stillray_export.frame_graph.relief import relief_gain, surface_weight
from stillray_export.frame_graph.repair import repair_feature, repair_motion, repair_radiance
from stillray_export.frame_graph.reprojection import guide_planes, reproject
from stillray_export.frame_graph.texture import texture_gain
from stillray_export.frame_graph.windows import mirrored
from stillray_training.decoders.boxes import pooled_box_mean
from stillray_training.decoders.demodulate import divisor
from stillray_training.decoders.luminance import luminance
from stillray_training.decoders.pyramid import (
    averaged_albedo,
    blended_with_sample,
    kernel_pyramid,
    level_parts,
    resolve,
)

#: Numbers that a state holds: exposure, exposure of its noise, frames of its noise, samples a
#: pixel, frames of its albedo.
NUMBERS = 5
NOISE_BLOCK = 16  # pixels


@dataclass(frozen=True, eq=False)
class Buffers:
    """A frame's buffers, repaired: planes ``(1, c, h, w)``.

    Attributes
    ----------
    color, albedo, normal, depth, motion
        As in `stillray.Frame`; ``albedo`` below 0, ``normal`` and ``depth`` 0 where not given.
    broken
        1 where color was filled in.
    counts
        The frame's samples.
    moves
        1 where there is a past and motion to bring it here, else 0; scalar.
    filter_spread
        Scalar: of the renderer's pixel filter, pixels, below 0 where not given; None where nobody
        asks.
    """

    color: Tensor
    albedo: Tensor
    normal: Tensor
    depth: Tensor
    motion: Tensor
    broken: Tensor
    counts: SampleCounts
    moves: Tensor
    filter_spread: Tensor | None = None


@dataclass(frozen=True, eq=False)
class State:
    """What a frame leaves to the next; all zeros before the first.

    Attributes
    ----------
    mean : (h, w, 4)
        Accumulated irradiance and the samples that each pixel holds.
    guides : (h, w, 4)
        Normals and the logarithm of depth.
    output : (h, w, 3)
        The last picture.
    noise : (rows, columns)
        Variance of one sample by blocks of 16x16 pixels.
    numbers : (NUMBERS,)
    albedo : (h, w, 3) or None
        Of models that accumulate it.
    """

    mean: Tensor
    guides: Tensor
    output: Tensor
    noise: Tensor
    numbers: Tensor
    albedo: Tensor | None = None


def beginning(height: int, width: int, spec: ModelSpec) -> State:
    """The state before the first frame."""
    blocks = [-(-size // NOISE_BLOCK) for size in (height, width)]
    albedo = torch.zeros(height, width, 3) if spec.temporal.albedo_samples > 0 else None
    return State(
        mean=torch.zeros(height, width, 4),
        guides=torch.zeros(height, width, 4),
        output=torch.zeros(height, width, 3),
        noise=torch.zeros(*blocks),
        numbers=torch.zeros(NUMBERS),
        albedo=albedo,
    )


class FrameGraph(nn.Module):
    """A kernel pyramid with all its stages.

    Parameters
    ----------
    network
        From features ``(1, features, H, W)``, sizes of whole cells of the coarsest level, to the
        logits of every level.
    spec
        Its specification.

    Raises
    ------
    InputError
        The model is of another family, or removes outliers.
    """

    def __init__(self, network: nn.Module, spec: ModelSpec) -> None:
        super().__init__()
        if not isinstance(spec.decoder, PyramidKernels):
            raise InputError(f"a frame graph is made of kernel pyramids, got a {spec.family} model")
        if spec.temporal.outlier_deviations:
            raise InputError("temporal.outlier_deviations must be 0 for a frame graph")
        self.network, self.spec, self.options = network, spec, spec.decoder
        self.multiple = kernels_of(spec).looks.alignment

    def forward(
        self,
        color: Tensor,
        albedo: Tensor,
        normal: Tensor,
        depth: Tensor,
        motion: Tensor,
        samples: Tensor,
        *more: Tensor,
    ) -> tuple[Tensor, ...]:
        """A frame, see `stillray_export.frame_graph.ports`: the picture, then the next state.

        ``more`` is the pixel filter's spread, of models that are told it, then the fields of the
        state.
        """
        told = self.spec.knows_filter
        past = State(*more[1:] if told else more)
        buffers = repaired(color, albedo, normal, depth, motion, samples, past)
        if told:
            buffers = replace(buffers, filter_spread=more[0].amax())
        prepared, sample, state = self.prepare(buffers, past)
        filtered, image = (each[0].permute(1, 2, 0) for each in self.reconstruct(prepared, sample))
        left = [state.mean, state.guides, filtered.clone(), state.noise, state.numbers]
        return image, *left, *([] if state.albedo is None else [state.albedo])

    def prepare(self, frame: Buffers, past: State) -> tuple[Prepared, Tensor, State]:
        """A frame ready for the network, its sample ``(1, 4, h, w)``, and the next state.

        That state's ``output`` is the last one's: the picture is not made yet.
        """
        spec = self.spec
        by = divisor(frame.albedo, spec.demodulate)
        irradiance = frame.color / by
        light = luminance(irradiance)
        own = frame_exposure(light, spec.transfer)
        exposure = steady_exposure(own, past.numbers[0], spec.transfer)
        motion = follow_reflections(
            frame.motion,
            frame.depth,
            frame.albedo,
            (light, light_of(past.mean)),
            exposure,
            spec.demodulate,
        )
        motion = torch.where(frame.moves > 0, motion, frame.motion)
        guides = guide_planes(frame.normal, frame.depth)
        held, trusted, noise, kept = self._look_back(frame, past, motion, guides, (light, exposure))
        relit = (frame.moves > 0) & (kept < LEAST_KEPT)
        final = torch.where(relit, own, exposure)
        held = torch.cat([held[:, :3], held[:, 3:] * trusted], 1)
        mean, total, sample, local = self.accumulate(frame, held, irradiance, light, final)
        disoccluded = (total <= sample[:, 4:]).to(torch.float32)
        counts = frame.counts
        total, worth = total * counts.share, sample[:, 3:4] * counts.share
        places = follow_nearer(motion, frame.depth)
        modulator, albedo, frames = self._albedo(frame, past, by, places)
        previous, valid = recall(past.output, places, sharp=self.options.sharp_recall)
        previous, valid = forget_uncovered(previous, valid, disoccluded, trusted)
        prepared = Prepared(
            irradiance=mean,
            held=total,
            light=light,
            radiance=luminance(frame.color),
            local=local,
            albedo=frame.albedo.clamp(min=0),
            normal=frame.normal,
            depth=frame.depth,
            divisor=modulator,
            previous=previous * frame.moves,
            valid=valid * frame.moves,
            exposure=final,
            depth_unit=depth_scale(frame.depth),
            told=counts.told,
            filter_spread=frame.filter_spread,
        )
        sample = torch.cat([sample[:, :3], worth], 1)
        if self.options.recall_noise:
            agreed, recalled = self._recalled(prepared, frame.color, worth, counts)
            left, held = believed(mean, total, sample, torch.where(frame.moves > 0, agreed, 1.0))
            prepared = replace(prepared, recalled=recalled, irradiance=left, held=held)
        numbers = torch.stack(
            [final, exposure * frame.moves, noise.frames * frame.moves, counts.mean, frames]
        )
        state = State(
            mean=torch.cat([mean, total], 1)[0].permute(1, 2, 0),
            guides=guides[0].permute(1, 2, 0),
            output=past.output,
            noise=noise.variance[0, 0] * frame.moves,
            numbers=numbers,
            albedo=albedo,
        )
        return prepared, sample, state

    def accumulate(
        self, frame: Buffers, held: Tensor, irradiance: Tensor, light: Tensor, exposure: Tensor
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Mean and samples, this frame's sample with its weights, and what is usual around pixels.

        ``(1, c, h, w)`` with 3, 1, 5 (as a new pixel's, then beside the past) and 1 channels;
        ``held`` is the past at these pixels.
        """
        spec, size = self.spec, self.spec.transfer.local_size
        local = local_luminance(tone_map(light, exposure), size)
        weight = sample_weight(light, local, held[:, 3:], exposure, spec.temporal)
        new, weight = bound(irradiance, weight)
        alone = sample_weight(light, local, torch.zeros_like(held[:, 3:]), exposure, spec.temporal)
        # without a past there is no sample beside the mean, which weighs as it was bounded
        alone = torch.where(frame.moves > 0, alone, weight)
        weight, alone = (
            torch.where(frame.broken > 0, FILLED_WEIGHT, each) for each in (weight, alone)
        )
        mean, total = accumulate(new, weight, held[:, :3], held[:, 3:], spec.temporal)
        if "local_luminance" in spec.network.features:
            local = local_luminance(tone_map(luminance(mean), exposure), size)
        return mean, total, torch.cat([new, alone, weight], 1), local

    def _albedo(
        self, frame: Buffers, past: State, by: Tensor, places: Tensor
    ) -> tuple[Tensor, Tensor | None, Tensor]:
        """What the result is multiplied by, what is remembered of it, and of how many frames."""
        if past.albedo is None:
            return by, None, past.numbers[4] * 0
        most = frame.counts.albedo_frames(self.spec.temporal.albedo_samples)
        held = past.numbers[4] * frame.moves
        modulator, mean, frames = accumulate_albedo(by, past.albedo, places, held, most)
        given = (frame.albedo.amax() >= 0).to(torch.float32)
        return modulator, mean[0].permute(1, 2, 0), frames * given

    def _look_back(
        self,
        frame: Buffers,
        past: State,
        motion: Tensor,
        guides: Tensor,
        exposed: tuple[Tensor, Tensor],
    ) -> tuple[Tensor, Tensor, Noise, Tensor]:
        """The past at these pixels, how far it is trusted, the noise, and the share that is kept.

        ``(1, 4, h, w)``, ``(1, 1, h, w)``, the next noise and a scalar; ``exposed`` are luminance
        and exposure.
        """
        spec, counts = self.spec, frame.counts
        light, exposure = exposed
        places = grid(motion) + motion
        held = reproject(past.mean, past.guides, guides, places, spec.temporal, past.output)
        held = held * frame.moves
        held = torch.cat([held[:, :3], held[:, 3:] * counts.past_scale / counts.share], 1)
        local = local_luminance(tone_map(light, exposure), spec.transfer.local_size)
        weight = sample_weight(light, local, held[:, 3:], exposure, spec.temporal)
        weight = weight * (1 - frame.broken)
        blocks = compare(light, weight, held, exposure)
        before = Noise(past.noise[None, None] * counts.past_scale, past.numbers[1], past.numbers[2])
        trusted, noise = confidence(blocks, before, motion, exposure)
        found = (blocks[:, :1] > 0).to(torch.float32).mean()
        return held, trusted, noise, trusted.mean() * found

    def reconstruct(self, frame: Prepared, sample: Tensor) -> tuple[Tensor, Tensor]:
        """What is remembered of the picture, and the picture, ``(1, 3, h, w)`` both.

        ``sample`` is irradiance and weight ``(1, 4, h, w)``.
        """
        height, width = frame.held.shape[2:]
        features = feature_planes(frame, self.spec)
        count = features.shape[1]
        planes = torch.cat([features, frame.irradiance, frame.held, sample], 1)
        planes = mirrored(planes, self.multiple)
        maps = level_parts(self.network(planes[:, :count]), self.options)
        light, held, new, worth = (
            planes[:, count + start : count + stop]
            for start, stop in ((0, 3), (3, 4), (4, 7), (7, 8))
        )
        light, held = blended_with_sample(light, held, new, worth, maps[0].sample_blend)
        scale = frame.exposure.reshape(1, 1, 1, 1)  # of irradiance; of the picture see below
        image = kernel_pyramid(light, held, maps, self.options, pooled_box_mean, scale)
        # what was added to whole cells goes before pixels are mixed with their neighbours
        weights = maps[0].resolve[..., :height, :width]
        by = averaged_albedo(frame.divisor, weights, self.options.albedo_filters)
        image = image[..., :height, :width] * by
        tone: Tensor | None = None
        if toned := self.options.resolve_tone:
            exposure = self._exposure(frame).reshape(1, 1, 1, 1)
            tone = toned * filter_sharpness(frame.filter_spread) * exposure
        valid = frame.valid if frame.recalled is None else frame.valid * frame.recalled
        image = resolve(image, weights, frame.previous, valid, tone)
        exposure, surface = self._exposure(frame), surface_weight(frame.normal, frame.depth)
        if window := self.spec.relief.window:
            radiance = frame.light * luminance(frame.divisor)
            image = image * relief_gain(image, radiance, surface, window, exposure)
        picture = image
        if self.spec.texture.window:
            picture = image * texture_gain(image, frame, surface[1], self.spec, exposure)
        if self.spec.lamps.restored:
            picture = restored(picture, sample[:, :3] * frame.divisor, exposure)
        if not self.spec.rare_light.restored:
            return image, picture
        gain = rare_light_gain(picture, frame.radiance, exposure)
        return image * gain, picture * gain

    def _recalled(
        self, frame: Prepared, color: Tensor, worth: Tensor, counts: SampleCounts
    ) -> tuple[Tensor, Tensor]:
        """What is taken of the past, see `stillray.stages.recall`."""
        exposure = self._exposure(frame)
        lights = frame.previous, color
        return recalled_share(lights, worth, frame.valid, exposure, counts, self.options)

    def _exposure(self, frame: Prepared) -> Tensor:
        """As the stages have it: without albedo they divide by nothing, this graph by a black's."""
        absent = (frame.albedo.amax() <= 0).to(torch.float32)
        return frame.exposure / (1 + self.spec.demodulate.specular * absent)


def repaired(
    color: Tensor,
    albedo: Tensor,
    normal: Tensor,
    depth: Tensor,
    motion: Tensor,
    samples: Tensor,
    past: State,
) -> Buffers:
    """Buffers as the stages want them, of buffers as a renderer has them.

    Parameters
    ----------
    color, albedo, normal, motion
        ``(h, w, channels)``.
    depth, samples
        ``(h, w)``.
    past
        Of which it counts whether there is one.
    """
    counts = SampleCounts(samples[None, None], past.numbers[3])
    radiance, broken = repair_radiance(_planes(color), counts.empty)
    unrepaired = _planes(motion)
    given = (unrepaired.abs().amin(1) <= MAX_MOTION).to(torch.float32).amax()
    kept = repair_feature(_planes(albedo), -1, 1)
    return Buffers(
        color=radiance,
        # not given at all, or no light where nothing was hit
        albedo=torch.where(kept.amax() < 0, kept, kept.clamp(min=0)),
        normal=repair_feature(_planes(normal), -1, 1),
        depth=repair_feature(depth[None, None], 0, MAX_DEPTH),
        motion=repair_motion(unrepaired),
        broken=broken,
        counts=counts,
        moves=given * (past.numbers[0] > 0).to(torch.float32),
    )


def _planes(image: Tensor) -> Tensor:
    return image.permute(2, 0, 1)[None]
