"""The Blender extension as a zip file: ``python plugins/blender/build.py FOLDER``.

It holds everything: the add-on, stillray as a wheel made of this checkout, and the wheels that it
needs beside Blender's own NumPy and OpenImageIO. Blender's `extension build` gives the same from
a folder with these wheels, but makes none.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Iterable
from pathlib import Path

HERE = Path(__file__).resolve().parent
SOURCE = HERE / "stillray_blender"
NEEDED = (
    "onnxruntime",
    "opencv-python-headless",
    "flatbuffers",
    "protobuf",
    "packaging",
)
#: What stillray is built from.
SOURCES = (
    "pyproject.toml", "README.md", "LICENSE", "runtime", "training", "export", "models_spec",
)  # fmt: skip
PYTHON = "3.11"  # of Blender 4.1 to 5.0
#: Blender's name of a platform, and what wheels for it are called.
PLATFORMS = {
    "linux-x64": ("manylinux_2_28_x86_64", "manylinux_2_27_x86_64", "manylinux2014_x86_64"),
    "windows-x64": ("win_amd64",),
    "macos-arm64": ("macosx_14_0_arm64", "macosx_13_0_arm64", "macosx_11_0_arm64"),
}


def download(folder: Path, platform: str) -> None:
    """Fetch the wheels of others from the package index."""
    tags = [flag for tag in PLATFORMS[platform] for flag in ("--platform", tag)]
    _pip(
        "download", "--only-binary=:all:", "--no-deps", "--python-version", PYTHON, *tags,
        "--dest", str(folder), *NEEDED,
    )  # fmt: skip


def make_wheel(folder: Path) -> None:
    """stillray's own wheel, of this checkout."""
    with tempfile.TemporaryDirectory() as copy:
        # setuptools builds beside the sources, and would take along what it built there before
        for name in SOURCES:
            source, target = HERE.parents[1] / name, Path(copy) / name
            shutil.copytree(source, target) if source.is_dir() else shutil.copy(source, target)
        _pip("wheel", "--no-deps", "--wheel-dir", str(folder), copy)


def pack(folder: Path, wheels: Iterable[Path], platform: str) -> Path:
    """Write the zip file into a folder; its path.

    Parameters
    ----------
    folder
        Must be there.
    wheels
        stillray's and those it needs.
    platform
        One of ``PLATFORMS``.
    """
    manifest = (SOURCE / "blender_manifest.toml").read_text(encoding="utf-8")
    named = tomllib.loads(manifest)
    wheels = sorted(wheels)
    # keys of the document's top come before its first table
    lists = [
        f'platforms = ["{platform}"]',
        "wheels = [",
        *(f'    "./wheels/{wheel.name}",' for wheel in wheels),
        "]\n\n",
    ]
    manifest = manifest.replace("[permissions]", "\n".join(lists) + "[permissions]")
    path = folder / f"{named['id']}-{named['version']}-{platform.replace('-', '_')}.zip"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("blender_manifest.toml", manifest)
        for file in sorted([*SOURCE.glob("*.py"), SOURCE / "LICENSE"]):
            archive.write(file, file.name)
        for wheel in wheels:
            archive.write(wheel, f"wheels/{wheel.name}", zipfile.ZIP_STORED)  # a zip already
    return path


def _pip(*arguments: str) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *arguments]
    subprocess.run(command, check=True)


def main() -> None:
    """Build for one platform."""
    parser = argparse.ArgumentParser(description="Build the Blender extension.")
    parser.add_argument("folder", type=Path, help="gets the zip file")
    parser.add_argument("--platform", choices=PLATFORMS, default="linux-x64")
    parser.add_argument("--wheels", type=Path, help="wheels of others, already here")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        others = given.wheels or Path(made) / "others"
        if given.wheels is None:
            download(others, given.platform)
        make_wheel(Path(made))
        wheels = [*Path(made).glob("stillray-*.whl"), *others.glob("*.whl")]
        print(pack(given.folder, wheels, given.platform))


if __name__ == "__main__":
    main()
