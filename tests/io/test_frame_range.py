"""Frame numbers as users write them."""

import pytest

from stillray.errors import InputError
from stillray.io.frame_range import format_frames, parse_frames


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("7", [7]),
        ("10-13", [10, 11, 12, 13]),
        ("10-15x2", [10, 12, 14]),
        ("0010-0012", [10, 11, 12]),
        ("5, 1-3,2", [1, 2, 3, 5]),
        ("4-4x9", [4]),
    ],
)
def test_parse_frames(text, numbers):
    assert parse_frames(text) == numbers


@pytest.mark.parametrize("text", ["", "a", "1-", "-3", "1-3x", "1x2", "1,,2", "1.5", "1-2-3"])
def test_parse_frames_refuses_what_is_no_list(text):
    with pytest.raises(InputError, match="frames must be numbers and ranges"):
        parse_frames(text)


def test_parse_frames_refuses_ranges_that_lead_nowhere():
    with pytest.raises(InputError, match="must count upwards, got 9-3"):
        parse_frames("1,9-3")
    with pytest.raises(InputError, match="must advance by 1 or more"):
        parse_frames("1-9x0")
    with pytest.raises(InputError, match="at most 1000000"):
        parse_frames("1-99999999999999999999")


def test_format_frames_is_read_back():
    for numbers in ([3], [1, 2, 3, 7], [1, 3, 5], [0, 1, 10, 11, 12]):
        assert parse_frames(format_frames(numbers)) == numbers
    assert format_frames([1, 2, 3, 7]) == "1-3,7"
