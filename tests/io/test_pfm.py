from __future__ import annotations

import cv2
import numpy as np
import pytest

from stillray.errors import InputError
from stillray.io.pfm import read_pfm, write_pfm


def picture(channels=3):
    image = np.random.default_rng(3).normal(size=(5, 4, channels)).astype(np.float32)
    image[1, 2, 0], image[0, 0, 0], image[4, 3, 0] = np.nan, np.inf, 1e-42
    return image


def stored(image, *, kind=b"PF", scale=b"-1.0", dtype="<f4"):
    header = kind + b"\n%d %d\n" % (image.shape[1], image.shape[0]) + scale + b"\n"
    return header + image[::-1].astype(dtype).tobytes()


@pytest.mark.parametrize("channels", [1, 3])
def test_what_is_written_is_read_bit_by_bit(tmp_path, channels):
    image = picture(channels)
    write_pfm(tmp_path / "a.pfm", image)
    np.testing.assert_array_equal(read_pfm(tmp_path / "a.pfm").view(np.int32), image.view(np.int32))


def test_opencv_reads_what_is_written_and_the_other_way_round(tmp_path):
    image = picture()
    write_pfm(tmp_path / "ours.pfm", image)
    theirs = cv2.imread(str(tmp_path / "ours.pfm"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(theirs[..., ::-1], image)
    cv2.imwrite(str(tmp_path / "theirs.pfm"), np.ascontiguousarray(image[..., ::-1]))
    np.testing.assert_array_equal(read_pfm(tmp_path / "theirs.pfm"), image)


def test_the_sign_of_the_scale_is_the_order_of_bytes_and_its_size_a_factor(tmp_path):
    image = picture()
    (tmp_path / "big.pfm").write_bytes(stored(image, scale=b"1.0", dtype=">f4"))
    (tmp_path / "twice.pfm").write_bytes(stored(image, scale=b"-2e0"))
    np.testing.assert_array_equal(read_pfm(tmp_path / "big.pfm"), image)
    np.testing.assert_array_equal(read_pfm(tmp_path / "twice.pfm"), 2 * image)


def test_header_is_as_others_write_it(tmp_path):
    # readers of such files split lines at \n, and the second at one space
    write_pfm(tmp_path / "a.pfm", np.zeros((2, 3, 3)))
    assert (tmp_path / "a.pfm").read_bytes()[:15] == b"PF\n3 2\n-1.0\n\0\0\0"


def test_half_precision(tmp_path):
    image = np.full((2, 3, 3), 0.1, np.float32)
    image[0, 0] = 1e6
    write_pfm(tmp_path / "a.phm", image)
    assert (tmp_path / "a.phm").read_bytes().startswith(b"PH\n3 2\n")
    back = read_pfm(tmp_path / "a.phm")
    assert back[0, 0, 0] == 65504
    np.testing.assert_array_equal(back[1], image[1].astype(np.float16))
    grey = picture(1)
    (tmp_path / "b.phm").write_bytes(stored(grey, kind=b"Ph", scale=b"1", dtype=">f2"))
    np.testing.assert_array_equal(read_pfm(tmp_path / "b.phm"), grey.astype(np.float16))


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b"", "float map"),
        (b"P6\n4 5\n255\n", "float map"),
        (b"PF\n4 5\n", "float map"),
        (b"PF\n4 -5\n-1\n", "float map"),
        (b"PF\n0 5\n-1\n", "more than 0"),
        (b"PF\n4 5\n0\n", "scale"),
        (b"PF\n4 5\n1e999\n", "scale"),
        (b"PF\n4 5\ne-e\n", "scale"),
        (stored(picture())[:-1], "240 bytes"),
        (stored(picture()) + b"\n", "240 bytes"),
        (b"PF\n999999999 999999999\n-1\n" + b"\0" * 12, "bytes"),
    ],
)
def test_other_content_is_refused_in_words(tmp_path, data, words):
    (tmp_path / "a.pfm").write_bytes(data)
    with pytest.raises(InputError, match=words):
        read_pfm(tmp_path / "a.pfm")


def test_missing_files_and_folders_are_refused_in_words(tmp_path):
    with pytest.raises(InputError, match=r"none\.pfm: cannot be read"):
        read_pfm(tmp_path / "none.pfm")
    with pytest.raises(InputError, match="folder must exist"):
        write_pfm(tmp_path / "none" / "a.pfm", np.zeros((2, 3, 3)))
    with pytest.raises(InputError, match=r"\(2, 3, 4\)"):
        write_pfm(tmp_path / "a.pfm", np.zeros((2, 3, 4)))
