"""Calls as an engine makes them: ended inside a frame, with alpha, in other encodings and types."""

import threading
import time
from dataclasses import replace
from functools import partial

import numpy as np
import onnxruntime
import pytest

import stillray
from stillray.arrays import srgb
from stillray.arrays.strips import Strips
from stillray.arrays.tiles import tiles_of
from stillray.frame import Frame
from stillray.models import network
from stillray.pipeline import denoiser as pipeline
from stillray.pipeline import plan
from stillray.profiling.synthetic import swing
from stillray_training.cancel_latency import UNLISTED, gaps, stream
from tests.conftest import make_frame

SHAPE = 70, 96
MODELS = [info.name for info in stillray.list_models()]


@pytest.fixture
def in_strips(monkeypatch):
    """Makes a denoiser whose small frames go in strips of a few rows."""

    def make(model, threads):
        with monkeypatch.context() as patch:
            patch.setattr(pipeline, "Strips", partial(Strips, pixels=12 * SHAPE[1]))
            return stillray.Denoiser(model, threads=threads)

    return make


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("model", MODELS)
def test_a_cancelled_frame_leaves_the_history_as_it_was(model, threads, in_strips):
    first, second = swing(*SHAPE)
    with stillray.Denoiser(model, threads=threads) as plain:
        plain.denoise(first)
        expected = plain.denoise(second)
    with in_strips(model, threads) as denoiser:
        denoiser.denoise(first)
        for end in (0, 0.3, 0.6):
            with pytest.raises(stillray.Cancelled, match="progress returned False"):
                denoiser.denoise(second, progress=lambda share, end=end: np.bool_(share < end))
        np.testing.assert_allclose(denoiser.denoise(second), expected, rtol=2e-4, atol=1e-5)


def broken(frame):
    """With a hole of NaN in every buffer."""
    buffers = {}
    for name in ("color", "albedo", "normal", "depth", "motion"):
        buffers[name] = getattr(frame, name).copy()
        buffers[name][20:40, 30:60] = np.nan
    return replace(frame, **buffers)


def with_alpha(frame):
    return replace(frame, alpha=np.linspace(0, 1, SHAPE[0] * SHAPE[1]).reshape(SHAPE))


@pytest.mark.parametrize("what", ["broken", "srgb", "layers", "alpha", "munet-x2", "online"])
def test_a_frame_can_be_ended_at_every_one_of_many_looks(what, in_strips, monkeypatch):
    """No part of a frame goes as a whole: of a large one it would take long."""
    # a network is looked at as long as it runs: on a busy machine once more or less each time
    monkeypatch.setattr(network, "INTERVAL", 60.0)
    model = what if what in UNLISTED else "fast"
    change = {"broken": broken, "alpha": with_alpha}.get(what, lambda frame: frame)
    options = {
        "srgb": {"encoding": "srgb"},
        "alpha": {"denoise_alpha": True, "dtype": "float16"},
    }.get(what, {})

    def denoise(denoiser, frame, **more):
        if what == "layers":
            return denoiser.denoise_layers(frame, {"half": frame.color / 2}, **more)[0]
        return denoiser.denoise(frame, **options, **more)

    with stillray.Denoiser(model, threads=1) as plain:
        first, second = map(change, stream(plain, [size * plain.scale for size in SHAPE]))
        denoise(plain, first)
        usual = []
        denoise(plain, second, progress=usual.append)
    with in_strips(model, 1) as denoiser:
        denoise(denoiser, first)
        state, looks = denoiser.state, []
        expected = denoise(denoiser, second, progress=looks.append)
        assert len(looks) > 3 * len(usual)
        for end in range(0, len(looks) - 1, 7 if model == "fast" else len(looks) // 4):
            denoiser.state, seen = state, iter([True] * end)
            with pytest.raises(stillray.Cancelled):
                denoise(denoiser, second, progress=lambda _, seen=seen: next(seen, False))
        denoiser.state = state
        np.testing.assert_array_equal(denoise(denoiser, second), expected)


def test_a_cancelled_frame_with_layers_leaves_their_history_too():
    first, second = swing(*SHAPE)
    layers = [{"half": frame.color / 2} for frame in (first, second)]
    with stillray.Denoiser("fast", threads=1) as plain:
        plain.denoise_layers(first, layers[0])
        expected = plain.denoise_layers(second, layers[1])[1]["half"]
    with stillray.Denoiser("fast", threads=1) as denoiser:
        denoiser.denoise_layers(first, layers[0])
        looks = []
        with pytest.raises(stillray.Cancelled):
            denoiser.denoise_layers(
                second, layers[1], progress=lambda share: looks.append(share) or len(looks) < 20
            )
        found = denoiser.denoise_layers(second, layers[1])[1]["half"]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("what", ["whole", "tiles", "layers", "alpha", "munet-x2", "online"])
def test_a_frame_that_is_done_can_still_be_unwanted(what, monkeypatch):
    """Told that all is done, the caller may be the one who fails: the frame then comes again."""
    model = what if what in UNLISTED else "fast"
    change = with_alpha if what == "alpha" else lambda frame: frame
    if what == "tiles":
        monkeypatch.setattr(
            plan,
            "plan_tiles",
            lambda shape, use, traits, *_: tiles_of(
                shape, 48, traits.tile_overlap, traits.tile_alignment
            ),
        )

    def denoise(denoiser, frame, **more):
        if what == "layers":
            return denoiser.denoise_layers(frame, {"half": frame.color / 2}, **more)[1]["half"]
        return denoiser.denoise(frame, denoise_alpha=what == "alpha", **more)

    def fail(share):
        if share == 1:
            raise KeyboardInterrupt

    with stillray.Denoiser(model, threads=1) as denoiser:
        first, second = map(change, stream(denoiser, [size * denoiser.scale for size in SHAPE]))
        expected = [denoise(denoiser, frame) for frame in (first, second, first)]
        denoiser.state = None
        found = []
        for frame in (first, second, first):
            with pytest.raises(KeyboardInterrupt):
                denoise(denoiser, frame, progress=fail)
            with pytest.raises(stillray.Cancelled):
                denoise(denoiser, frame, progress=lambda share: share < 1)
            found.append(denoise(denoiser, frame))
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("threads", [1, 2])
def test_progress_goes_from_nothing_to_all_in_the_caller_s_thread(threads, in_strips):
    threads_of_looks = set()
    with in_strips("fast", threads) as denoiser:
        for frame in swing(*SHAPE):
            looks = []

            def progress(share, looks=looks):
                looks.append(share)
                threads_of_looks.add(threading.get_ident())

            denoiser.denoise(frame, progress=progress)
            assert looks[0] == 0
            assert looks[-1] == 1
            assert looks == sorted(looks)
            assert len(set(looks)) > 4
    assert threads_of_looks == {threading.get_ident()}


@pytest.mark.parametrize("model", ["fast", "munet-x2"])
def test_gaps_are_measured_of_models_that_take_more_than_others(model):
    processor, wall, stage = gaps(model, (48, 64), repeats=1)
    assert 0 < processor <= wall * 1.5
    with stillray.Denoiser(model, threads=1) as denoiser:
        first, second = stream(denoiser, (48, 64))
        denoiser.denoise(first)
        denoiser.denoise(second)
        assert stage in {"none", *denoiser.last_timings}


def test_what_progress_raises_comes_out_and_the_denoiser_goes_on():
    frame = make_frame(*SHAPE)
    with stillray.Denoiser("fast", threads=2) as denoiser:
        with pytest.raises(KeyboardInterrupt):
            denoiser.denoise(frame, progress=lambda _: (_ for _ in ()).throw(KeyboardInterrupt))
        assert denoiser.state is None
        assert denoiser.denoise(frame).shape == (*SHAPE, 3)


USES = {
    "denoise": lambda denoiser, past: denoiser.denoise(make_frame(*SHAPE)),
    "stages": lambda denoiser, past: denoiser.stages(make_frame(*SHAPE)),
    "reset": lambda denoiser, past: denoiser.reset(),
    "state": lambda denoiser, past: setattr(denoiser, "state", None),
    "load": lambda denoiser, past: denoiser.load(past),
    "close": lambda denoiser, past: denoiser.close(),
}


@pytest.fixture(scope="module")
def past(tmp_path_factory):
    """What `online` remembers of a frame, in a file."""
    path = tmp_path_factory.mktemp("past") / "past.npz"
    with stillray.Denoiser("online", threads=1) as denoiser:
        denoiser.denoise(stream(denoiser, SHAPE)[0])
        denoiser.save(path)
    return path


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("use", USES)
def test_a_denoiser_is_not_used_while_its_frame_is_in_work(use, threads, past):
    """Whoever resets it then, or puts a state back, would be remembered over."""
    refused = []

    def attempt(words):
        with pytest.raises(stillray.InputError, match=words):
            USES[use](denoiser, past)
        refused.append(words)

    def progress(share):
        if share > 0 and not refused:
            attempt("from within its own frame")
            other = threading.Thread(target=attempt, args=("by one thread at a time",))
            other.start()
            other.join(60)

    model = "online" if use == "load" else "fast"
    with stillray.Denoiser(model, threads=threads) as plain:
        first, second = stream(plain, SHAPE)
        plain.denoise(first)
        expected = plain.denoise(second)
    with stillray.Denoiser(model, threads=threads) as denoiser:
        denoiser.denoise(first)
        found = denoiser.denoise(second, progress=progress)
        assert len(refused) == 2
        np.testing.assert_array_equal(found, expected)
        assert denoiser.stages(first)  # and the turn is free again


@pytest.mark.parametrize("use", ["reset", "state", "load"])
def test_the_past_of_a_closed_denoiser_stays_as_it_is(use, past):
    denoiser = stillray.Denoiser("online" if use == "load" else "fast", threads=1)
    denoiser.close()
    with pytest.raises(stillray.InputError, match="it was closed"):
        USES[use](denoiser, past)


def test_a_network_that_nobody_wants_any_more_is_not_waited_for(monkeypatch):
    entered, release = threading.Event(), threading.Event()
    frame = make_frame(*SHAPE)
    opened = network.start_session

    class Slow:
        def __init__(self, *arguments, **options):
            self.session = opened(*arguments, **options)

        def run(self, *arguments):
            entered.set()
            assert release.wait(60)
            return self.session.run(*arguments)

    monkeypatch.setattr(network, "start_session", Slow)
    with stillray.Denoiser("fast", threads=1) as denoiser:
        try:
            with pytest.raises(stillray.Cancelled):
                denoiser.denoise(frame, progress=lambda _: not entered.is_set())
        finally:
            release.set()
        assert np.isfinite(denoiser.denoise(frame)).all()


def test_a_step_of_learning_that_is_being_opened_is_not_waited_for(monkeypatch):
    entered, release = threading.Event(), threading.Event()
    opened = onnxruntime.InferenceSession

    def slow(source, *arguments, **options):
        if isinstance(source, str):  # the network comes as the bytes that were checked
            entered.set()
            assert release.wait(60)
        return opened(source, *arguments, **options)

    monkeypatch.setattr(onnxruntime, "InferenceSession", slow)
    with stillray.Denoiser("online", threads=1) as denoiser:
        frame, _ = stream(denoiser, (24, 20))
        try:
            with pytest.raises(stillray.Cancelled):
                denoiser.denoise(frame, progress=lambda _: not entered.is_set())
        finally:
            release.set()
        assert denoiser.state is None
        denoiser.denoise(frame)
        assert denoiser.state.learned.steps == 1


def test_long_work_of_other_threads_ends_with_the_frame():
    strips, ended = Strips(2, pixels=10), []

    def work(rows):
        for _ in range(500):
            time.sleep(0.01)
            strips.watch.look()
        ended.append(rows)

    with strips.watch.over(lambda _: False, lambda: 0.0), pytest.raises(stillray.Cancelled):
        strips.run(work, 16, 10)
    assert ended == []
    strips.close()


def test_alpha_is_kept_or_filtered():
    frame = make_frame(*SHAPE)
    rng = np.random.default_rng(1)
    alpha = rng.random(SHAPE).astype(np.float32)
    buffers = {name: getattr(frame, name) for name in ("albedo", "normal", "depth")}
    rgba = Frame(color=np.dstack([frame.color, alpha]), **buffers)
    with stillray.Denoiser("high", threads=1, temporal=False) as denoiser:
        bare = denoiser.denoise(Frame(color=frame.color, **buffers))
        kept = denoiser.denoise(rgba)
        np.testing.assert_array_equal(kept, np.dstack([bare, alpha]))
        clean = denoiser.denoise(rgba, denoise_alpha=True)
        np.testing.assert_array_equal(clean[..., :3], bare)
        assert clean[..., 3].std() < alpha.std() / 3
        assert abs(clean[..., 3].mean() - alpha.mean()) < 0.02
        solid = Frame(color=frame.color, alpha=np.ones(SHAPE), **buffers)
        np.testing.assert_allclose(denoiser.denoise(solid, denoise_alpha=True)[..., 3], 1, 1e-5)
        out = np.empty((*SHAPE, 4), np.float16)
        assert denoiser.denoise(rgba, out=out) is out
        np.testing.assert_array_equal(out[..., 3], alpha.astype(np.float16))
        with pytest.raises(stillray.InputError, match=r"out must have shape \(70, 96, 4\)"):
            denoiser.denoise(rgba, out=out[..., :3])
        with pytest.raises(stillray.InputError, match="denoise_alpha must be False for a frame"):
            denoiser.denoise(frame, denoise_alpha=True)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("model", ["fast", "high", "wskp-3"])
def test_an_even_alpha_stays_even_whatever_the_light_does(model):
    """No outlier of the light darkens it, and no edge of the light sharpens it."""
    frames = [
        replace(frame, alpha=np.full(SHAPE, 0.5, np.float32))
        for frame in swing(*SHAPE)  # with a moving camera, and noise
    ]
    with stillray.Denoiser(model, threads=1) as denoiser:
        for frame in frames:
            alpha = denoiser.denoise(frame, denoise_alpha=True)[..., 3]
            np.testing.assert_allclose(alpha, 0.5, atol=1e-5)


@pytest.mark.parametrize("filtered", [False, True])
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_broken_alpha_comes_from_its_neighbours_as_broken_color_does(value, filtered):
    alpha = np.full(SHAPE, 0.5, np.float32)
    alpha[20:30, 10:20], alpha[60, 90] = value, value
    whole = np.full(SHAPE, 0.5)
    with stillray.Denoiser("wskp-mr", threads=1) as denoiser:
        first, second = swing(*SHAPE)
        found, expected = [], []
        for pictures, given in ((found, alpha), (expected, whole)):
            denoiser.reset()
            for frame in (first, second):
                frame = replace(frame, alpha=given)
                pictures.append(denoiser.denoise(frame, denoise_alpha=filtered))
        np.testing.assert_allclose(found, expected, rtol=1e-5)
        denoiser.reset()
        nothing = replace(first, alpha=np.full(SHAPE, value))
        assert (denoiser.denoise(nothing, denoise_alpha=filtered)[..., 3] == 0).all()


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("value", [1e9, 3e38, -3e38])
def test_alpha_beyond_its_range_floods_no_picture(value):
    frame, alpha = make_frame(*SHAPE), np.full(SHAPE, 0.5, np.float32)
    alpha[30, 40] = value
    frame = replace(frame, alpha=alpha)
    with stillray.Denoiser("wskp-mr", threads=1, temporal=False) as denoiser:
        np.testing.assert_array_equal(denoiser.denoise(frame)[..., 3], alpha)
        half = denoiser.denoise(frame, dtype="float16")[..., 3]
        np.testing.assert_array_equal(half, np.clip(alpha, -65504, 65504))
        filtered = denoiser.denoise(frame, denoise_alpha=True)[..., 3]
        assert np.abs(filtered - 0.5).max() <= 0.5
        assert abs(filtered.mean() - 0.5) < 1e-3


@pytest.mark.parametrize("dtype", ["float16", np.float64])
def test_pictures_have_the_type_that_is_asked_for(dtype):
    frame = make_frame(12, 10)
    with stillray.Denoiser("fast", threads=1, temporal=False) as denoiser:
        plain, other = denoiser.denoise(frame), denoiser.denoise(frame, dtype=dtype)
        np.testing.assert_array_equal(other, plain.astype(dtype))
        assert other.dtype == dtype
        for wrong in ("uint8", "no type", complex):
            with pytest.raises(stillray.InputError, match="dtype must be a type of floats"):
                denoiser.denoise(frame, dtype=wrong)
        with pytest.raises(stillray.InputError, match="dtype must not be given with out"):
            denoiser.denoise(frame, dtype=dtype, out=plain)


def test_numbers_of_screens_come_back_as_numbers_of_screens():
    shown = np.random.default_rng(2).random((*SHAPE, 3), np.float32)
    shown[0, 0] = -1, 2, 0.5  # beyond the range: clipped
    with stillray.Denoiser("high", threads=1, temporal=False) as denoiser:
        light = denoiser.denoise(Frame(color=srgb.decode(np.clip(shown, 0, 1))))
        picture = denoiser.denoise(Frame(color=shown), encoding="srgb")
        np.testing.assert_array_equal(picture, srgb.encode(np.clip(light, 0, 1)))
        linear = denoiser.denoise(Frame(color=shown), encoding="ldr")
        assert linear.min() >= 0
        assert linear.max() <= 1
        with pytest.raises(stillray.InputError, match="encoding must be one of hdr, ldr, srgb"):
            denoiser.denoise(Frame(color=shown), encoding="sRGB")


def test_buffers_that_fit_are_not_copied():
    arrays = {
        "color": np.ones((*SHAPE, 3), np.float32),
        "albedo": np.ones((*SHAPE, 3), np.float32),
        "normal": np.ones((*SHAPE, 3), np.float32),
        "depth": np.ones(SHAPE, np.float32),
        "motion": np.zeros((*SHAPE, 2), np.float32),
    }
    frame = Frame(**arrays)
    for name, array in arrays.items():
        assert getattr(frame, name) is array
