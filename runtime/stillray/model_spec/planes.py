"""Planes that networks read, by name."""

from __future__ import annotations

PIXEL_FILTER = "pixel_filter"  # the plane that tells of it
#: Every network input plane by name, in the order that `stillray.stages.features` describes them.
FEATURES = (
    "irradiance.r", "irradiance.g", "irradiance.b", "irradiance.luminance",
    "sample.luminance", "local_luminance", "samples", PIXEL_FILTER,
    "albedo.r", "albedo.g", "albedo.b", "albedo.luminance",
    "normal.x", "normal.y", "normal.z", "depth",
    "previous.r", "previous.g", "previous.b", "previous.luminance", "previous.valid",
    # as Fan et al. 2021, section 5.1, have it: radiance with its albedo as displayed, normals in
    # [0, 1]
    "ldr.r", "ldr.g", "ldr.b", "scaled_normal.x", "scaled_normal.y", "scaled_normal.z",
    "pilot_a.r", "pilot_a.g", "pilot_a.b", "pilot_b.r", "pilot_b.g", "pilot_b.b",
)  # fmt: skip
#: What the network of a model that learns while it denoises is given, in this order.
ONLINE_FEATURES = (
    "pilot_a.r", "pilot_a.g", "pilot_a.b", "pilot_b.r", "pilot_b.g", "pilot_b.b",
    "albedo.r", "albedo.g", "albedo.b", "normal.x", "normal.y", "normal.z",
    "previous.r", "previous.g", "previous.b",
)  # fmt: skip
#: Planes of a network of two branches, in the order that `stillray.families.target_planes` fills
#: them; counts of samples are told by sines and cosines, see there.
RADIANCE_FEATURES = (
    "color.r", "color.g", "color.b", "past.r", "past.g", "past.b",
    "output.r", "output.g", "output.b",
    "past.count.0", "past.count.1", "past.count.2", "past.count.3", "offset.x", "offset.y",
)  # fmt: skip
GUIDE_FEATURES = (
    "albedo.r", "albedo.g", "albedo.b", "specular.r", "specular.g", "specular.b",
    "normal.x", "normal.y", "normal.z", "roughness", "depth", "depth.change",
    "past_albedo.r", "past_albedo.g", "past_albedo.b",
    "past_specular.r", "past_specular.g", "past_specular.b",
    "past_albedo.count.0", "past_albedo.count.1", "past_albedo.count.2", "past_albedo.count.3",
    "past_specular.count.0", "past_specular.count.1", "past_specular.count.2",
    "past_specular.count.3", "offset.x", "offset.y",
)  # fmt: skip
