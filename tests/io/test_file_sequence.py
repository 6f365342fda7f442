"""Patterns name the right files, in order, and outputs cannot hit inputs."""

import pytest

from stillray.errors import InputError
from stillray.io.file_sequence import (
    expand,
    map_companions,
    map_outputs,
    numbered,
    refuse_overwriting,
    select,
)


def touch(folder, *names):
    for name in names:
        (folder / name).touch()


@pytest.mark.parametrize(
    "pattern", ["shot.####.exr", "shot.%04d.exr", "shot.@@@@.exr", "shot.$F4.exr"]
)
def test_expand_orders_by_number_and_leaves_gaps_out(tmp_path, pattern):
    touch(tmp_path, "shot.0010.exr", "shot.0002.exr", "shot.10000.exr", "shot.0003.exr")
    touch(tmp_path, "shot.2.exr", "shot.00002.exr", "shot.0004.exr.part", "other.0001.exr")
    (tmp_path / "shot.0005.exr").mkdir()
    assert [frame.number for frame in expand(tmp_path / pattern)] == [2, 3, 10, 10000]


@pytest.mark.parametrize("pattern", ["a_%d.exr", "a_#.exr", "a_$F.exr"])
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
        ("shot.<frame>.exr", ["no such file", "written as ####", "not <frame>"]),
        ("wood.<UDIM>.exr", ["no such file", "not <UDIM>"]),
        ("shot.{frame:04d}.exr", ["no such file", "not {frame:04d}"]),
        ("shot.[1001-1009].exr", ["no file matches", "not [1001-1009]"]),
        ("shot.%V.####.exr", ["no file matches", "files of each view by themselves"]),
        ("me@home$Fx.exr", ["me@home$Fx.exr: no such file"]),
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
    [
        ("c.####.exr", 7, "c.0007.exr"),
        ("c.%03d.exr", 1234, "c.1234.exr"),
        ("c%d.exr", 5, "c5.exr"),
        ("c.@@@.exr", 7, "c.007.exr"),
        ("c.$F4.exr", 7, "c.0007.exr"),
    ],
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
    with pytest.raises(InputError, match=r"albedo must name one file, as the input .*s\.exr does"):
        map_companions(tmp_path / "a.####.exr", expand(tmp_path / "s.exr"), name="albedo")


def test_refuse_overwriting_sees_through_links_and_detours(tmp_path):
    touch(tmp_path, "s.exr")
    (tmp_path / "sub").mkdir()
    (tmp_path / "link.exr").symlink_to(tmp_path / "s.exr")
    for output in (tmp_path / "s.exr", tmp_path / "sub" / ".." / "s.exr", tmp_path / "link.exr"):
        with pytest.raises(InputError, match="must not overwrite an input"):
            refuse_overwriting([output], [tmp_path / "s.exr"])
    refuse_overwriting([tmp_path / "t.exr"], [tmp_path / "s.exr"])


def test_expand_glob_numbers_by_the_last_digits_of_the_name(tmp_path):
    touch(tmp_path, "v2_shot.9.exr", "v2_shot.10.exr", "other.11.exr")
    assert expand(tmp_path / "v2*.exr") == [
        (9, tmp_path / "v2_shot.9.exr"),
        (10, tmp_path / "v2_shot.10.exr"),
    ]


def test_expand_glob_of_a_single_file_still_has_its_number(tmp_path):
    touch(tmp_path, "shot.0007.exr", "plain.exr")
    assert expand(tmp_path / "shot.*.exr") == [(7, tmp_path / "shot.0007.exr")]
    assert expand(tmp_path / "pl*.exr") == [(None, tmp_path / "plain.exr")]


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (["a.1.exr", "b.2.exr"], ["b.2.exr", "by their number only", "a.2.exr"]),
        (["a.1.exr", "a.01.exr"], ["same number"]),
        (["a.exr", "b.exr"], ["must hold its number"]),
        (["shot.1.exr", "shot.1.albedo.exr"], ["by their number only"]),
        ([], ["no file matches"]),
    ],
)
def test_expand_glob_refuses_what_is_not_one_sequence(tmp_path, names, words):
    touch(tmp_path, *names)
    with pytest.raises(InputError) as error:
        expand(tmp_path / "*.exr")
    assert all(word in str(error.value) for word in words)


def test_select_takes_what_is_wanted_and_names_what_is_missing(tmp_path):
    touch(tmp_path, *(f"s.{n}.exr" for n in (1, 2, 3, 6, 7)))
    files = expand(tmp_path / "s.#.exr")
    assert [f.number for f in select(files, [2, 3])] == [2, 3]
    with pytest.raises(InputError, match=r"no file for frame 4-5 beside .*on-missing skip"):
        select(files, None)
    with pytest.raises(InputError, match="no file for frame 8-9 "):
        select(files, [7, 8, 9])
    assert [f.number for f in select(files, None, on_missing="skip")] == [1, 2, 3, 6, 7]
    assert [f.number for f in select(files, [5, 6], on_missing="skip")] == [6]


def test_select_with_no_frame_left_says_what_there_is(tmp_path):
    touch(tmp_path, "s.1.exr", "s.2.exr")
    with pytest.raises(InputError, match=r"frames must be among 1-2 .* got 10-11"):
        select(expand(tmp_path / "s.#.exr"), [10, 11], on_missing="skip")


def test_select_refuses_numbers_for_one_plain_file(tmp_path):
    touch(tmp_path, "s.exr")
    with pytest.raises(InputError, match="frames must be chosen from a sequence"):
        select(expand(tmp_path / "s.exr"), [1])


def test_map_companions_takes_a_folder_or_a_glob(tmp_path):
    touch(tmp_path, "s.1.exr", "s.2.exr", "alb_01.exr", "alb_02.exr", "alb_03.exr")
    (tmp_path / "out").mkdir()
    frames = expand(tmp_path / "s.#.exr")
    folder = map_companions(tmp_path / "out", frames, name="output")
    assert folder == [tmp_path / "out" / "s.1.exr", tmp_path / "out" / "s.2.exr"]
    by_glob = map_companions(tmp_path / "alb*.exr", frames, name="albedo")
    assert [path.name for path in by_glob] == ["alb_01.exr", "alb_02.exr"]
    (tmp_path / "alb_02.exr").unlink()
    with pytest.raises(InputError, match=r"albedo must have a file for every frame.*s\.2\.exr"):
        map_companions(tmp_path / "alb*.exr", frames, name="albedo")


def test_an_output_that_is_no_pattern_says_how_a_folder_is_made(tmp_path):
    touch(tmp_path, "a.1.exr", "a.2.exr")
    frames = expand(tmp_path / "a.#.exr")
    with pytest.raises(InputError, match="or be a folder, got clean; a folder clean/ is made"):
        map_outputs("clean", frames)


def test_an_output_is_no_glob_and_may_have_brackets(tmp_path):
    touch(tmp_path, "a.1.exr", "a.2.exr")
    frames = expand(tmp_path / "a.#.exr")
    with pytest.raises(InputError, match=r"output must name what is to be written, with ####"):
        map_outputs(tmp_path / "clean.*.exr", frames)
    found = map_outputs(tmp_path / "clean [new].##.exr", frames)
    assert [path.name for path in found] == ["clean [new].01.exr", "clean [new].02.exr"]
