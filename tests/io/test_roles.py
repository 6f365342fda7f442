"""Channel names of each renderer lead to the right buffers, with the right signs."""

from importlib import resources

import numpy as np
import pytest

from stillray.errors import InputError
from stillray.io.channels.renderers import parse_table
from stillray.io.channels.roles import (
    find_alone,
    find_layers,
    find_light,
    find_lights,
    gather,
    parse_overrides,
)


def roles(names):
    return {match.role: match for match in find_layers(names)}


def layer(name, parts):
    return [f"{name}.{part}" if name else part for part in parts]


def test_own_layout_gives_every_role():
    names = [*"RGB", *layer("albedo", "RGB"), *layer("normal", "XYZ"), "depth.Z"]
    found = roles([*names, *layer("motion", "XY")])
    assert list(found) == ["color", "albedo", "normal", "depth", "motion"]
    assert found["motion"].channels == ("motion.X", "motion.Y")
    assert found["motion"].signs == (1.0, 1.0)


def test_guides_of_upscaling_are_found():
    own = roles([*"RGB", "roughness.Y", *layer("specular_albedo", "RGB")])
    assert own["roughness"].channels == ("roughness.Y",)
    assert own["specular_albedo"].channels[0] == "specular_albedo.R"
    theirs = roles([*blender("ViewLayer"), *layer("ViewLayer.Glossy Color", "RGB")])
    assert theirs["specular_albedo"].channels[0] == "ViewLayer.Glossy Color.R"


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            [*layer("RGBA", "RGBA"), *layer("denoise_albedo", "RGB"), *layer("N", "XYZ"), "Z"],
            {"color": "RGBA.R", "albedo": "denoise_albedo.R", "normal": "N.X", "depth": "Z"},
        ),
        (
            [*"RGB", *layer("Albedo", "RGB"), *layer("P", "XYZ"), *layer("N", "XYZ"),
             *layer("Ns", "XYZ"), *layer("Variance", "RGB")],
            {"color": "R", "albedo": "Albedo.R", "normal": "Ns.X"},
        ),
        (
            [*"RGB", *layer("Albedo", "RGB"), "Px", "Py", "Pz", "Nsx", "Nsy", "Nsz"],
            {"color": "R", "albedo": "Albedo.R", "normal": "Nsx"},
        ),
        (
            [*layer("Ci", "rgb"), "a", *layer("albedo", "rgb"), *layer("normal", "xyz"),
             *layer("albedo_var", "rgb"), "zfiltered", "zfiltered_var", "sampleCount"],
            {"color": "Ci.r", "albedo": "albedo.r", "normal": "normal.x", "depth": "zfiltered",
             "samples": "sampleCount"},
        ),
        (
            [*layer("img", "RGBA"), *layer("albedo", "RGB"), *layer("sh_normal", "XYZ"),
             *layer("pos", "XYZ"), "dd.y.T"],
            {"color": "img.R", "albedo": "albedo.R", "normal": "sh_normal.X", "depth": "dd.y.T"},
        ),
        (
            [*layer("VL.Combined", "RGBA"), *layer("VL.ALBEDO", "RGB"),
             *layer("VL.AVG_SHADING_NORMAL", "XYZ"), "VL.DEPTH.Z"],
            {"color": "VL.Combined.R", "albedo": "VL.ALBEDO.R",
             "normal": "VL.AVG_SHADING_NORMAL.X", "depth": "VL.DEPTH.Z"},
        ),
    ],
    ids=["arnold", "pbrt", "pbrt-older", "renderman", "mitsuba", "luxcore"],
)  # fmt: skip
def test_other_renderers_names_are_known(names, expected):
    found = roles(names)
    assert {role: match.channels[0] for role, match in found.items()} == expected


def blender(view_layer, *, denoising=True):
    names = [*layer("Combined", "RGBA"), "Depth.Z", *layer("Normal", "XYZ")]
    names += layer("Vector", "XYZW")
    if denoising:
        names += [*layer("Noisy Image", "RGBA"), *layer("Denoising Albedo", "RGB")]
        names += [*layer("Denoising Normal", "XYZ"), "Denoising Depth.Z"]
    return [f"{view_layer}.{name}" for name in names]


def test_blender_noisy_image_and_denoising_passes_come_first():
    found = roles(blender("ViewLayer"))
    assert found["color"].channels[0] == "ViewLayer.Noisy Image.R"
    assert found["normal"].channels[0] == "ViewLayer.Denoising Normal.X"
    assert found["depth"].channels == ("ViewLayer.Denoising Depth.Z",)
    assert {match.renderer for match in found.values()} == {"Blender"}


def test_blender_motion_negates_y():
    match = roles(blender("ViewLayer"))["motion"]
    assert match.channels == ("ViewLayer.Vector.X", "ViewLayer.Vector.Y")
    x, y = match.channels
    planes = {x: np.full((2, 3), 3.0), y: np.full((2, 3), 5.0)}
    motion = gather(match, planes)
    assert motion.shape == (2, 3, 2)
    assert motion[0, 0].tolist() == [3.0, -5.0]
    assert "negated" in match.note


def test_buffers_of_two_view_layers_are_never_mixed():
    found = roles([*blender("Back", denoising=False)[:4], *blender("Front")])
    assert all(name.startswith("Front.") for m in found.values() for name in m.channels)
    assert "Back" in found["color"].note


def test_plain_color_goes_with_the_features_of_a_view_layer():
    # Blender 5's first part may hold the combined image as plain R, G, B
    found = roles([*"RGBA", *layer("ViewLayer.Denoising Albedo", "RGB")])
    assert found["color"].channels == ("R", "G", "B")
    assert found["albedo"].channels[0] == "ViewLayer.Denoising Albedo.R"


@pytest.mark.parametrize(
    "names", [layer("motionvector", "XY"), layer("motionvector", "RGB"), layer("backward", "xyz")]
)
def test_motion_of_unverified_sign_is_reported_but_not_used(names):
    match = roles([*"RGB", *names])["motion"]
    assert not match.used
    assert "not verified" in match.note


def test_position_is_not_taken_for_a_normal():
    assert "normal" not in roles([*"RGB", *layer("pos", "XYZ"), *layer("P", "XYZ")])


def test_incomplete_layers_are_not_matched():
    assert roles(["R", "G", "albedo.R", "albedo.G", "normal.X"]) == {}


def test_two_layers_with_alpha_are_not_guessed_between():
    assert roles([*layer("first", "RGBA"), *layer("second", "RGBA")]) == {}


@pytest.mark.parametrize(
    ("role", "names", "expected"),
    [
        ("albedo", [*"RGB"], ("R", "G", "B")),
        ("normal", [*"XYZ"], ("X", "Y", "Z")),
        ("normal", [*"RGBA"], ("R", "G", "B")),
        ("depth", ["Y"], ("Y",)),
        ("depth", ["distance"], ("distance",)),
        ("motion", [*"RGB"], ("R", "G")),
        ("albedo", [*"RGB", *layer("albedo", "RGB")], ("albedo.R", "albedo.G", "albedo.B")),
    ],
)
def test_a_file_of_one_buffer_may_use_plain_names(role, names, expected):
    match = find_alone(role, names)
    assert match is not None
    assert match.channels == expected


def test_a_file_of_one_buffer_never_yields_unverified_motion():
    assert find_alone("motion", layer("motionvector", "XY")) is None


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (
            [*"RGB", *layer("diffuse", ["red", "green", "blue"]), *layer("bump_normals", "XYZ"),
             "Z", *layer("velocity", "XYZ")],
            {"color": "R", "albedo": "diffuse.red", "normal": "bump_normals.X", "depth": "Z",
             "motion": "velocity.X"},
        ),
        (
            [*"RGBA", *layer("DiffuseFilter", "RGB"), *layer("N", "RGB"), "Z",
             *layer("MotionVectors", "RG"), *layer("Cryptomatte00", "RGBA")],
            {"color": "R", "albedo": "DiffuseFilter.R", "normal": "N.R", "depth": "Z",
             "motion": "MotionVectors.R"},
        ),
        (
            [*layer("Beauty", "RGBA"), *layer("Denoise Albedo", "RGB"),
             *layer("denoise_normal", "RGB"), *layer("Z-Depth", "RGB"),
             *layer("Motion vector", "RGB")],
            {"color": "Beauty.R", "albedo": "Denoise Albedo.R", "normal": "denoise_normal.R",
             "depth": "Z-Depth.R", "motion": "Motion vector.R"},
        ),
        (
            [*layer("diffuse", "RGB"), *"RGB", *layer("specular", "RGB")],  # Arnold's is light
            {"color": "R"},
        ),
    ],
    ids=["v-ray", "redshift", "octane", "arnold-lights"],
)  # fmt: skip
def test_names_of_more_renderers_are_known(names, expected):
    found = roles(names)
    assert {role: match.channels[0] for role, match in found.items()} == expected


def test_exact_spelling_comes_before_a_loose_one():
    names = [*"RGB", *layer("Denoise_Albedo", "RGB"), *layer("denoise_albedo", "RGB")]
    assert roles(names)["albedo"].channels[0] == "denoise_albedo.R"


def test_chosen_layers_come_before_all_that_is_found():
    names = [*"RGB", *layer("albedo", "RGB"), *layer("flat", "rgb"), "dist", *layer("vel", "RG")]
    chosen = parse_overrides(["albedo=flat", "depth=dist", "motion=vel.R,-vel.G", "color=none"])
    found = {match.role: match for match in find_layers(names, chosen)}
    assert found["albedo"].channels == ("flat.r", "flat.g", "flat.b")
    assert found["depth"].channels == ("dist",)
    assert found["motion"].signs == (1.0, -1.0)
    assert found["motion"].used
    assert "color" not in found


def test_motion_chosen_by_an_unknown_layer_waits_for_proof():
    chosen = {"motion": "vel"}
    match = {m.role: m for m in find_layers([*"RGB", *layer("vel", "RG")], chosen)}["motion"]
    assert not match.used
    assert match.channels == ("vel.R", "vel.G")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("albedo", "ROLE=NAME"),
        ("colour=RGB", "role of color, albedo"),
        ("albedo=", "ROLE=NAME"),
        ("albedo=gone", "albedo=gone: must name a layer"),
        ("normal=-N.X,N.Y,N.Z", "without a minus"),
        ("motion=N.X", "2 of its channels"),
    ],
)
def test_a_wrong_choice_is_refused_with_what_there_is(text, words):
    with pytest.raises(InputError, match=words):
        find_layers([*"RGB", *layer("N", "XYZ")], parse_overrides([text]))


def test_a_name_may_leave_out_the_view_layer_where_it_is_the_only_one():
    names = [*blender("Front"), *layer("Front.Glow", "RGB"), *layer("Back.Glow", "RGB")]
    chosen = parse_overrides(["albedo=Denoising Albedo", "depth=Denoising Depth.Z"])
    found = {match.role: match for match in find_layers(names, chosen)}
    assert found["albedo"].renderer == "chosen"
    assert found["albedo"].channels == tuple(layer("Front.Denoising Albedo", "RGB"))
    assert found["depth"].channels == ("Front.Denoising Depth.Z",)
    with pytest.raises(InputError, match=r"layer albedo=Glow: .* of Front\.Glow, Back\.Glow$"):
        find_layers(names, {"albedo": "Glow"})
    whole = find_layers(names, {"albedo": "Back.Glow"})
    assert tuple(layer("Back.Glow", "RGB")) in [match.channels for match in whole]
    # a component is no name of a layer
    with pytest.raises(InputError, match="depth=Z: must name a layer"):
        find_layers([*"RGB", "Front.Normal.Z"], {"depth": "Z"})


def test_motion_without_its_view_layer_means_what_its_renderer_says():
    found = find_layers(blender("Front"), {"motion": "Vector"})
    match = next(match for match in found if match.role == "motion")
    assert match.used
    assert match.signs == (1.0, -1.0)


def test_a_layer_of_light_is_named_with_or_without_its_view_layer():
    names = [*blender("Front"), *layer("Front.Glow", "RGB"), *layer("Back.Glow", "RGB")]
    names += layer("Front.Key", "RGB")
    assert find_light("Front.Key", names) == tuple(layer("Front.Key", "RGB"))
    assert find_light("Key", names) == tuple(layer("Front.Key", "RGB"))
    with pytest.raises(InputError, match=r"aovs must name one .* Glow: of Front\.Glow, Back\.Glow"):
        find_light("Glow", names)
    with pytest.raises(InputError, match=r"aovs must name .*, got none; the file has .*Front\.Key"):
        find_light("none", names)


def test_a_role_chosen_twice_is_refused():
    with pytest.raises(InputError, match="albedo once"):
        parse_overrides(["albedo=a", "albedo=b"])


def test_layers_of_light_are_told_from_data():
    data = [*layer("albedo", "RGB"), *layer("N", "XYZ"), *layer("crypto_object00", "RGBA"),
            *layer("diffuse_albedo", "RGB"), *layer("specular_variance", "RGB"),
            *layer("P", "RGB"), "diffuse_depth.Z"]  # fmt: skip
    lights = [
        *layer("diffuse", "RGB"),
        *layer("specular_direct", "RGB"),
        *layer("RGBA_key", "RGBA"),
    ]
    found = find_lights([*layer("RGBA", "RGBA"), *data, *lights])
    assert list(found) == ["diffuse", "specular_direct", "RGBA_key"]
    assert found["RGBA_key"] == ("RGBA_key.R", "RGBA_key.G", "RGBA_key.B")


def test_layers_of_light_come_from_the_view_layer_of_the_color():
    names = [*blender("Front"), *layer("Front.Diffuse Direct", "RGB")]
    names += [*layer("Front.Diffuse Color", "RGB"), *layer("Back.Diffuse Direct", "RGB")]
    assert list(find_lights(names)) == ["Front.Diffuse Direct"]


def test_the_table_refuses_keys_that_mean_nothing():
    text = (resources.files("stillray.io.channels") / "renderers.toml").read_text(encoding="utf-8")
    assert len(parse_table(text).rules) > 40
    with pytest.raises(ValueError, match="albeddo"):
        parse_table(text + '\n[[renderer]]\nname = "x"\nalbeddo = ["a"]\n')
