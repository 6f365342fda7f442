"""Layers of light that a renderer gives without the colour of surfaces: they keep adding up.

Blender's beauty is (Diffuse Direct + Diffuse Indirect) * Diffuse Color + ... + Emission. What
kernels do is linear in radiance, so light times colour is filtered, and the colour too; what is
written for the light is the quotient. Light times colour, of what is written, is then a filtered
part of the beauty, and those parts add up to the filtered beauty as they did to the noisy one.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillray.frame import Frame
from stillray.io.channels.roles import color_of_light
from stillray.pipeline.denoiser import Denoiser


def denoise_lights(
    denoiser: Denoiser, frame: Frame, layers: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Denoise the next frame and its layers of light.

    Parameters
    ----------
    denoiser
        Whose frame it is.
    frame
        The buffers.
    layers
        By name, from `stillray.io.exr.read.read_lights`. Light whose colour is not among
        them is filtered as it is.

    Returns
    -------
    image : (h, w, 3) float32
        The clean picture.
    layers
        By name: ``(h, w, 3)`` float32; a light without its colour is 0 where the colour is.

    Raises
    ------
    InputError
        As `Denoiser.denoise_layers`.
    """
    bare = {name: color for name in layers if (color := color_of_light(name)) is not None}
    colors = {name: color for name, color in bare.items() if color in layers}
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite counts as 0
        radiance = {
            name: layer * layers[colors[name]] if name in colors else layer
            for name, layer in layers.items()
        }
    lonely = bare.keys() - colors.keys()
    image, clean = denoiser.denoise_layers(frame, radiance, irradiance=lonely)
    found = dict(clean)
    for name, color in colors.items():
        light = np.zeros_like(clean[name])
        np.divide(clean[name], clean[color], out=light, where=clean[color] > 0)
        found[name] = light
    return image, found
