"""One frame without a past as one module: color, albedo and normal to the picture.

For hosts that hand over planes and keep nothing between frames, as Unreal's NNE Denoiser does.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor, nn

from stillray.model_spec import ModelSpec
from stillray.model_spec.stages import Texture
from stillray_export.frame_graph.accumulation import SampleCounts
from stillray_export.frame_graph.color_curve import ColorCurve, decoded, encoded
from stillray_export.frame_graph.encode import Prepared
from stillray_export.frame_graph.exposure import frame_exposure
from stillray_export.frame_graph.frame import Buffers, FrameGraph
from stillray_export.frame_graph.repair import repair_feature, repair_radiance
from stillray_training.decoders.demodulate import divisor
from stillray_training.decoders.luminance import luminance

#: Planes of the input: color, albedo and normal, three each.
PLANES = 9
_LEAST_LENGTH = 1e-2  # of a normal that tells how normals are written


class SpatialGraph(nn.Module):
    """A kernel pyramid that denoises each frame alone.

    Parameters
    ----------
    network, spec
        As `FrameGraph` takes them.
    curve
        How color is written, in the input and in the picture.

    Raises
    ------
    InputError
        The model is of another family.
    """

    def __init__(self, network: nn.Module, spec: ModelSpec, curve: ColorCurve) -> None:
        super().__init__()
        # of one sample a pixel, as far as anybody says, no texture is put back
        spec = replace(spec, texture=Texture())
        self.frame, self.curve = FrameGraph(network, spec), curve

    def forward(self, planes: Tensor) -> Tensor:
        """``(1, PLANES, h, w)`` to the picture ``(1, 3, h, w)``."""
        color, albedo, normal = (planes[:, i : i + 3] for i in range(0, PLANES, 3))
        none = torch.zeros_like(planes[:, :1])
        counts = SampleCounts(none - 1, none.amax())
        radiance, broken = repair_radiance(decoded(color, self.curve), counts.empty)
        buffers = Buffers(
            color=radiance,
            albedo=repair_feature(albedo, 0, 1),
            normal=repair_feature(unit_normals(normal), -1, 1),
            depth=none,
            motion=torch.cat([none, none], 1),
            broken=broken,
            counts=counts,
            moves=none.amax(),
        )
        prepared, sample = alone(self.frame, buffers)
        _, image = self.frame.reconstruct(prepared, sample)
        return encoded(image, self.curve)


def alone(model: FrameGraph, frame: Buffers) -> tuple[Prepared, Tensor]:
    """A frame ready for the network, which is all there is, and its sample ``(1, 4, h, w)``."""
    spec, none = model.spec, torch.zeros_like(frame.depth)
    by = divisor(frame.albedo, spec.demodulate)
    irradiance = frame.color / by
    light = luminance(irradiance)
    exposure = frame_exposure(light, spec.transfer)
    held = torch.cat([none] * 4, 1)
    mean, total, sample, local = model.accumulate(frame, held, irradiance, light, exposure)
    prepared = Prepared(
        irradiance=mean,
        held=total,
        light=light,
        radiance=luminance(frame.color),
        local=local,
        albedo=frame.albedo,
        normal=frame.normal,
        depth=frame.depth,
        divisor=by,
        previous=torch.cat([none] * 3, 1),
        valid=none,
        exposure=exposure,
        depth_unit=torch.ones(()),
        told=frame.counts.told,
    )
    return prepared, sample[:, :4]


def unit_normals(normal_nchw: Tensor) -> Tensor:
    """Normals ``(1, 3, h, w)`` as vectors, however they are written: as such, or moved to [0, 1].

    Which of both, the frame's lengths tell: those of unit vectors are nearer to 1 in one of them.
    What is 0 stays 0, and a frame without any normal has none.
    """
    moved = 2 * normal_nchw - 1
    length, moved_length = (
        each.square().sum(1, keepdim=True).sqrt() for each in (normal_nchw, moved)
    )
    there = (length > _LEAST_LENGTH) & (moved_length > _LEAST_LENGTH)
    error, moved_error = (
        torch.where(there, (each - 1).abs().clamp(max=1), 0.0).mean()
        for each in (length, moved_length)
    )
    found = torch.where(moved_error < error, moved, normal_nchw)
    told = there.to(torch.float32).amax()
    return torch.where((length > 0) & (told > 0), found, 0.0)
