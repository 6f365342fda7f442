"""The model that learns while it denoises: hard cases, its guard, and what is kept of it."""

import dataclasses

import numpy as np
import pytest

import stillray
from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families.contract import State
from stillray.families.online_learning import Learned, Learner, Lesson, crop_of
from stillray.families.online_past import Past, exposure_of, logarithm, radiance_of
from stillray.frame import Frame
from stillray.models.registry import find_model
from stillray.pipeline.denoiser import Denoiser
from tests.conftest import make_frame


def halves(height, width, seed=0, shift=0.0, **changes):
    """A frame, and an independent second half of its samples."""
    frame = make_frame(height, width, seed, shift)
    second = make_frame(height, width, seed + 1000, shift).color
    return dataclasses.replace(frame, color_b=second, **changes)


@pytest.fixture(scope="module")
def shared():
    """One denoiser for many tests: a session of a step takes seconds to open."""
    with Denoiser("online", threads=1) as denoiser:
        yield denoiser


@pytest.fixture
def online(shared):
    shared.state = None
    yield shared
    shared.state = None


def learned(denoiser):
    assert isinstance(denoiser.state, State)
    assert isinstance(denoiser.state.learned, Learned)
    return denoiser.state.learned


def test_one_half_alone_is_refused_and_the_error_says_how_to_get_the_other(online):
    with pytest.raises(InputError, match=r"color_b.*another seed"):
        online.denoise(make_frame(8, 8))


@pytest.mark.parametrize("name", ["online", "online-warm"])
def test_it_is_found_by_name_and_not_listed(name):
    assert name not in [model.name for model in stillray.list_models()]
    assert find_model(name).parameters == 30670


def test_what_other_scenes_taught_shows_in_the_first_frames():
    """A box before a wall, lit from above, under noise that half of the paths bring."""
    rng = np.random.default_rng(3)
    height, width = 72, 96
    albedo = np.full((height, width, 3), 0.7, np.float32)
    albedo[20:50, 30:70] = (0.6, 0.2, 0.1)
    clean = albedo * np.linspace(0.9, 0.3, height, dtype=np.float32)[:, None, None]
    normal = np.zeros_like(albedo)
    normal[..., 2] = 1

    def seen():
        paths = rng.standard_exponential((height, width, 1), np.float32) * 2
        return clean * paths * (rng.random((height, width, 1)) < 0.5)

    still = np.zeros((height, width, 2), np.float32)
    depth = np.ones((height, width), np.float32)
    buffers = {"albedo": albedo, "normal": normal, "depth": depth, "motion": still}
    frames = [Frame(color=seen(), color_b=seen(), **buffers) for _ in range(3)]
    errors = {}
    for name in ("online", "online-warm"):
        with Denoiser(name, threads=1) as denoiser:
            images = [denoiser.denoise(frame) for frame in frames]
        errors[name] = [float(np.square(image - clean).mean()) for image in images]
    taught, untaught = errors["online-warm"], errors["online"]
    assert sum(taught) < 0.9 * sum(untaught)
    assert all(one < other for one, other in zip(taught, untaught, strict=True))


@pytest.mark.parametrize("shape", [(1, 1), (3, 5), (33, 18), (130, 141)])
def test_odd_sizes(online, shape):
    for seed in range(2):
        image = online.denoise(halves(*shape, seed))
        assert image.shape == (*shape, 3)
        assert image.dtype == np.float32
        assert np.isfinite(image).all()
        assert image.min() >= 0


def test_it_removes_noise(online):
    frames = [halves(48, 64, seed) for seed in range(4)]
    for frame in frames:
        image = online.denoise(frame)
    row = np.mgrid[0:48, 0:64][0]
    clean = frames[-1].albedo * (0.5 + 0.4 * np.sin(row / 9))[..., None]
    noisy = (frames[-1].color + frames[-1].color_b) / 2
    assert ((image - clean) ** 2).mean() < ((noisy - clean) ** 2).mean() / 5


@pytest.mark.parametrize(
    "change",
    [
        lambda f: dataclasses.replace(f, color_b=f.color),
        lambda f: dataclasses.replace(f, color=np.zeros_like(f.color)),
        lambda f: dataclasses.replace(f, color=0 * f.color, color_b=0 * f.color),
        lambda f: dataclasses.replace(f, color=np.full_like(f.color, np.nan)),
        lambda f: dataclasses.replace(f, color=1e30 * f.color, color_b=1e30 * f.color_b),
        lambda f: dataclasses.replace(f, color=1e-30 * f.color, color_b=1e-30 * f.color_b),
        lambda f: dataclasses.replace(f, albedo=None, normal=None, depth=None, motion=None),
        lambda f: dataclasses.replace(f, motion=np.full_like(f.motion, np.inf)),
    ],
    ids=["equal", "a-zero", "black", "nan", "bright", "dark", "bare", "motion"],
)
def test_frames_that_teach_nothing_do_no_harm(online, change):
    online.denoise(halves(24, 20, 1))
    for seed in (2, 3):
        image = online.denoise(change(halves(24, 20, seed)))
        assert np.isfinite(image).all()
        assert image.min() >= 0
    assert np.isfinite(learned(online).weights).all()
    image = online.denoise(halves(24, 20, 4))
    assert np.isfinite(image).all()


def test_a_black_frame_stays_black_and_a_flat_one_flat(online):
    for level in (0.0, 0.3):
        online.state = None
        flat = np.full((16, 16, 3), level, np.float32)
        for _ in range(2):
            image = online.denoise(stillray.Frame(color=flat, color_b=flat))
            np.testing.assert_allclose(image, flat, rtol=1e-4)


def test_what_was_learned_outlives_a_cut_and_a_change_of_size(online):
    online.denoise(halves(20, 20, 1))
    before = learned(online)
    assert before.steps == 1
    online.reset()
    assert online.state.temporal is None
    np.testing.assert_array_equal(learned(online).weights, before.weights)
    online.denoise(halves(12, 28, 2))
    assert learned(online).steps == 2
    online.state = None
    online.denoise(halves(20, 20, 1))
    assert learned(online).steps == 1


def test_nothing_is_kept_without_the_past():
    with Denoiser("online", threads=1, temporal=False) as denoiser:
        image = denoiser.denoise(halves(9, 9))
        assert np.isfinite(image).all()
        assert denoiser.state is None
        assert "learn" not in denoiser.last_timings


def test_stages_that_are_told_are_those_that_run(online):
    for seed in range(2):
        frame = halves(16, 16, seed, shift=1.0)
        told = {stage.name for stage in online.stages(frame) if stage.runs}
        online.denoise(frame)
        assert set(online.last_timings) | {"inspect"} == told | {"inspect"}
    assert "warp" in told


def test_a_saved_state_goes_on_exactly(online, tmp_path):
    online.denoise(halves(21, 17, 1))
    online.save(tmp_path / "past.npz")
    expected = [online.denoise(halves(21, 17, seed)) for seed in (2, 3)]
    online.state = None
    online.load(tmp_path / "past.npz")
    for seed, image in zip((2, 3), expected, strict=True):
        np.testing.assert_array_equal(online.denoise(halves(21, 17, seed)), image)


def test_a_state_of_anything_else_is_refused(online, tmp_path):
    path = tmp_path / "past.npz"
    with pytest.raises(InputError, match="no such file"):
        online.load(path)
    path.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not a saved state"):
        online.load(path)
    with pytest.raises(InputError, match="none yet"):
        online.save(path)
    online.denoise(halves(8, 8))
    online.save(path)
    with np.load(path) as file:
        arrays = dict(file)
    for change in (
        {"weights": arrays["weights"][1:]},
        {"output": arrays["output"][:4]},
        {"shape": np.array([1e9, 1], np.float32)},
        {"more": arrays["shape"]},
        {"weights": np.full_like(arrays["weights"], np.nan)},
        {"weights": arrays["weights"].astype(object)},
        {"weights": arrays["weights"].astype(np.float64)},
    ):
        np.savez(path, **{**arrays, **change})
        with pytest.raises(InputError):
            online.load(path)
    np.savez_compressed(path, **arrays)
    with pytest.raises(InputError, match="compressed"):
        online.load(path)


def test_a_state_of_another_model_of_the_same_shapes_is_refused(online, tmp_path):
    online.denoise(halves(8, 8))
    online.save(tmp_path / "past.npz")
    with Denoiser("online-warm", threads=1) as other:
        words = "state must be one of online-warm, got one of online$"
        with pytest.raises(InputError, match=words):
            other.load(tmp_path / "past.npz")
        assert other.state is None
    with np.load(tmp_path / "past.npz") as file:
        arrays = dict(file)
    for letters in ([-1.0], [2.0**22], [1e30], []):
        np.savez(tmp_path / "bent.npz", **{**arrays, "model": np.array(letters, np.float32)})
        with pytest.raises(InputError, match="of online, got one of another model"):
            online.load(tmp_path / "bent.npz")
    # files of before names were kept are taken for what they are given as
    arrays.pop("model")
    np.savez(tmp_path / "old.npz", **arrays)
    online.load(tmp_path / "old.npz")
    assert learned(online).steps == 1


def test_other_models_keep_no_state(tmp_path):
    with Denoiser("fast", threads=1) as denoiser, pytest.raises(InputError, match="learns"):
        denoiser.save(tmp_path / "past.npz")


class Teacher:
    """An engine whose steps are as they are told to be."""

    def __init__(self, *losses, slope=0.0):
        self.losses, self.slope, self.rates = list(losses), slope, []

    def run(self, graph, inputs):
        self.rates.append(float(inputs["rate"][0]))
        loss = self.losses.pop(0) if self.losses else 1.0
        return {
            "loss": np.float32(loss),
            "next_weights": inputs["weights"][0] + np.float32(self.slope),
            "next_first": inputs["first"][0],
            "next_second": inputs["second"][0],
        }

    def close(self):
        pass


HALVES = np.arange(6 * 10 * 11, dtype=np.float32).reshape(6, 10, 11)
LESSON = Lesson(np.zeros((1, 15, 12, 12), np.float32), (10, 11), lambda part: HALVES[:, *part])


@pytest.mark.parametrize(("loss", "slope"), [(np.nan, 0.1), (1.0, np.nan), (1.0, 1e6)])
def test_a_step_that_is_not_finite_or_explodes_is_dropped(loss, slope):
    begun = Learned.begin(np.ones(3, np.float32))
    after, why = Learner(Teacher(loss, slope=slope), rate=1e-3, seed=1).step(begun, LESSON)
    assert why
    np.testing.assert_array_equal(after.weights, begun.weights)
    assert (after.steps, after.adam_steps) == (1, 0)


@pytest.mark.parametrize(("then", "kept"), [(1.0, False), (3.0, True), (np.nan, False)])
def test_weights_that_have_become_worse_give_way_to_those_before(then, kept):
    begun = dataclasses.replace(Learned.begin(np.ones(3, np.float32)), steps=15)
    now = np.nan if np.isnan(then) else 2.0
    teacher = Teacher(1.0, now, 1.0 if np.isnan(then) else then, slope=0.5)
    after, why = Learner(teacher, rate=1e-3, seed=1).step(begun, LESSON)
    assert bool(why) != kept
    expected = 1.5 if kept else 1.0
    np.testing.assert_array_equal(after.weights, np.full(3, expected, np.float32))
    np.testing.assert_array_equal(after.kept, after.weights)


def test_steps_become_smaller_as_a_shot_goes_on():
    for steps, share in ((0, 1), (32, 1 / 2), (480, 1 / 16)):
        teacher = Teacher(1.0)
        begun = dataclasses.replace(Learned.begin(np.ones(3, np.float32)), steps=steps)
        Learner(teacher, rate=1e-3, seed=1).step(begun, LESSON)
        assert teacher.rates[0] == pytest.approx(1e-3 * share)


def test_a_lesson_has_what_each_half_has_accumulated(online, monkeypatch):
    seen = []
    monkeypatch.setattr(Learner, "step", lambda self, before, lesson: (before, seen.append(lesson)))
    for number in range(3):
        online.denoise(halves(24, 30, number))
        past = online.state.temporal
        part = slice(3, 20), slice(5, 28)
        found = seen[-1].halves(part)
        exposure = exposure_of(past.first, past.second)
        for planes, half in zip((found[:3], found[3:]), (past.first, past.second), strict=True):
            wanted = logarithm(half.mean[part][..., :3], exposure)
            np.testing.assert_allclose(planes, wanted.transpose(2, 0, 1), rtol=1e-5, atol=1e-6)


def test_a_small_frame_is_a_whole_crop_and_the_rest_does_not_count():
    crop = crop_of(LESSON, np.random.default_rng(0))
    assert {name: array.shape[1] for name, array in crop.items()} == {
        "features": 15, "halves": 6, "inside": 1,
    }  # fmt: skip
    assert all(array.shape[2:] == (128, 128) for array in crop.values())
    assert crop["inside"].sum() == 10 * 11
    assert crop["inside"][0, 0, :10, :11].all()
    np.testing.assert_array_equal(crop["halves"][0, :, :10, :11], HALVES)


def test_logarithms_come_back(rng):
    radiance = (rng.random((3, 4, 5)) * 10.0 ** rng.integers(-5, 6, (3, 4, 5))).astype(np.float32)
    albedo = rng.random((4, 5, 3)).astype(np.float32)
    for factor in (None, albedo):
        found = radiance_of(logarithm(radiance, 0.2), 0.2, factor, Strips(1))
        expected = radiance.transpose(1, 2, 0) * (1 if factor is None else factor)
        np.testing.assert_allclose(found, expected, rtol=2e-2, atol=1e-5)


def test_what_disagrees_has_no_past(online):
    """A surface that was not seen before is shown as it is now alone."""
    frame = halves(24, 24, 1)
    online.denoise(frame)
    assert isinstance(online.state.temporal, Past)
    turned = dataclasses.replace(halves(24, 24, 2), normal=-frame.normal)
    bright = dataclasses.replace(turned, color=turned.color * 50, color_b=turned.color_b * 50)
    state = online.state
    after = online.denoise(bright)
    past = state.temporal
    first = dataclasses.replace(past.first, output=past.first.output * 0)
    online.state = dataclasses.replace(state, temporal=dataclasses.replace(past, first=first))
    np.testing.assert_array_equal(online.denoise(bright), after)


def still(seed, level=0.5):
    """Halves of one picture, an edge that no guide shows, seen by a camera that stands still."""
    rng = np.random.default_rng(seed)
    clean = np.where(np.arange(32) < 16, level, 2 * level)[None, :, None] * np.ones((24, 1, 3))
    color, color_b = (clean * rng.exponential(1, clean.shape) for _ in range(2))
    motion = np.zeros((24, 32, 2), np.float32)
    return stillray.Frame(color=color, color_b=color_b, motion=motion), clean


def test_halves_accumulate_each_its_own_samples(online):
    """A still picture gets better with frames, and neither half ever sees the other's samples."""
    errors = []
    for seed in range(8):
        frame, clean = still(seed)
        errors.append(float(((online.denoise(frame) - clean) ** 2).mean()))
    assert errors[-1] < errors[0] / 2
    past = online.state.temporal
    first, second = (half.mean[..., :3] - clean for half in (past.first, past.second))
    for noise in (first, second):  # of eight samples
        assert 0.5 < 8 * (noise**2).mean() / (clean**2).mean() < 1.5
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.1


def test_a_still_run_does_not_drift(online):
    """Learning frame after frame, from the same picture, neither darkens nor blurs it."""
    errors, light = [], []
    for seed in range(30):
        frame, clean = still(seed)
        image = online.denoise(frame)
        errors.append(float(((image - clean) ** 2).mean()))
        light.append(float(image.mean() / clean.mean()))
    assert learned(online).steps == 30
    assert np.mean(errors[-5:]) < 1.25 * np.mean(errors[8:13])
    assert np.mean(light[-5:]) == pytest.approx(1, abs=0.1)


def test_a_lamp_that_is_switched_leaves_no_light_of_the_past(online):
    for seed in range(6):
        online.denoise(still(seed)[0])
    for seed in range(6, 9):
        frame, clean = still(seed, level=0.05)
        image = online.denoise(frame)
    assert image.mean() == pytest.approx(clean.mean(), rel=0.25)


def test_edges_are_smoothed_over_frames_as_supersampling_would(online):
    """Samples meet either side of an edge in turn: its pixels become the mean of both."""
    image = np.zeros((16, 16, 3), np.float32)
    for number in range(12):
        normal = np.zeros((16, 16, 3), np.float32)
        normal[..., 2] = 1
        left = np.arange(16) < (8 if number % 2 else 7)  # column 7 is met on either side in turn
        normal[:, left] = (1, 0, 0)
        albedo = np.where(left, 0.9, 0.1)[None, :, None] * np.ones((16, 1, 3))
        frame = stillray.Frame(
            color=albedo,
            color_b=albedo,
            albedo=albedo,
            normal=normal,
            depth=np.ones((16, 16)),
            motion=np.zeros((16, 16, 2)),
        )
        before = image
        image = online.denoise(frame)
    edge = image[:, 7].mean()
    assert 0.25 < edge < 0.75
    # and do not flicker: a frame is a quarter of them at most
    assert abs(edge - before[:, 7].mean()) < 0.2
    assert image[:, 5].mean() == pytest.approx(0.9, rel=0.05)
    assert image[:, 9].mean() == pytest.approx(0.1, rel=0.05)


def before_a_window(place):
    """A dark wall beside a bright window, without noise, as many pixels further on."""
    at = np.arange(40)[None, :, None] - place
    wall = np.clip(at - 12, 0, 1)  # the pixel that the edge lies in is mixed
    color = np.broadcast_to(60 - 59.9 * wall, (20, 40, 3)).astype(np.float32)
    motion = np.zeros((20, 40, 2), np.float32)
    motion[..., 0] = -0.3
    return stillray.Frame(color=color, color_b=color, motion=motion)


def test_light_stays_out_of_what_is_before_a_window(online, tmp_path):
    """Looks between pixels, frame after frame, would bring it there, in either half alike."""
    for number in range(16):
        image = online.denoise(before_a_window(0.3 * number))
    online.save(tmp_path / "past.npz")
    held = np.load(tmp_path / "past.npz")
    np.testing.assert_array_equal(held["mean_a"], held["mean_b"])
    # two pixels from the edge; looked up bilinearly alone it would hold .9
    assert held["mean_a"][4:-4, 19, :3].max() < 0.25
    assert image[4:-4, 19].max() < 0.25
