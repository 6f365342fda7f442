"""Odd and broken EXR files, one after the other: ``python fuzz_exr.py SEED COUNT FOLDER``.

Run as a program of its own, so that a crash inside a C++ library is seen by the test that starts
it and cannot take the test run with it. Each file must be read in all its views and written again,
or be refused in one line, in 30 seconds and 2 GiB. Half of the files are whole ones with faults,
a quarter odd ones as they are, a quarter odd ones with faults.
"""

from __future__ import annotations

import resource
import signal
import struct
import sys
from pathlib import Path

import numpy as np
import OpenImageIO as oiio  # noqa: N813

sys.path.insert(0, str(Path(__file__).parents[2]))  # as a program it is no part of a package

from stillray.batch.file_layout import CleanPicture, Layout
from stillray.errors import InputError
from stillray.io.exr.read import read_channels
from tests.io.odd_exr import oddity

BLENDER = Path(__file__).parents[1] / "data/blender/frame_0001.exr"
# Address space of the process: libraries and their threads take a part, pixels must not take more.
MOST_ADDRESSES = 3 * 2**30
MOST_MEMORY = 2 * 2**30
SECONDS = 30  # of processor time, a file
EXTREMES = (0, 1, -1, 2**31 - 1, -(2**31), 10**9, 2**16, 255)


def sources(folder: Path) -> list[bytes]:
    """Small whole files of every kind of storage."""
    made = [BLENDER.read_bytes()]
    rng = np.random.default_rng(0)
    for compression, tile in [
        ("zip", 0), ("piz", 16), ("none", 8), ("dwaa", 0), ("b44", 0), ("pxr24", 16), ("rle", 0),
        ("dwab", 8), ("zips", 0),
    ]:  # fmt: skip
        spec = oiio.ImageSpec(37, 29, 5, "half")
        spec.channelnames = ("R", "G", "B", "A", "depth.Z")
        spec.channelformats = tuple(map(oiio.TypeDesc, ["half"] * 4 + ["float"]))
        spec.tile_width = spec.tile_height = tile
        spec.attribute("compression", compression)
        sink = oiio.ImageOutput.create("exr")
        assert sink.open(str(folder / "whole.exr"), spec)
        smooth = np.linspace(0, 1, 37)[None, :, None] * np.linspace(0, 2, 5)
        sink.write_image((smooth + 0.01 * rng.random((29, 37, 5))).astype(np.float32))
        sink.close()
        made.append((folder / "whole.exr").read_bytes())
    return made


def mutated(data: bytes, rng: np.random.Generator) -> bytes:
    """A file with one to four faults, most of them in its header and table of chunks."""
    broken = bytearray(data)
    for _ in range(int(rng.integers(1, 5))):
        end = len(broken) if rng.random() < 0.3 else min(len(broken), 2500)
        at = int(rng.integers(0, max(end, 1)))
        kind = rng.integers(0, 7)
        if kind == 0:
            broken[at : at + 1] = (
                bytes([broken[at] ^ (1 << int(rng.integers(8)))]) if broken else b""
            )
        elif kind == 1:
            broken[at : at + 4] = rng.bytes(4)
        elif kind == 2:
            broken[at : at + 4] = struct.pack("<i", EXTREMES[int(rng.integers(len(EXTREMES)))])
        elif kind == 3:
            length = int(rng.integers(1, 200))
            broken[at : at + length] = bytes(length)
        elif kind == 4:
            del broken[at : at + int(rng.integers(1, 60))]
        elif kind == 5:
            broken[at:at] = broken[at : at + int(rng.integers(1, 60))]
        elif rng.random() < 0.3:
            del broken[at:]
        else:  # a number of the header set to an extreme, where its attribute says that it is one
            names = (b"dataWindow\0box2i\0", b"tiles\0tiledesc\0", b"chunkCount\0int\0",
                     b"displayWindow\0box2i\0", b"channels\0chlist\0")  # fmt: skip
            name = names[int(rng.integers(len(names)))]
            found = broken.find(name)
            if found >= 0:
                place = found + len(name) + 4 * int(rng.integers(0, 5))
                value = EXTREMES[int(rng.integers(len(EXTREMES)))]
                broken[place : place + 4] = struct.pack("<i", value)
        if not broken:
            break
    return bytes(broken)


def attempt(path: Path, output: Path) -> bool:
    """Whether the file could be read; raises what is not an `InputError`."""
    try:
        layout = Layout.of([path], aovs=())
        views = layout.read(path, {}, None)
        assert all(view.frame.color.size > 0 for view in views)
        clean = [CleanPicture(view.frame.color, view.lights) for view in views]
        layout.write(output, clean, like=path)
        if not layout.views:
            read_channels(output)
    except InputError as error:
        message = str(error)
        assert "\n" not in message, message
        assert message.strip(), "an error without words"
        return False
    return True


def main() -> None:
    seed, count, folder = int(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3])
    folder.mkdir(parents=True, exist_ok=True)
    whole = sources(folder)
    # set only now: what the libraries map at their start is not of interest
    resource.setrlimit(resource.RLIMIT_AS, (MOST_ADDRESSES, MOST_ADDRESSES))
    path, output, read = folder / "broken.exr", folder / "out.exr", 0
    for number in range(count):
        rng = np.random.default_rng((seed, number))
        odd = number % 2 == 1
        data = oddity(rng) if odd else whole[number // 2 % len(whole)]
        path.write_bytes(data if number % 4 == 1 else mutated(data, rng))
        print(number, flush=True)  # the last one printed is the one that crashed
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # ends the process, wherever it hangs
        with np.errstate(all="ignore"):
            read += attempt(path, output)
        most = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        assert most < MOST_MEMORY, f"{most} bytes were taken"
    path.unlink()
    print(f"{read} of {count} read")


if __name__ == "__main__":
    main()
