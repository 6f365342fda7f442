"""What a renderer's vectors mean is found out by warping, and doubted where it cannot be."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import stillray
from stillray.cli import main
from stillray.io.channels.motion_convention import MotionConvention
from stillray.io.channels.motion_detection import detect_in_sequence, detect_motion, needs_proof
from stillray.io.exr.new_file import write_channels
from stillray.io.exr.read import read_exr, read_picture

BLENDER = Path(__file__).parents[1] / "data/blender"
ROOM = Path(__file__).parents[1] / "data/room"
HEIGHT, WIDTH = 61, 88

# Where the texture of the background and of the disc lies, x and y in pixels, frame by frame.
# Neither steady nor along one axis: only one convention can be right.
BACKGROUND = [(0.0, 0.0), (3.1, -1.6), (5.0, 1.3)]
DISC = [(0.0, 0.0), (-2.2, 3.4), (-6.3, 4.1)]


def scene(frame, *, background=BACKGROUND, disc=DISC):
    """Albedo, whether the disc is seen, and the two layers' places of one frame."""
    row, column = np.mgrid[0:HEIGHT, 0:WIDTH].astype(np.float32)
    inside = np.hypot(column - 50 - disc[frame][0], row - 30 - disc[frame][1]) < 17
    images = []
    for layer, (x, y) in enumerate((background[frame], disc[frame])):
        texture = np.random.default_rng(layer).random((HEIGHT + 40, WIDTH + 40, 3), np.float32)
        texture = cv2.normalize(cv2.GaussianBlur(texture, (0, 0), 2), None, 0, 1, cv2.NORM_MINMAX)
        at = (column + 20 - x, row + 20 - y)
        images.append(cv2.remap(texture, *at, cv2.INTER_LINEAR))
    return np.where(inside[..., None], images[1], images[0]), inside


def between(inside, frame, other, *, background=BACKGROUND, disc=DISC):
    """Position in another frame minus that in this one, of this frame's pixels."""
    moved = [np.subtract(place[other], place[frame]) for place in (background, disc)]
    return np.where(inside[..., None], moved[1], moved[0]).astype(np.float32)


def write_frames(folder, names, stored, *, beauty="RGB", features=True, **places):
    """Frames 0 and 1 in a renderer's names; ``stored(inside, frame)`` are its vectors."""
    paths = []
    for frame in (0, 1):
        albedo, inside = scene(frame, **places)
        vectors = stored(inside, frame)
        noise = np.random.default_rng(frame).exponential(1, albedo.shape).astype(np.float32)
        channels = {name: (albedo * noise)[..., i] for i, name in enumerate(beauty)}
        if features:
            channels |= {names["albedo"][i]: albedo[..., i] for i in range(3)}
            normal = np.where(inside[..., None], [0, 0, 1], [0, 1, 0]).astype(np.float32)
            channels |= {name: normal[..., i] for i, name in enumerate(names["normal"])}
        channels |= {name: vectors[..., i] for i, name in enumerate(names["motion"])}
        paths.append(folder / f"f.{frame}.exr")
        write_channels(paths[-1], channels, formats=dict.fromkeys(names["motion"], "float"))
    return paths


def layer(name, parts):
    return [f"{name}.{part}" for part in parts]


LAYOUTS = {
    "arnold": {
        "albedo": layer("denoise_albedo", "RGB"), "normal": layer("N", "XYZ"),
        "motion": layer("motionvector", "RGB"),
    },
    "renderman": {
        "albedo": layer("albedo", "rgb"), "normal": layer("normal", "xyz"),
        "motion": layer("backward", "xyz"),
    },
    "v-ray": {
        "albedo": ["diffuse.red", "diffuse.green", "diffuse.blue"],
        "normal": layer("bump_normals", "XYZ"), "motion": layer("velocity", "XYZ"),
    },
    "redshift": {
        "albedo": layer("DiffuseFilter", "RGB"), "normal": layer("N", "RGB"),
        "motion": layer("MotionVectors", "RG"),
    },
    "octane": {
        "albedo": layer("Denoise albedo", "RGB"), "normal": layer("Denoise normal", "RGB"),
        "motion": layer("Motion vector", "RG"),
    },
    "moonray": {
        "albedo": layer("albedo", "RGB"), "normal": layer("normal", "XYZ"),
        "motion": layer("motionvec", "XY"),
    },
}  # fmt: skip


def backward(inside, frame):
    """Our own convention: the frame before minus this one."""
    return between(inside, frame, frame - 1 if frame else 0)


def forward(inside, frame):
    """The frame after minus this one."""
    return between(inside, frame, frame + 1)


def padded(vectors, names):
    extra = len(names) - vectors.shape[-1]
    return np.concatenate([vectors, np.zeros((HEIGHT, WIDTH, extra), np.float32)], axis=-1)


CONVENTIONS = {
    "ours": (backward, (1, 1), MotionConvention((1.0, 1.0))),
    "y-up": (backward, (1, -1), MotionConvention((1.0, -1.0))),
    "x-left": (backward, (-1, 1), MotionConvention((-1.0, 1.0))),
    "negated": (backward, (-1, -1), MotionConvention((-1.0, -1.0))),
    "forward": (forward, (1, 1), MotionConvention((-1.0, -1.0), stored="before")),
    "forward-up": (forward, (1, -1), MotionConvention((-1.0, 1.0), stored="before")),
    "ndc": (backward, (2 / WIDTH, -2 / HEIGHT), MotionConvention((1.0, -1.0), unit="half_frames")),
    "widths": (backward, (1 / WIDTH, -1 / WIDTH), MotionConvention((1.0, -1.0), unit="widths")),
    "shutter": (backward, (0.5, 0.5), MotionConvention((2.0, 2.0))),
}


@pytest.mark.parametrize(
    ("renderer", "kind"),
    [("arnold", kind) for kind in CONVENTIONS]
    + [(name, kind) for name in list(LAYOUTS)[1:] for kind in ("y-up", "negated", "forward")],
)
def test_convention_is_proven_in_every_layout(tmp_path, renderer, kind):
    names, (source, factors, expected) = LAYOUTS[renderer], CONVENTIONS[kind]

    def stored(inside, frame):
        return padded(source(inside, frame) * np.float32(factors), names["motion"])

    paths = write_frames(tmp_path, names, stored)
    assert needs_proof(paths[0])
    assert "motion" not in read_exr(paths[1]).given  # never used unproven
    detection = detect_motion(*paths)
    assert detection.convention == expected, detection.reason
    frame = read_exr(paths[1], convention=detection.convention, before=paths[0])
    truth = backward(scene(1)[1], 1)
    inside_frame = np.abs(frame.motion) < WIDTH  # beyond: nothing was there before
    assert inside_frame.mean() > 0.85
    # where a nearer surface comes to lie over another, both vectors arrive: depth must decide
    right = np.isclose(frame.motion, truth, atol=1e-3)[inside_frame]
    assert right.mean() > (0.95 if expected.stored == "before" else 0.9999)
    # the opposite sign must warp worse than what was found, and than no motion at all
    errors = {c.convention: c.error for c in detection.candidates}
    assert errors[expected] < 0.6 * detection.still


def test_swapped_axes_are_found(tmp_path):
    names = LAYOUTS["redshift"]
    paths = write_frames(tmp_path, names, lambda inside, frame: backward(inside, frame)[..., ::-1])
    assert detect_motion(*paths).convention == MotionConvention(swapped=True)
    convention = detect_motion(*paths).convention
    truth = backward(scene(1)[1], 1)
    np.testing.assert_allclose(read_exr(paths[1], convention=convention).motion, truth, atol=1e-3)


@pytest.mark.parametrize(
    ("name", "vectors"),
    [
        ("random", lambda inside, frame: np.random.default_rng(frame).normal(
            0, 4, (HEIGHT, WIDTH, 2)).astype(np.float32)),
        ("nothing", lambda inside, frame: np.zeros((HEIGHT, WIDTH, 2), np.float32)),
        ("nan", lambda inside, frame: np.full((HEIGHT, WIDTH, 2), np.nan, np.float32)),
        ("grey", lambda inside, frame: np.full((HEIGHT, WIDTH, 2), 0.5, np.float32)),
        ("encoded", lambda inside, frame: 0.5 + backward(inside, frame) / 50),
    ],
)  # fmt: skip
def test_vectors_that_explain_nothing_are_not_proven(tmp_path, name, vectors):
    paths = write_frames(tmp_path, LAYOUTS["redshift"], vectors)
    detection = detect_motion(*paths)
    assert detection.convention is None
    assert detection.reason


def test_a_pan_along_one_axis_leaves_the_other_in_doubt(tmp_path):
    places = {"background": [(0.0, 0.0), (4.0, 0.0)], "disc": [(0.0, 0.0), (-3.0, 0.0)]}

    def stored(inside, frame):
        return between(inside, frame, frame - 1 if frame else 0, **places)

    paths = write_frames(tmp_path, LAYOUTS["redshift"], stored, **places)
    detection = detect_motion(*paths)
    assert detection.convention is None
    assert "do not tell" in detection.reason


def test_noisy_color_alone_can_prove(tmp_path):
    paths = write_frames(tmp_path, LAYOUTS["redshift"], backward, features=False)
    assert detect_motion(*paths).features == ("color",)
    assert detect_motion(*paths).convention in (None, MotionConvention())  # never a wrong one


def test_a_still_first_pair_does_not_end_the_search(tmp_path):
    (tmp_path / "still").mkdir()
    (tmp_path / "moving").mkdir()
    places = {"background": [(0.0, 0.0)] * 2, "disc": [(0.0, 0.0)] * 2}
    still = write_frames(
        tmp_path / "still", LAYOUTS["redshift"],
        lambda inside, frame: np.zeros((HEIGHT, WIDTH, 2), np.float32), **places,
    )  # fmt: skip
    moving = write_frames(tmp_path / "moving", LAYOUTS["redshift"], backward)
    assert detect_motion(*still).reason == "nothing moves in these frames"
    found = detect_in_sequence([still[0], moving[0], moving[1]])
    assert found.convention == MotionConvention()
    assert detect_in_sequence([still[0], moving[0], moving[1]], most=1).convention is None


def test_blender_vector_pass_is_what_the_table_says():
    paths = [BLENDER / f"frame_{n:04d}.exr" for n in (1, 2)]
    detection = detect_motion(*paths)
    assert detection.convention == MotionConvention((1.0, -1.0)), detection.reason
    assert detection.match.convention == detection.convention
    assert detect_in_sequence(paths) is None  # it is known: a run need not prove it


def test_our_own_motion_is_what_the_table_says():
    detection = detect_motion(ROOM / "frame_0003.exr", ROOM / "frame_0004.exr")
    assert detection.convention == MotionConvention(), detection.reason


@pytest.mark.parametrize("kind", ["y-up", "forward"])
def test_command_line_uses_motion_once_it_is_proven(tmp_path, capsys, kind):
    names, (source, factors, _) = LAYOUTS["v-ray"], CONVENTIONS[kind]
    paths = write_frames(
        tmp_path, names, lambda i, f: padded(source(i, f) * np.float32(factors), names["motion"])
    )
    command = ["denoise", f"{tmp_path}/f.#.exr", "-o", f"{tmp_path}/c.#.exr", "-m", "fast"]
    assert main(command) == 0
    assert "motion proven: " in capsys.readouterr().out
    convention = detect_motion(*paths).convention
    with stillray.Denoiser("fast") as denoiser:
        denoiser.denoise(read_exr(paths[0]))
        frame = read_exr(paths[1], convention=convention, before=paths[0])
        expected = denoiser.denoise(frame)
        alone = stillray.denoise(frame.color, frame.albedo, frame.normal, model="fast")
    clean = read_picture(tmp_path / "c.1.exr")
    np.testing.assert_array_equal(clean, expected.astype(np.float16))
    assert not np.allclose(clean, alone, rtol=1e-2)  # it has a history


def test_info_tells_what_was_proven_and_why(tmp_path, capsys):
    write_frames(tmp_path, LAYOUTS["redshift"], backward)
    assert main(["info", f"{tmp_path}/f.#.exr", "-m", "fast", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    motion = next(entry for entry in facts["layers"] if entry["role"] == "motion")
    assert motion["used"]
    assert "leaves an error of" in motion["note"]
    assert facts["parts"][0]["compression"] == "zip"
