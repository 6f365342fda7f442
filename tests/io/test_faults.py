"""Broken files end in one line, never in a crash, in memory without bounds, or in half a file."""

import os
import struct
import subprocess
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from stillray.errors import InputError
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr

# STILLRAY_FUZZ=10000 for the long run
MUTATIONS = int(os.environ.get("STILLRAY_FUZZ", "300"))
FUZZ = Path(__file__).parent / "fuzz_exr.py"


def test_mutated_files_are_read_or_refused_in_one_line(tmp_path):
    command = [sys.executable, str(FUZZ), "5", str(MUTATIONS), str(tmp_path)]
    # OpenImageIO's own threads only cost address space here
    environment = {**os.environ, "OPENIMAGEIO_THREADS": "1", "OMP_NUM_THREADS": "1"}
    result = subprocess.run(command, capture_output=True, text=True, env=environment)
    last = result.stdout.splitlines()[-1:]
    assert result.returncode == 0, f"mutation {last} of seed 5: {result.stderr[-2000:]}"
    # a fuzz that breaks every file beyond the first check would prove little
    assert int(last[0].split()[0]) > MUTATIONS / 50
    assert not [path for path in tmp_path.iterdir() if path.name.startswith(".")]


def patched(path, attribute, values):
    """Overwrite the numbers of a header's attribute."""
    data = bytearray(path.read_bytes())
    at = data.index(attribute) + len(attribute) + 4
    data[at : at + 4 * len(values)] = struct.pack(f"<{len(values)}i", *values)
    path.write_bytes(data)


@pytest.mark.parametrize("size", [(31_623, 31_623), (2**31 - 1, 1), (2**31 - 1, 2**31 - 1)])
@pytest.mark.parametrize("compression", ["zip", "none", "piz", "dwaa"])
def test_a_header_that_claims_a_huge_picture_is_refused_before_it_is_allocated(
    tmp_path, size, compression
):
    path = tmp_path / "f.exr"
    write_channels(
        path, {c: np.zeros((33, 18), np.float32) for c in "RGB"}, compression=compression
    )
    patched(path, b"dataWindow\0box2i\0", (0, 0, size[0] - 1, size[1] - 1))
    tracemalloc.start()
    with pytest.raises(InputError, match=r"f\.exr: "):
        read_exr(path)
    assert tracemalloc.get_traced_memory()[1] < 2**22
    tracemalloc.stop()


def test_a_small_file_cannot_claim_a_large_picture(tmp_path):
    # within the limit of pixels, and its chunks are all there, but hold too little
    path = tmp_path / "f.exr"
    write_channels(path, {c: np.zeros((2, 16), np.float32) for c in "RGB"})
    patched(path, b"dataWindow\0box2i\0", (0, 0, 12_000_000, 1))
    with pytest.raises(InputError, match="cannot hold the pixels"):
        read_exr(path)


def test_reading_takes_no_memory_for_channels_that_are_not_needed(tmp_path):
    names = [*"RGB", *(f"other{i:02d}.{c}" for i in range(12) for c in "RGB")]
    plane = np.random.default_rng(0).random((300, 400), np.float32)
    write_channels(tmp_path / "f.exr", dict.fromkeys(names, plane))
    tracemalloc.start()
    read_exr(tmp_path / "f.exr")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4 * 3 * plane.nbytes < len(names) * plane.nbytes
