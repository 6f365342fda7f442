"""Patterns name the right files, in order, and outputs cannot hit inputs."""

import pytest

from stillray.errors import InputError
from stillray.sequence import expand, map_companions, numbered, refuse_overwriting


def touch(folder, *names):
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize("pattern", ["shot.####.exr", "shot.%04d.exr"])
def test_expand_orders_by_number_and_leaves_gaps_out(tmp_path, pattern):
    touch(tmp_path, "shot.0010.exr", "shot.0002.exr", "shot.10000.exr", "shot.0003.exr")
    touch(tmp_path, "shot.2.exr", "shot.00002.exr", "shot.0004.exr.part", "other.0001.exr")
    (tmp_path / "shot.0005.exr").mkdir()
    assert [frame.number for frame in expand(tmp_path / pattern)] == [2, 3, 10, 10000]


@pytest.mark.parametrize("pattern", ["a_%d.exr", "a_#.exr"])
def test_expand_unpadded_numbers_sort_as_numbers(tmp_path, pattern):
    touch(tmp_path, "a_9.exr", "a_10.exr", "a_0.exr", "a_07.exr")
    assert [frame.path.name for frame in expand(tmp_path / pattern)] == [
        "a_0.exr",
        "a_9.exr",
        "a_10.exr",
    ]


def test_expand_takes_regex_characters_literally(tmp_path):
    touch(tmp_path, "a+b(1).0001.exr", "aab1x0001xexr")
    assert [frame.path.name for frame in expand(tmp_path / "a+b(1).####.exr")] == [
        "a+b(1).0001.exr"
    ]


def test_expand_plain_name_is_one_frame_without_number(tmp_path):
    touch(tmp_path, "one.exr")
    assert expand(tmp_path / "one.exr") == [(None, tmp_path / "one.exr")]


def test_expand_file_whose_own_name_holds_a_hash_is_plain(tmp_path):
    touch(tmp_path, "take#2.exr")
    assert expand(tmp_path / "take#2.exr") == [(None, tmp_path / "take#2.exr")]


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("shot.####.exr", ["shot.####.exr", "no file matches"]),
        ("gone/shot.####.exr", ["gone", "cannot be listed"]),
        ("missing.exr", ["missing.exr", "no such file"]),
        ("a_##_##.exr", ["a_##_##.exr", "one frame placeholder"]),
        ("", ["is a folder", "shot.####.exr"]),
    ],
)
def test_expand_says_what_is_wrong(tmp_path, name, words):
    with pytest.raises(InputError) as error:
        expand(tmp_path / name)
    assert all(word in str(error.value) for word in words)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("pattern", "number", "name"),
    [("c.####.exr", 7, "c.0007.exr"), ("c.%03d.exr", 1234, "c.1234.exr"), ("c%d.exr", 5, "c5.exr")],
)
def test_numbered_fills_the_placeholder(tmp_path, pattern, number, name):
    assert numbered(tmp_path / pattern, number) == tmp_path / name


def test_map_companions_follows_the_numbers_of_the_input(tmp_path):
    touch(tmp_path, "s.0002.exr", "s.0009.exr")
    frames = expand(tmp_path / "s.####.exr")
    outputs = map_companions(tmp_path / "clean.%02d.exr", frames, name="output")
    assert [path.name for path in outputs] == ["clean.02.exr", "clean.09.exr"]


def test_map_companions_refuses_one_name_for_many_frames(tmp_path):
    touch(tmp_path, "s.0002.exr")
    frames = expand(tmp_path / "s.####.exr")
    with pytest.raises(InputError, match=r"output must hold a frame placeholder .*clean\.exr"):
        map_companions(tmp_path / "clean.exr", frames, name="output")


def test_map_companions_refuses_a_pattern_for_one_plain_file(tmp_path):
    touch(tmp_path, "s.exr")
    with pytest.raises(InputError, match="albedo must name one file"):
        map_companions(tmp_path / "a.####.exr", expand(tmp_path / "s.exr"), name="albedo")


def test_refuse_overwriting_sees_through_links_and_detours(tmp_path):
    touch(tmp_path, "s.exr")
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.exr").symlink_to(tmp_path / "s.exr")
    for output in (tmp_path / "s.exr", tmp_path / "sub" / ".." / "s.exr", tmp_path / "link.exr"):
        with pytest.raises(InputError, match="must not overwrite an input"):
            refuse_overwriting([output], [tmp_path / "s.exr"])
    refuse_overwriting([tmp_path / "t.exr"], [tmp_path / "s.exr"])
