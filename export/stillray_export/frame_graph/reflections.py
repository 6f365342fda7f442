"""Motion that follows what mirrors show: the twin of `stages.specular_motion`."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F

from stillray.model_spec.stages import Demodulate
from stillray.stages import specular_motion as runtime
from stillray_export.frame_graph.camera import Camera, camera_motion, place
from stillray_export.frame_graph.exposure import size_of
from stillray_export.frame_graph.light import tone_map
from stillray_export.frame_graph.lookup import grid, linear_taps, mean_of, pixels_of, planes_like
from stillray_export.frame_graph.windows import every_second, mean_around, whole_blocks
from stillray_training.decoders.demodulate import is_black
from stillray_training.decoders.luminance import luminance

_LEVEL = 4  # of the pixels along an axis, one is looked at for mirrors


def follow_reflections(
    motion: Tensor,
    depth: Tensor,
    albedo: Tensor,
    lights: tuple[Tensor, Tensor],
    exposure: Tensor,
    options: Demodulate,
) -> Tensor:
    """Motion ``(1, 2, h, w)``, in mirrors that of what they show, if that is found.

    Parameters
    ----------
    motion : (1, 2, h, w)
        Of surfaces, pixels.
    depth : (1, 1, h, w)
        0 where nothing was hit; all 0 where it is not given.
    albedo : (1, 3, h, w)
        Below 0 where it is not given.
    lights
        Luminance of this frame's irradiance, and of the irradiance accumulated up to the previous
        one, ``(1, 1, h, w)`` each.
    exposure
        Scalar.
    options
        What is black.
    """
    height, width = depth.shape[2:]
    black = is_black(albedo, options)
    wanted = _has_mirrors(black, albedo)
    here, before = (whole_blocks(tone_map(light, exposure)) for light in lights)
    depth_here = every_second(depth)
    shows = every_second(black) * (depth_here > 0).to(torch.float32)
    camera = camera_motion(motion, depth)
    moved = every_second(motion)
    scene = _Scene(moved, depth_here, shows, here, before, size_of(depth), camera)
    found, follows = _search(scene)
    follows = _doubled(follows * wanted * camera.found, height, width) * black
    return torch.where(follows > 0, _doubled(found, height, width), motion)


def _doubled(planes: Tensor, height: int, width: int) -> Tensor:
    """Every pixel four times; zeros in the last row and column of odd sizes."""
    large = F.interpolate(planes, scale_factor=2.0, mode="nearest")
    return F.pad(large, (0, width % 2, 0, height % 2))[..., :height, :width]


def _has_mirrors(black: Tensor, albedo: Tensor) -> Tensor:
    """1 where so much of a frame may be mirrors that they are looked for; a scalar."""
    height, width = size_of(black)
    few = black[:, :, ::_LEVEL, ::_LEVEL]
    rows, columns = ((size / _LEVEL).round() for size in (height, width))
    at = grid(few)
    counted = ((at[:, :1] < columns) & (at[:, 1:] < rows)).to(torch.float32)
    least = (runtime._LEAST_SHARE * rows * columns).clamp(min=1)
    large = torch.minimum(height, width) >= runtime._LEAST_SIZE
    given = albedo.amax() >= 0
    some = (few * counted).sum() >= least
    return (some & large & given).to(torch.float32)


@dataclass(frozen=True, eq=False)
class _Scene:
    """What is searched, at half the resolution.

    Attributes
    ----------
    moved : (1, 2, h, w)
        Motion of the surfaces, full-size pixels.
    depth, shows, here, before : (1, 1, h, w)
        ``shows`` is 1 in mirrors; light is tone-mapped.
    size
        Of the whole frame, scalars.
    camera
        How still points move.
    """

    moved: Tensor
    depth: Tensor
    shows: Tensor
    here: Tensor
    before: Tensor
    size: tuple[Tensor, Tensor]
    camera: Camera


def _search(scene: _Scene) -> tuple[Tensor, Tensor]:
    """The motion of the best of the depths, and 1 where it is not the surface's."""
    height, width = scene.size
    longest = torch.maximum(height, width)
    places = grid(scene.depth)
    x, y = place(2 * places[:, :1], width, longest), place(2 * places[:, 1:], height, longest)
    depth = torch.where(scene.depth > 0, scene.depth, 1 / scene.camera.unit)
    far, near = scene.camera.parts(x, y, depth)
    astray = (far + near - scene.moved).abs().amax(1, keepdim=True)
    shows = scene.shows * (astray <= runtime._AGREES).to(torch.float32)
    pixels = pixels_of(scene.before)

    def apart(by: Tensor) -> Tensor:
        taps = linear_taps((places + by * 0.5).clamp(-1e6, 1e6), scene.before)
        taken = planes_like(mean_of(taps, pixels, zeros=False), scene.before)
        return mean_around((taken - scene.here).abs() * shows, runtime._WINDOW)

    least = apart(scene.moved) * float(runtime._NEARER)
    nearness, follows = torch.zeros_like(shows), torch.zeros_like(shows)
    for share in runtime._NEARNESS:
        distance = apart(far + near * share)
        nearer = (distance < least) & (shows > 0)
        follows = torch.where(nearer, 1.0, follows)
        least = torch.where(nearer, distance, least)
        nearness = torch.where(nearer, share, nearness)
    return far + near * nearness, follows


def light_of(history_nhwc: Tensor) -> Tensor:
    """Luminance of accumulated irradiance ``(h, w, 4)``, ``(1, 1, h, w)``."""
    return luminance(history_nhwc.permute(2, 0, 1)[None])
