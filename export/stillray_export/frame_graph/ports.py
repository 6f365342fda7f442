"""What a frame graph takes and gives, told in its own file.

An engineer binds these by name without reading Python: `stillray info --graph` prints them.
"""

from __future__ import annotations

from stillray.model_spec import ModelSpec
from stillray.models.frame_graph import Port, Ports
from stillray_export.frame_graph.color_curve import ColorCurve
from stillray_export.frame_graph.frame import NOISE_BLOCK, NUMBERS
from stillray_export.frame_graph.spatial import PLANES

_IMAGE = "height, width"
BUFFERS = (
    Port(
        name="color",
        shape=f"{_IMAGE}, 3",
        unit="scene-linear radiance",
        convention="row 0 at the top; noisy; NaN, infinities and negatives are repaired",
    ),
    Port(
        name="albedo",
        shape=f"{_IMAGE}, 3",
        unit="reflectance, 0 to 1",
        convention="0 in mirrors, in glass and where nothing was hit",
        neutral="-1",
    ),
    Port(
        name="normal",
        shape=f"{_IMAGE}, 3",
        unit="unit vector",
        convention="shading normal in any fixed space; 0 where nothing was hit",
        neutral="0",
    ),
    Port(
        name="depth",
        shape=_IMAGE,
        unit="any, the same in all frames",
        convention="camera z or distance; 0 or infinity where nothing was hit",
        neutral="0",
    ),
    Port(
        name="motion",
        shape=f"{_IMAGE}, 2",
        unit="pixels, x right and y down",
        convention="where the point was in the previous frame minus where it is now; without it "
        "nothing is accumulated",
        neutral="1e7",
    ),
    Port(
        name="samples",
        shape=_IMAGE,
        unit="samples a pixel",
        convention="that color is the mean of; one number may fill a tensor of 1, 1; a pixel with "
        "0 is filled in",
        neutral="-1",
    ),
)

_FILTER = Port(
    name="filter_spread",
    shape=_IMAGE,
    unit="pixels",
    convention="standard deviation of the renderer's pixel filter, one number in a tensor of 1, 1: "
    "0.29 of a box, 0.42 of Blender's usual one",
    neutral="-1",
)


def states(spec: ModelSpec) -> tuple[Port, ...]:
    """The state's inputs, in the order of `frame.State`."""

    def state(name: str, shape: str, unit: str, convention: str) -> Port:
        return Port(
            name=f"past_{name}",
            shape=shape,
            unit=unit,
            convention=convention,
            neutral="0",
            next=f"next_{name}",
        )

    found = [
        state(
            "mean", f"{_IMAGE}, 4", "irradiance; samples", "accumulated light, and what holds it"
        ),
        state("guides", f"{_IMAGE}, 4", "unit vector; log depth", "geometry of the last frame"),
        state("output", f"{_IMAGE}, 3", "scene-linear radiance", "the last picture"),
        state(
            "noise",
            f"ceil(height / {NOISE_BLOCK}), ceil(width / {NOISE_BLOCK})",
            "squared exposed irradiance",
            "variance of one sample by blocks of pixels",
        ),
        state(
            "numbers",
            str(NUMBERS),
            "none",
            "exposure, which is 0 before the first frame and at a cut; exposure and frames of the "
            "noise; samples a pixel; frames of the albedo",
        ),
    ]
    if spec.temporal.albedo_samples > 0:
        found.append(state("albedo", f"{_IMAGE}, 3", "reflectance, 0 to 1", "mean of a few frames"))
    return tuple(found)


def ports(spec: ModelSpec) -> Ports:
    """All inputs and outputs, in order."""
    picture = Port(
        name="denoised",
        shape=f"{_IMAGE}, 3",
        unit="scene-linear radiance",
        convention="row 0 at the top; finite, not negative",
    )
    state = states(spec)
    left = [
        Port(
            name=port.next,
            shape=port.shape,
            unit=port.unit,
            convention=f"{port.name} of the next frame",
        )
        for port in state
    ]
    told = [_FILTER] if spec.knows_filter else []
    return Ports(inputs=(*BUFFERS, *told, *state), outputs=(picture, *left))


_COLOR = {
    ColorCurve.OIDN: "radiance times any exposure through Open Image Denoise's HDR curve, 0 to 1",
    ColorCurve.LINEAR: "scene-linear radiance",
}


def spatial_ports(curve: ColorCurve) -> Ports:
    """The input and the output of a graph of a frame alone."""
    planes = Port(
        name="planes",
        shape=f"1, {PLANES}, {_IMAGE}",
        unit="planes 0 to 2 color, 3 to 5 albedo, 6 to 8 normal",
        convention=f"row 0 at the top; color is {_COLOR[curve]}, noisy; albedo 0 to 1, 0 where "
        "nothing was hit; normals of length 1, or halved and moved to 0 to 1",
    )
    picture = Port(
        name="denoised",
        shape=f"1, 3, {_IMAGE}",
        unit=f"color: {_COLOR[curve]}",
        convention="row 0 at the top; finite, not negative",
    )
    return Ports(inputs=(planes,), outputs=(picture,))
