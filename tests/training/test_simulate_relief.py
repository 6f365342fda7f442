from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray_training.simulate.mesh import quad
from stillray_training.simulate.sequence import open_world
from stillray_training.simulate.shading_normal import bent_shapes, shading_normal
from stillray_training.simulate.textures import Relief, Texture
from stillray_training.simulate.world import Piece, Sky, Surface, World
from tests.training.simulate_worlds import noisy, opened

TURN = ([2 / 7, 3 / 7, 6 / 7], 50)  # unit axis and degrees


@pytest.fixture(scope="module", params=["scalar_rgb", "llvm_ad_rgb"])
def mi(request):
    return opened(request.param)


def moulding(depth):
    picture = Texture(kind="moulding", seed=3, low=(0,) * 3, high=(1,) * 3, size=1.0)
    return Relief(picture=picture, depth=depth)


def test_a_raised_frame_slopes_away_from_its_crest():
    normals = moulding(0.02).normals() * 2 - 1
    middle = normals[len(normals) // 2]  # from left to right through both uprights of the frame
    first, last = np.flatnonzero(np.abs(middle[:, 0]) > 0.05)[[0, -1]]
    assert middle[first, 0] < 0 < middle[last, 0]
    upright = normals[:, len(normals) // 2]
    top, bottom = np.flatnonzero(np.abs(upright[:, 1]) > 0.05)[[0, -1]]
    assert upright[bottom, 1] < 0 < upright[top, 1]  # row 0 is on top
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1, atol=1e-5)


def test_slopes_are_the_depth_over_the_metres_it_rises_in():
    flat, deep = moulding(0.01).normals() * 2 - 1, moulding(0.03).normals() * 2 - 1
    slope = flat[..., :2] / flat[..., 2:]
    np.testing.assert_allclose(deep[..., :2] / deep[..., 2:], 3 * slope, atol=1e-4)


@pytest.mark.parametrize("kind", ["normalmap", "bumpmap"])
def test_the_normal_shown_is_the_one_the_material_shades_with(mi, kind):
    rng = np.random.default_rng(0)
    texture = rng.random((4, 4, 3) if kind == "normalmap" else (8, 8, 1)).astype(np.float32)
    if kind == "normalmap":
        texture[..., 2] = 0.9
    bitmap = {"type": "bitmap", "raw": True, "bitmap": mi.Bitmap(texture)}
    bent = {"type": kind, "normalmap" if kind == "normalmap" else "heights": bitmap,
            "inner": {"type": "diffuse"}}  # fmt: skip
    if kind == "bumpmap":
        bent["scale"] = 0.2
    place = mi.ScalarTransform4f().rotate(*TURN)
    scene = mi.load_dict({
        "type": "scene",
        "one": {"type": "rectangle", "to_world": place, "m": {"type": "twosided", "in": bent}},
        "other": {"type": "sphere", "center": [0, 0, -9]},
    })  # fmt: skip
    found = bent_shapes(mi, scene.shapes())
    assert [one.kind for one in found] == [kind]
    normal = np.array(place @ mi.ScalarVector3f(0, 0, 1))
    spot = np.array(place @ mi.ScalarPoint3f(0.3, 0.2, 0))
    si = scene.ray_intersect(
        mi.Ray3f(mi.Point3f((spot + 2 * normal).tolist()), mi.Vector3f((-normal).tolist()))
    )
    shown = np.array(shading_normal(mi, found, si, si.is_valid())).ravel()
    # a diffuse material reflects by the cosine to the normal it shades with: three give that normal
    ways = np.array([(0.1, 0, 1), (0, 0.1, 1), (-0.1, -0.1, 1)])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    values, world = [], []
    for way in ways:
        local = mi.Vector3f(way.tolist())
        values.append(np.array(si.bsdf().eval(mi.BSDFContext(), si, local)).ravel()[0])
        world.append(np.array(si.to_world(local)).ravel())
    shaded = np.linalg.solve(np.array(world), np.array(values))
    np.testing.assert_allclose(shown, shaded / np.linalg.norm(shaded), atol=1e-3)
    assert shown @ normal < 0.999  # it is bent


def test_relief_bends_the_normals_of_a_flat_wall_and_no_others(mi):
    surface = Surface(color=(0.5,) * 3, relief=moulding(0.05))
    wall = Piece(mesh=quad([-2, -1, 0], [4, 0, 0], [0, 4, 0]), surface=surface)
    world = World(label="wall", pieces=[wall], sky=Sky())
    flat = noisy(mi, world, ("environment",), height=48, width=48)
    bent = noisy(mi, world, ("environment", "relief"), height=48, width=48)
    wall_seen = flat["depth"] > 0
    np.testing.assert_allclose(flat["normal"][wall_seen][:, 2], 1, atol=1e-5)
    assert (bent["normal"][wall_seen][:, 2] < 0.95).mean() > 0.02
    for layer in ("depth", "motion", "albedo"):
        np.testing.assert_array_equal(flat[layer], bent[layer])


def test_normals_of_a_file_are_those_of_its_normal_maps(mi, tmp_path):
    tilt = np.full((2, 2, 3), (0.5 + 0.5 * 0.6, 0.5, 0.5 + 0.5 * 0.8), np.float32)
    mi.Bitmap(tilt).write(str(tmp_path / "n.exr"))
    (tmp_path / "scene.xml").write_text("""<scene version="3.0.0">
  <sensor type="perspective"><transform name="to_world">
    <lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform></sensor>
  <shape type="rectangle"><bsdf type="normalmap">
    <texture type="bitmap" name="normalmap"><string name="filename" value="n.exr"/>
      <boolean name="raw" value="true"/></texture><bsdf type="diffuse"/></bsdf></shape>
  <emitter type="constant"/></scene>""")
    world = open_world(mi, str(tmp_path / "scene.xml"), 0)
    layers = noisy(mi, world, None)
    seen = layers["depth"] > 0
    assert seen.any()
    np.testing.assert_allclose(layers["normal"][seen], [(0.6, 0, 0.8)] * seen.sum(), atol=1e-3)
