"""Where samples lie in their pixels comes with the file."""

import numpy as np
import pytest

from stillray.errors import InputError
from stillray.io.exr.jitter import JITTER_ATTRIBUTE, jitter_text
from stillray.io.exr.read_write import read_exr, write_channels


def write(path, text):
    planes = {name: np.ones((3, 4), np.float32) for name in "RGB"}
    write_channels(path, planes, attributes=None if text is None else {JITTER_ATTRIBUTE: text})
    return path


def test_what_is_written_is_read(tmp_path):
    path = write(tmp_path / "a.exr", jitter_text(np.array([-0.25, 1 / 3])))
    np.testing.assert_allclose(read_exr(path).jitter, [-0.25, 1 / 3], rtol=1e-6)
    assert read_exr(write(tmp_path / "b.exr", None)).jitter is None


@pytest.mark.parametrize("text", [" ", "0.1", "a b", "0 0 0"])
def test_what_is_no_pair_of_numbers_is_refused(tmp_path, text):
    path = write(tmp_path / "a.exr", text)
    with pytest.raises(InputError, match=f"{JITTER_ATTRIBUTE} must be two numbers, got"):
        read_exr(path)
