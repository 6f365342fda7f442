from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("mitsuba")

import cv2

from stillray.errors import InputError
from stillray_training.simulate.assets import Library, read_ply
from stillray_training.simulate.generators import generate
from stillray_training.simulate.generators.home import Home
from stillray_training.simulate.jobs import Job, run_job
from stillray_training.simulate.mesh import translation
from stillray_training.simulate.plan import make_plan
from stillray_training.simulate.sequence import SequenceOptions
from stillray_training.simulate.variant import load_mitsuba
from stillray_training.simulate.world import Sky, World
from tests.training.simulate_worlds import noisy, opened

SCENE = """<scene version="3.0.0">
  <bsdf id="m" type="twosided"><bsdf type="normalmap">
    <texture type="bitmap" name="normalmap"><string name="filename" value="n.png"/>
      <boolean name="raw" value="true"/></texture>
    <bsdf type="principled"><rgb name="base_color" value="0.6, 0.3, 0.1"/>
      <float name="roughness" value="0.5"/></bsdf></bsdf></bsdf>
  <shape type="ply" id="s"><string name="filename" value="mesh.ply"/>{more}
    <ref name="bsdf" id="m"/></shape>
</scene>"""
MATRIX = "1 0 0 0 0 1 0 0.25 0 0 1 0 0 0 0 1"
MOVED = f'<transform name="to_world"><matrix value="{MATRIX}"/></transform>'


ROUGH = """<texture type="bitmap" name="roughness"><string name="filename" value="r.png"/>
        <boolean name="raw" value="true"/></texture>"""


def write_asset(folder, name="chair", kind="furniture", more="", scene=SCENE):
    """A square of 1 m that stands on y = 0 and faces +z, its normals bent to the right."""
    here = folder / name
    here.mkdir(parents=True)
    square = [(-0.5, 0), (0.5, 0), (0.5, 1), (-0.5, 1)]
    rows = [(x, y, 0, 0, 0, 1, x + 0.5, 1 - y) for x, y in square]
    head = "ply\nformat binary_little_endian 1.0\nelement vertex 4\n"
    head += "".join(f"property float {c}\n" for c in ("x", "y", "z", "nx", "ny", "nz", "u", "v"))
    head += "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    faces = b"".join(b"\x03" + np.array(f, "<i4").tobytes() for f in ((0, 1, 2), (0, 2, 3)))
    (here / "mesh.ply").write_bytes(head.encode() + np.array(rows, "<f4").tobytes() + faces)
    cv2.imwrite(str(here / "n.png"), np.full((2, 2, 3), (217, 128, 217), np.uint8))
    cv2.imwrite(str(here / "r.png"), np.full((2, 2), 128, np.uint8))
    (here / "asset.xml").write_text(scene.format(more=more))
    facts = {"name": name, "title": "A Square", "kind": kind, "author": "A. Nyone",
             "licence": "CC BY 4.0", "source": "https://example.org/square"}  # fmt: skip
    (here / "asset.json").write_text(json.dumps(facts))
    return folder


@pytest.fixture(scope="module", params=["scalar_rgb", "llvm_ad_rgb"])
def mi(request):
    return opened(request.param)


def test_an_asset_shows_its_colour_and_the_normals_of_its_map(mi, tmp_path):
    b = Home([1], Library(write_asset(tmp_path)))
    asset = b.library.get("chair")
    b.place_asset(asset, translation([0, 0, 0]), np.ones(3), "")
    world = World(label="one", pieces=b.pieces, sky=Sky())
    layers = noisy(mi, world, ("environment",), spp=4)
    seen = layers["depth"] > 4.9  # all of the pixel, or nearly
    inside = seen & (np.abs(layers["albedo"][..., 0] - 0.6) < 0.01)
    assert inside.sum() >= 5
    np.testing.assert_allclose(layers["albedo"][inside], np.array([[0.6, 0.3, 0.1]] * inside.sum()),
                               atol=0.01)  # fmt: skip
    # (217, 128, 217) of 255 is 45 degrees to the right
    expected = np.array([0.7071, 0.0028, 0.7071])
    np.testing.assert_allclose(layers["normal"][inside], [expected] * inside.sum(), atol=0.01)


def test_the_roughness_of_a_picture_of_bytes_is_a_share(mi, tmp_path):
    rough = SCENE.replace('<float name="roughness" value="0.5"/>', ROUGH)
    assert ROUGH in rough
    b = Home([1], Library(write_asset(tmp_path, scene=rough)))
    b.place_asset(b.library.get("chair"), translation([0, 0, 0]), np.ones(3), "")
    world = World(label="one", pieces=b.pieces, sky=Sky())
    layers = noisy(mi, world, ("environment",), spp=4, guides=("roughness",))
    seen = np.abs(layers["albedo"][..., 0] - 0.6) < 0.01
    assert seen.sum() >= 5
    # Disney's material squares it
    np.testing.assert_allclose(layers["roughness"][seen], (128 / 255) ** 2, atol=0.002)


def test_the_transform_of_a_shape_moves_its_mesh(tmp_path):
    asset = Library(write_asset(tmp_path, more=MOVED)).get("chair")
    assert asset.low[1] == pytest.approx(0.25)
    assert asset.high[1] == pytest.approx(1.25)


def test_an_asset_placed_twice_is_one_material(tmp_path):
    b = Home([1], Library(write_asset(tmp_path)))
    for x in (0, 2):
        b.place_asset(b.library.get("chair"), translation([x, 0, 0]), np.ones(3), "")
    plan = make_plan(World(label="two", pieces=b.pieces, sky=Sky()), ("environment",))
    assert len(plan.materials) == len(plan.shapes) == 1


def test_who_made_an_asset_is_written_beside_the_pictures(tmp_path):
    folder = write_asset(tmp_path / "assets")
    options = SequenceOptions(
        frames=1, references=0, height=8, width=8, assets=str(folder), move="still"
    )
    seed = next(s for s in range(20) if generate("desk", s, Library(folder)).credits)
    job = Job(scene="desk", seed=seed, effects=("environment",), options=options)
    run_job(load_mitsuba()[0], job, tmp_path / "out")
    record = json.loads((job.folders(tmp_path / "out")[0] / "sequence.json").read_text())
    assert record["assets"] == [
        {"name": "chair", "title": "A Square", "author": "A. Nyone", "licence": "CC BY 4.0",
         "source": "https://example.org/square"}
    ]  # fmt: skip


def test_without_assets_nobody_is_credited():
    assert generate("desk", 1).credits == ()


def test_a_folder_without_assets_is_refused(tmp_path):
    with pytest.raises(InputError, match="assets must be a folder"):
        Library(tmp_path)


def test_an_asset_without_a_licence_is_refused(tmp_path):
    folder = write_asset(tmp_path)
    facts = json.loads((folder / "chair/asset.json").read_text())
    del facts["licence"]
    (folder / "chair/asset.json").write_text(json.dumps(facts))
    with pytest.raises(InputError, match="licence"):
        Library(folder).get("chair")


def test_a_mesh_laid_out_otherwise_is_refused(tmp_path):
    path = tmp_path / "mesh.ply"
    path.write_bytes(b"ply\nformat ascii 1.0\nelement vertex 0\nelement face 0\nend_header\n")
    with pytest.raises(ValueError, match="must be binary"):
        read_ply(path)
