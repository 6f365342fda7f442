"""Rooms to test on: files of others are mended, and their cameras move as they are told."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import numpy as np
import pytest

pytest.importorskip("mitsuba")

from stillray.errors import InputError
from stillray_training import unseen_rooms

SCENE = """<scene version="0.5.0">
  <sensor type="perspective">
    <float name="fov" value="50"/>
    <transform name="toWorld"><matrix value="-1 0 0 4 0 1 0 2 0 0 -1 3 0 0 0 1"/></transform>
    <film type="hdrfilm"><boolean name="banner" value="false"/>
      <boolean name="high_quality_edges" value="true"/></film>
  </sensor>
  <shape type="obj"><string name="filename" value="there.obj"/></shape>
  <shape type="obj"><string name="filename" value="lost.obj"/></shape>
  <shape type="rectangle"/>
  <emitter type="envmap"><string name="filename" value="lost.hdr"/></emitter>
</scene>"""


@pytest.fixture
def scene(tmp_path):
    (tmp_path / "there.obj").touch()
    (tmp_path / "scene.xml").write_text(SCENE)
    return tmp_path / "scene.xml"


def test_what_a_copy_lacks_is_left_out_or_replaced_and_said(scene, tmp_path):
    told = unseen_rooms.mend(scene, tmp_path / "sky.exr")
    assert [change.split(" is missing: ")[0] for change in told] == ["lost.obj", "lost.hdr"]
    root = ET.parse(scene).getroot()
    files = [file.get("value") for file in root.iter("string")]
    assert files == ["there.obj", str(tmp_path / "sky.exr")]
    assert len(root.findall("shape")) == 2  # the one without a file stays
    assert [option.get("name") for option in root.iter("boolean")] == ["banner"]


def test_a_mended_file_stays_as_it_is(scene, tmp_path):
    (tmp_path / "sky.exr").touch()
    unseen_rooms.mend(scene, tmp_path / "sky.exr")
    before = scene.read_text()
    assert unseen_rooms.mend(scene, tmp_path / "sky.exr") == []
    assert scene.read_text() == before


def test_cameras_go_left_and_ahead_of_the_file_s_own(scene):
    found = unseen_rooms.cameras(scene, unseen_rooms.Room("room", 0.5, 0.1, 2.0))
    assert found["fov_x_deg"] == 50
    poses = np.array([camera["camera_to_world"] for camera in found["cameras"]])
    # it looks along -z, and what the matrix calls its x is -x
    np.testing.assert_allclose(poses[:, 2, 3], 3 - 0.5 - 0.1 * np.arange(6))
    np.testing.assert_allclose(poses[:, 0, 3], 4 - 0.1 * np.arange(6))
    np.testing.assert_allclose(poses[:, 1, 3], 2)
    ahead = poses[:, :3, 2]
    np.testing.assert_allclose(ahead @ ahead[0], np.cos(np.radians(2.0 * np.arange(6))))
    np.testing.assert_allclose(np.linalg.det(poses[:, :3, :3]), 1)


def test_a_folder_without_the_rooms_is_an_error(tmp_path):
    with pytest.raises(InputError, match=r"must have dining-room/scene\.xml"):
        unseen_rooms.main(tmp_path, tmp_path / "out")
