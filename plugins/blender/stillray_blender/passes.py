# SPDX-License-Identifier: GPL-3.0-or-later
"""The passes that a clean picture is made from: which are missing, and how to get them."""

_SET_UP = "Render properties > stillray > Set Up Passes"
_NO_FEATURES = "no {}: textures and edges come out softer"
_NO_VECTOR = "no Vector pass: every frame is denoised alone"


def missing(scene, layer) -> list[str]:
    """What the settings of a view layer lack, in words.

    Parameters
    ----------
    scene : bpy.types.Scene
    layer : bpy.types.ViewLayer
        One of its view layers.
    """
    lacks = []
    if not layer.cycles.denoising_store_passes:
        lacks.append(f"{_NO_FEATURES.format('Denoising Data passes')} ({_SET_UP})")
    if scene.stillray.temporal:
        if scene.render.use_motion_blur:
            lacks.append(
                "motion blur empties the Vector pass: every frame is denoised alone "
                "(Render properties > Motion Blur)"
            )
        elif not layer.use_pass_vector:
            lacks.append(f"{_NO_VECTOR} ({_SET_UP})")
    return lacks


def missing_in_file(path: str, *, temporal: bool) -> list[str]:
    """What a rendered file lacks, in words.

    Parameters
    ----------
    path
        Of an OpenEXR multilayer file.
    temporal
        Whether previous frames are asked for.

    Raises
    ------
    stillray.InputError
        It cannot be read.
    """
    from stillray.io.channels.roles import find_layers
    from stillray.io.exr.file import ExrFile

    matches = find_layers(ExrFile.open(path, headers_only=True).channels)
    found = {match.role for match in matches}
    features = [role for role in ("albedo", "normal", "depth") if role not in found]
    lacks = [_NO_FEATURES.format(f"pass for {', '.join(features)}")] if features else []
    if temporal and "motion" not in found:
        lacks.append(_NO_VECTOR)
    # of several view layers one is denoised
    return lacks + [match.note for match in matches if "layers are not used" in match.note]


def set_up(scene) -> list[str]:
    """Turn on what the scene's view layers lack; what was changed, in words."""
    done = []
    for layer in scene.view_layers:
        if not layer.use:
            continue
        if not layer.cycles.denoising_store_passes:
            layer.cycles.denoising_store_passes = True
            done.append(f"{layer.name}: Denoising Data")
        if not layer.use_pass_vector:
            layer.use_pass_vector = True
            done.append(f"{layer.name}: Vector")
    if scene.cycles.use_denoising:
        scene.cycles.use_denoising = False  # its picture would not be looked at
        done.append("Cycles' own denoiser off")
    return done


def samples_of(scene, layer) -> int:
    """Samples a pixel that Cycles takes for a view layer; the most, where it adapts them."""
    count, own = scene.cycles.samples, layer.samples
    if own == 0 or scene.cycles.use_layer_samples == "IGNORE":
        return count
    return min(count, own) if scene.cycles.use_layer_samples == "BOUNDED" else own


def filter_spread_of(scene) -> float:
    """Standard deviation of Cycles' pixel filter, in pixels."""
    from stillray.pixel_filter import cycles_spread

    return cycles_spread(scene.cycles.pixel_filter_type, scene.cycles.filter_width)
