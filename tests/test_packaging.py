"""What is installed is what there is: every package and every data file that code reads."""

import ast
import inspect
import tomllib
from pathlib import Path

import cv2

ROOT = Path(__file__).parents[1]


def test_every_package_of_the_three_roots_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    there = {
        ".".join(path.parent.relative_to(ROOT / root).parts)
        for root in ("runtime", "training", "export")
        for path in (ROOT / root).rglob("__init__.py")
    }
    # data alone, which has no code
    assert set(project["tool"]["setuptools"]["packages"]) == there | {"stillray.model_spec.specs"}


#: Modules that OpenCV has in its contrib distributions alone, by name.
CONTRIB = {
    "bgsegm", "bioinspired", "cnn_3dobj", "colored_kinfu", "datasets", "dnn_objdetect",
    "dnn_superres", "dpm", "dynafu", "face", "freetype", "ft", "fuzzy", "hdf", "hfs", "img_hash",
    "intensity_transform", "kinfu", "large_kinfu", "legacy", "line_descriptor", "linemod",
    "motempl", "multicalib", "omnidir", "optflow", "phase_unwrapping", "plot", "ppf_match_3d",
    "quality", "rapid", "reg", "rgbd", "saliency", "signal", "stereo", "structured_light",
    "surface_matching", "text", "tracking", "videostab", "wechat_qrcode", "xfeatures2d",
    "ximgproc", "xobjdetect", "xphoto",
}  # fmt: skip


def of_opencv(source):
    """Names of cv2 that a module uses: its attributes, and what is imported from it."""
    names = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            if node.value.id == "cv2":
                names.add(node.attr)
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "cv2":
            names |= {*(node.module or "").split(".")[1:], *(name.name for name in node.names)}
        elif isinstance(node, ast.Import):
            for name in node.names:
                assert name.name != "cv2" or name.asname is None, "cv2 under another name"
                names |= set(name.name.split(".")[1:]) if name.name.startswith("cv2.") else set()
    return names


def test_plain_opencv_is_enough():
    used = {
        (path.relative_to(ROOT).as_posix(), name)
        for root in ("runtime", "training", "export", "plugins")
        for path in (ROOT / root).rglob("*.py")
        for name in of_opencv(path.read_text(encoding="utf-8"))
    }
    assert len(used) > 50
    for path, name in used:
        assert hasattr(cv2, name), f"{path}: cv2.{name}"
        # its submodules are no part of what plain OpenCV always has
        assert not inspect.ismodule(getattr(cv2, name)), f"{path}: cv2.{name}"
        assert name.split("_")[0] not in CONTRIB, f"{path}: cv2.{name}"


def test_use_of_contrib_would_be_found():
    assert of_opencv("import cv2\ncv2.ximgproc.guidedFilter(a, a, 3, 1)") == {"ximgproc"}
    assert of_opencv("from cv2.ximgproc import guidedFilter") == {"ximgproc", "guidedFilter"}
    assert of_opencv("import cv2.xphoto") == {"xphoto"}
