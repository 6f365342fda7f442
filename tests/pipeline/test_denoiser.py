from __future__ import annotations

import dataclasses
import multiprocessing
import re
import subprocess
import sys
import threading
import tracemalloc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import stillray
from stillray.families.registry import kernels_of
from stillray.families.temporal_kernels import history_of
from stillray.frame import Frame
from stillray.models.registry import for_single_frames
from stillray.profiling.synthetic import swing
from tests.conftest import ODD_SIZES, clean_color, make_frame, remembered

MODELS = ["wskp-3s", "wskp-6", "kpyr-5", "kpyr-5s", "nbg-2x3", "wskp-mr"]
# float32 sums of 169 products, six kernels, and one division and multiplication by albedo
ROUNDING = 1e-4


@pytest.fixture(params=MODELS)
def denoiser(request):
    with stillray.Denoiser(request.param) as made:
        yield made


def _psnr(image, reference):
    return -10 * np.log10(np.mean((np.clip(image, 0, 1) - np.clip(reference, 0, 1)) ** 2))


def test_noise_goes_and_more_frames_are_better(denoiser):
    truth = clean_color(96, 128)
    images = [denoiser.denoise(make_frame(96, 128, seed)) for seed in range(8)]
    noisy = _psnr(make_frame(96, 128, 0).color, truth)
    assert _psnr(images[0], truth) > noisy + 8
    assert _psnr(images[-1], truth) > _psnr(images[0], truth) + 1


@pytest.mark.parametrize("size", [*ODD_SIZES, (1, 300), (257, 2)])
def test_every_size_gives_a_finite_picture_of_that_size(size, denoiser):
    for seed in range(2):
        image = denoiser.denoise(make_frame(*size, seed))
        assert image.shape == (*size, 3)
        assert image.dtype == np.float32
        assert np.isfinite(image).all()


@pytest.mark.parametrize("value", [0.0, 1e-6, 0.3, 1.0, 6e4, 1e6])
def test_a_constant_frame_stays_constant(value, denoiser):
    for _ in range(3):
        image = denoiser.denoise(Frame(color=np.full((33, 18, 3), value), motion=_still(33, 18)))
        np.testing.assert_allclose(image, value, rtol=ROUNDING)


def _still(height, width):
    return np.zeros((height, width, 2), np.float32)


@pytest.mark.parametrize("exponent", [-6, -3, 3, 6])
def test_the_result_scales_with_exposure(exponent, denoiser):
    scale = np.float32(2.0**exponent * 10.0**exponent)
    base, scaled = [], []
    for seed in range(2):
        base.append(denoiser.denoise(make_frame(33, 18, seed)))
    denoiser.reset()
    for seed in range(2):
        frame = make_frame(33, 18, seed)
        scaled.append(
            denoiser.denoise(
                Frame(
                    color=frame.color * scale, albedo=frame.albedo, normal=frame.normal,
                    depth=frame.depth, motion=frame.motion,
                )
            )
        )  # fmt: skip
    # rounding of the exposure moves logits by about 1e-5
    np.testing.assert_allclose(np.array(scaled) / scale, base, rtol=2e-3)


@pytest.mark.parametrize("firefly", [1e3, 1e8, 1e30, 3e38, np.inf])
def test_a_firefly_stays_finite_and_within_reach_of_its_window(firefly, denoiser):
    reach = kernels_of(denoiser.model.spec).looks.reach
    color = np.full((40, 40 + reach, 3), 0.25, np.float32)
    color[20, 20] = firefly
    image = denoiser.denoise(Frame(color=color))
    assert np.isfinite(image).all()
    far = np.ones(image.shape[:2], bool)
    far[max(20 - reach, 0) : 21 + reach, max(20 - reach, 0) : 21 + reach] = False
    assert far.any()
    np.testing.assert_allclose(image[far], 0.25, rtol=ROUNDING)
    assert image.min() >= 0.25 * (1 - ROUNDING)


@pytest.mark.parametrize("share", [0.01, 0.5, 1.0])
def test_nan_and_infinite_pixels_do_not_spread(share, denoiser):
    rng = np.random.default_rng(0)
    color = np.full((33, 18, 3), 0.5, np.float32)
    broken = rng.random((33, 18)) < share
    color[broken] = rng.choice([np.nan, np.inf, -np.inf], (broken.sum(), 3))
    for _ in range(2):
        image = denoiser.denoise(Frame(color=color, motion=_still(33, 18)))
        np.testing.assert_allclose(image, 0.0 if share == 1 else 0.5, rtol=ROUNDING)


def test_features_may_hold_anything(denoiser):
    rng = np.random.default_rng(1)
    bad = np.array([np.nan, np.inf, -np.inf, -5, 7, 1e30, 0])
    for _ in range(3):
        frame = Frame(
            color=rng.random((33, 18, 3)), albedo=rng.choice(bad, (33, 18, 3)),
            normal=rng.choice(bad, (33, 18, 3)), depth=rng.choice(bad, (33, 18)),
            motion=rng.choice(bad, (33, 18, 2)),
        )  # fmt: skip
        image = denoiser.denoise(frame)
        assert np.isfinite(image).all()
        assert image.min() >= 0


def test_black_albedo_loses_no_light(denoiser):
    color = np.full((33, 18, 3), 0.7, np.float32)
    image = denoiser.denoise(Frame(color=color, albedo=np.zeros((33, 18, 3))))
    np.testing.assert_allclose(image, 0.7, rtol=ROUNDING)


@pytest.mark.parametrize("model", MODELS)
@settings(max_examples=10, deadline=None)
@given(
    height=st.integers(1, 30), width=st.integers(1, 30), seed=st.integers(0, 2**31),
    firefly=st.sampled_from([0.0, 1e3, 1e8, 6e4]), frames=st.integers(1, 3),
)  # fmt: skip
def test_result_stays_in_the_range_of_the_input_of_its_window(
    model, height, width, seed, firefly, frames
):
    # without albedo and with a still camera the input of a window is its pixels so far
    rng = np.random.default_rng(seed)
    seen = []
    with stillray.Denoiser(model, threads=1) as denoiser:
        looks = kernels_of(denoiser.model.spec).looks
        # a previous output brings light from as far again
        reach = looks.reach * (frames if looks.previous_output else 1)
        for _ in range(frames):
            color = rng.random((height, width, 3)).astype(np.float32)
            color[rng.integers(height), rng.integers(width)] = firefly
            seen.append(color)
            image = denoiser.denoise(Frame(color=color, motion=_still(height, width)))
    low, high = np.min(seen, axis=0), np.max(seen, axis=0)
    for y in range(height):
        for x in range(width):
            window = tuple(slice(max(at - reach, 0), at + reach + 1) for at in (y, x))
            assert (image[y, x] >= low[window].min((0, 1)) * (1 - ROUNDING)).all()
            assert (image[y, x] <= high[window].max((0, 1)) * (1 + ROUNDING)).all()


def test_a_still_camera_keeps_its_picture_and_its_light(denoiser):
    truth = clean_color(48, 64)
    quality = []
    for index in range(40):
        image = denoiser.denoise(make_frame(48, 64, index))
        quality.append(_psnr(image, truth))
    assert min(quality[20:]) > quality[0] + 2  # what is fed back neither drifts nor blurs away
    # outlier weights and a loss that leads to medians both take a little light
    assert image.mean() == pytest.approx(truth.mean(), rel=0.05)


def test_reset_gives_the_first_frame_again(denoiser):
    first = denoiser.denoise(make_frame(33, 18, 0))
    second = denoiser.denoise(make_frame(33, 18, 0))
    denoiser.reset()
    np.testing.assert_array_equal(denoiser.denoise(make_frame(33, 18, 0)), first)
    assert not np.array_equal(first, second)


def test_a_new_size_starts_anew(denoiser):
    denoiser.denoise(make_frame(33, 18, 0))
    small = denoiser.denoise(make_frame(20, 21, 1))
    denoiser.reset()
    np.testing.assert_array_equal(denoiser.denoise(make_frame(20, 21, 1)), small)


def test_history_is_a_value_that_can_be_kept_and_put_back(denoiser):
    denoiser.denoise(make_frame(33, 18, 0))
    kept = denoiser.state
    mean = history_of(kept).mean
    copy = mean.copy()
    once = denoiser.denoise(make_frame(33, 18, 1))
    denoiser.denoise(make_frame(33, 18, 2))
    np.testing.assert_array_equal(mean, copy)
    denoiser.state = kept
    np.testing.assert_array_equal(denoiser.denoise(make_frame(33, 18, 1)), once)


def test_a_history_that_nobody_holds_is_written_over_without_a_trace(denoiser):
    frames = [make_frame(33, 18, seed, shift=0.7) for seed in range(5)]
    alone = [denoiser.denoise(frame) for frame in frames]
    denoiser.reset()
    watched, kept = [], []
    for frame in frames:  # whoever looks at the history makes it his own
        watched.append(denoiser.denoise(frame))
        kept.append(
            (
                remembered(denoiser),
                remembered(denoiser).mean.copy(),
                remembered(denoiser).surface_guides.copy(),
            )
        )
    np.testing.assert_array_equal(watched, alone)
    for history, mean, surface_guides in kept:
        np.testing.assert_array_equal(history.mean, mean)
        np.testing.assert_array_equal(history.surface_guides, surface_guides)


def test_pictures_are_the_caller_s(denoiser):
    images = [denoiser.denoise(make_frame(33, 18, seed)) for seed in range(3)]
    copies = [image.copy() for image in images]
    denoiser.denoise(make_frame(33, 18, 3))
    np.testing.assert_array_equal(images, copies)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e6, -1e30])
def test_motion_from_nowhere_brings_no_history(value, denoiser):
    first, second = make_frame(33, 18, 0), make_frame(33, 18, 1)
    denoiser.denoise(first)
    lost = dataclasses.replace(second, motion=np.full((33, 18, 2), value, np.float32))
    denoiser.denoise(lost)
    # the sample of this frame alone, which is worth at most 1
    assert remembered(denoiser).mean[..., 3].max() <= 1


def test_a_box_that_moved_away_leaves_no_ghost(denoiser):
    for seed in range(4):
        denoiser.denoise(make_frame(48, 64, seed, shift=0.0))
    image = denoiser.denoise(make_frame(48, 64, 9, shift=16.0))
    fresh = image  # the uncovered wall holds this frame's sample only
    samples = remembered(denoiser).mean[..., 3]
    row = 24
    uncovered = slice(64 // 2 - 12, 64 // 2 - 12 + 8)
    assert samples[row, uncovered].max() <= 1
    assert samples[2, 2] > 3
    wall = clean_color(48, 64)[2, 2] / clean_color(48, 64)[2, 2].max()
    seen = fresh[row, uncovered].mean(0)
    np.testing.assert_allclose(seen / seen.max(), wall, atol=0.25)


def test_threads_do_not_change_the_picture():
    images = []
    for threads in (1, 2, 5):
        with stillray.Denoiser("wskp-3s", threads=threads) as denoiser:
            images.append(
                [denoiser.denoise(make_frame(300, 401, seed, shift=1.3)) for seed in range(2)]
            )
    np.testing.assert_array_equal(images[0], images[1])
    np.testing.assert_array_equal(images[0], images[2])


def test_inputs_are_never_changed(denoiser):
    frame = make_frame(33, 18, 0)
    before = [array.copy() for array in (frame.color, frame.albedo, frame.normal, frame.motion)]
    for _ in range(2):
        denoiser.denoise(frame)
    for array, copy in zip(
        (frame.color, frame.albedo, frame.normal, frame.motion), before, strict=True
    ):
        np.testing.assert_array_equal(array, copy)


def test_one_image_call_equals_a_stream_s_first_frame():
    frame = make_frame(33, 18, 0)
    image = stillray.denoise(
        frame.color, frame.albedo, frame.normal, depth=frame.depth, model="fast"
    )
    with stillray.Denoiser("fast", temporal=False) as denoiser:
        np.testing.assert_array_equal(image, denoiser.denoise(frame))


def test_half_precision_buffers_are_taken():
    frame = make_frame(9, 9, 0)
    color = frame.color.astype(np.float16)
    np.testing.assert_array_equal(
        stillray.denoise(color), stillray.denoise(color.astype(np.float32))
    )


def _runs(denoiser, frame):
    return {stage.name: stage.runs for stage in denoiser.stages(frame)}


def test_stages_that_a_frame_does_not_call_for_are_not_run(denoiser):
    plain = Frame(color=np.ones((9, 9, 3)))
    denoiser.denoise(plain)
    assert {"reproject", "demodulate", "remodulate", "upscale"}.isdisjoint(denoiser.last_timings)
    assert not _runs(denoiser, plain)["demodulate"]
    frame = make_frame(9, 9, 0, shift=1.0)
    assert not _runs(denoiser, frame)["repair"]
    assert _runs(denoiser, frame)["reproject"]
    denoiser.denoise(frame)
    assert "reproject" in denoiser.last_timings
    assert ("remodulate" in denoiser.last_timings) == _runs(denoiser, frame)["remodulate"]
    broken = Frame(color=np.full((9, 9, 3), np.nan))
    assert _runs(denoiser, broken)["repair"]
    assert all(stage.reason for stage in denoiser.stages(frame))


def test_moving_frames_without_motion_use_no_history(denoiser):
    first = Frame(color=np.random.default_rng(0).random((9, 9, 3)))
    image = denoiser.denoise(first)
    np.testing.assert_array_equal(denoiser.denoise(first), image)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            {"color": np.ones((4, 5))},
            r"color must have shape \(height, width, 3 or 4\), got \(4, 5\)",
        ),
        ({"color": np.ones((0, 5, 3))}, "color must have shape"),
        ({"color": np.array("x")}, "color must be an array of floats or integers, got <U1"),
        (
            {"color": np.ones((4, 5, 3)), "albedo": np.ones((2, 5, 3))},
            r"albedo must have shape \(4, 5, 3\) like color, got \(2, 5, 3\)",
        ),
        (
            {"color": np.ones((4, 5, 3)), "depth": np.ones((4, 5, 2))},
            r"depth must have shape \(4, 5\) like color, got \(4, 5, 2\)",
        ),
        ({"color": np.ones((4, 5, 3)), "jitter": np.ones(3)}, "jitter must have shape"),
        ({"color": np.ones((4, 5, 3)), "jitter": np.full(2, 1.5)}, "jitter must be -1 to 1"),
        ({"color": np.ones((4, 5, 3)), "roughness": np.ones((4, 5, 2))}, "roughness must have"),
        ({"color": np.ones((4, 5, 3)), "specular_albedo": np.ones((4, 5))}, "specular_albedo must"),
        (
            {"color": np.ones((4, 5, 3)), "samples": np.ones((5, 4))},
            r"samples must have shape \(4, 5\) like color, got \(5, 4\)",
        ),
        *(
            ({"color": np.ones((4, 5, 3)), "samples": bad}, f"samples must be .* got {text}")
            for bad, text in [
                (0, "0"),
                (-2.5, "-2.5"),
                (np.inf, "inf"),
                (np.nan, "nan"),
                ("16", "'16'"),
                (np.full((4, 5), -1.0), "-1 at row 0, column 0"),
                (np.where(np.eye(4, 5)[::-1] * np.arange(5) > 2, np.inf, 1), "inf at row 0"),
            ]
        ),
    ],
)
def test_a_wrong_buffer_is_named_with_its_rule_and_value(arguments, message):
    with pytest.raises(stillray.InputError, match=message):
        Frame(**arguments)


def test_an_unknown_model_lists_those_there_are():
    names = "kpyr-5, kpyr-5s, nbg-2x1, nbg-2x3, nbg-7x3, wskp-3, wskp-3s, wskp-6, wskp-mr"
    with pytest.raises(stillray.InputError, match=rf"one of {names}, .*fast.*got best"):
        stillray.Denoiser("best")


@pytest.mark.parametrize("model", [None, 5, b"fast", ["fast"]])
def test_a_model_must_be_named_by_a_text_or_a_path(model):
    words = f"model must be a name.* got {re.escape(repr(model))}"
    with pytest.raises(stillray.InputError, match=words):
        stillray.Denoiser(model)


@pytest.mark.parametrize("memory", ["4G", True, float("nan"), [1 << 30]])
def test_memory_must_be_a_number_of_bytes(memory):
    words = f"max_memory must be a number of bytes.* got {re.escape(repr(memory))}"
    with pytest.raises(stillray.InputError, match=words):
        stillray.Denoiser("fast", max_memory=memory)
    with pytest.raises(stillray.InputError, match=words):
        stillray.ShotOptions(max_memory=memory)


@pytest.mark.parametrize("temporal", ["no", 0, None])
def test_temporal_must_be_true_or_false(temporal):
    with pytest.raises(
        stillray.InputError, match=f"temporal must be True or False, got {temporal!r}"
    ):
        stillray.Denoiser("fast", temporal=temporal)


def test_progress_must_be_something_to_call(denoiser):
    frame = make_frame(9, 9)
    with pytest.raises(stillray.InputError, match=r"progress must be something to call.* got 3"):
        denoiser.denoise(frame, progress=3)
    assert np.isfinite(denoiser.denoise(frame)).all()  # and nothing is held up by it


def test_one_image_says_that_its_albedo_has_no_noise():
    frame = make_frame(40, 50)
    found = [
        stillray.denoise(frame.color, frame.albedo, samples=4, clean_features=clean)
        for clean in (False, True)
    ]
    with stillray.Denoiser("high", temporal=False) as denoiser:
        expected = denoiser.denoise(
            Frame(color=frame.color, albedo=frame.albedo, samples=4, clean_features=True)
        )
    np.testing.assert_array_equal(found[1], expected)
    assert np.abs(found[0] - found[1]).max() > 1e-3


def test_a_frame_must_be_a_frame():
    color = np.ones((4, 6, 3), np.float32)
    words = r"frame must be a stillray.Frame, as Frame\(color=...\), got ndarray"
    with stillray.Denoiser("fast", threads=1) as denoiser:
        for use in (denoiser.denoise, denoiser.stages, lambda f: denoiser.denoise_layers(f, {})):
            with pytest.raises(stillray.InputError, match=words):
                use(color)


def test_a_file_that_is_no_model_is_refused(tmp_path):
    path = tmp_path / "x.onnx"
    path.write_bytes(b"not a model")
    with pytest.raises(stillray.InputError, match="not a usable ONNX model"):
        stillray.Denoiser(path)
    with pytest.raises(stillray.InputError, match="no such model file"):
        stillray.Denoiser(tmp_path / "none.onnx")


def test_bad_threads_and_providers_are_refused():
    with pytest.raises(stillray.InputError, match="threads must be an integer, 1 or more, got 0"):
        stillray.Denoiser("fast", threads=0)
    with pytest.raises(stillray.InputError, match=r"providers must be among .*, got Nonsense"):
        stillray.Denoiser("fast", providers=["Nonsense"])


def test_the_host_s_thread_keeps_its_denormals(denoiser):
    denoiser.denoise(make_frame(16, 16))
    dark = np.full(64, 1e-40, np.float32)
    assert (dark * np.float32(1) > 0).all()


def test_import_loads_neither_training_nor_inference_engine_nor_model():
    code = (
        "import sys, stillray; heavy = {'torch', 'mitsuba', 'onnxruntime', 'onnx', 'OpenImageIO',"
        "'stillray_training', 'stillray_export'} & set(sys.modules); print(sorted(heavy))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_the_command_line_loads_no_evaluation_until_it_is_asked_for():
    code = (
        "import sys, stillray.cli; stillray.cli.build_app();"
        "print([m for m in sys.modules if m.startswith('stillray_training') or m == 'matplotlib'])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("model", ["wskp-3s", "kpyr-5", "kpyr-5s"])
def test_a_warm_frame_takes_no_new_memory_but_for_its_picture(model):
    height, width = 360, 640  # strips are much smaller
    frames = swing(height, width)
    with stillray.Denoiser(model, threads=1) as denoiser:
        for turn in range(4):
            denoiser.denoise(frames[turn % 2])
        tracemalloc.start()
        before, _ = tracemalloc.get_traced_memory()
        picture = denoiser.denoise(frames[0])
        after, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
    plane = 4 * height * width
    # the picture is the caller's; nothing else stays, histories change places
    assert after - before < picture.nbytes + plane / 2
    assert peak - before < 4 * plane


# Calls as engines make them


@pytest.mark.parametrize("threads", [0, -1, 1.5, "2", True])
def test_threads_must_be_a_whole_number(threads):
    with pytest.raises(stillray.InputError, match="threads must be an integer, 1 or more"):
        stillray.Denoiser("fast", threads=threads)


def test_providers_are_names_or_names_with_options():
    with pytest.raises(stillray.InputError, match="the string 'CPUExecutionProvider'"):
        stillray.Denoiser("fast", providers="CPUExecutionProvider")
    chosen = [("CPUExecutionProvider", {"use_arena": "1"})]
    with stillray.Denoiser("fast", threads=np.int64(1), providers=chosen) as denoiser:
        assert denoiser.denoise(make_frame(4, 6)).shape == (4, 6, 3)


@pytest.mark.parametrize("model", ["fast", "online"])
def test_a_closed_denoiser_says_so(model):
    denoiser = stillray.Denoiser(model, threads=2)
    denoiser.close()
    denoiser.close()
    for use in (denoiser.denoise, denoiser.stages, lambda f: denoiser.denoise_layers(f, {})):
        with pytest.raises(stillray.InputError, match="it was closed"):
            use(make_frame(4, 6))


def test_a_second_thread_is_told_so_instead_of_mixing_frames():
    inside, go_on = threading.Event(), threading.Event()

    class Engine:
        def run(self, graph, inputs):
            inside.set()
            assert go_on.wait(60)
            raise KeyboardInterrupt  # the frame itself is of no interest

        def close(self):
            pass

    denoiser = stillray.Denoiser("fast", threads=1, engine=Engine())
    with ThreadPoolExecutor(1) as other:
        first = other.submit(denoiser.denoise, make_frame(8, 8))
        assert inside.wait(60)
        try:
            with pytest.raises(stillray.InputError, match="one thread at a time"):
                denoiser.denoise(make_frame(8, 8))
        finally:
            go_on.set()
        assert isinstance(first.exception(), KeyboardInterrupt)
    assert denoiser.stages(make_frame(8, 8))  # and the turn is free again


def _use_in_child(denoiser, queue):
    try:
        denoiser.denoise(make_frame(4, 6))
    except stillray.InputError as error:
        queue.put(str(error))


@pytest.mark.skipif("fork" not in multiprocessing.get_all_start_methods(), reason="no fork here")
def test_a_forked_child_is_told_so_instead_of_waiting_for_ever():
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    with stillray.Denoiser("fast", threads=2) as denoiser:
        child = context.Process(target=_use_in_child, args=(denoiser, queue), daemon=True)
        child.start()
        assert "made in the process that uses it" in queue.get(timeout=300)
        child.join()


def test_pictures_go_where_the_caller_says():
    frame = make_frame(12, 10)
    with stillray.Denoiser("fast", threads=1, temporal=False) as denoiser:
        expected = denoiser.denoise(frame)
        whole = np.full((14, 10, 4), -1, np.float64)
        part = whole[12:0:-1, :, :3]
        assert denoiser.denoise(frame, out=part) is part
        np.testing.assert_array_equal(part, expected)
        assert (whole[..., 3] == -1).all()
        assert (whole[[0, 13]] == -1).all()
        half = np.empty((12, 10, 3), np.float16)
        bright = Frame(color=np.full((12, 10, 3), 1e6))
        assert (denoiser.denoise(bright, out=half) == 65504).all()
        for wrong in (half[:4], half.astype(np.uint8), [1.0], np.broadcast_to(half, half.shape)):
            with pytest.raises(stillray.InputError, match="out must"):
                denoiser.denoise(frame, out=wrong)


@pytest.mark.parametrize("quality", ["high", "fast"])
def test_frames_of_color_alone_go_to_a_model_that_learned_from_such(quality):
    guided = make_frame(33, 50, 1)
    color = Frame(color=guided.color, depth=guided.depth)
    normals = Frame(color=guided.color, normal=guided.normal)
    other = for_single_frames(quality, guided=False)
    with (
        stillray.Denoiser(quality, temporal=False) as mixed,
        stillray.Denoiser(mixed.model.name) as as_named,
        stillray.Denoiser(other) as of_color,
    ):
        # whatever came before
        for frame in (color, guided, color, normals, color):
            of = of_color if frame is color else as_named
            np.testing.assert_array_equal(mixed.denoise(frame), of.denoise(frame))
            assert set(mixed.last_timings) == set(of.last_timings)
            assert mixed.stages(frame) == of.stages(frame)
        layers = {"half": color.color / 2}
        image, filtered = mixed.denoise_layers(color, layers)
        np.testing.assert_array_equal(image, of_color.denoise(color))
        np.testing.assert_allclose(2 * filtered["half"], image, rtol=1e-4)
    np.testing.assert_array_equal(stillray.denoise(color.color, model=quality), image)
    with pytest.raises(stillray.InputError, match="closed"):
        mixed.denoise(color)


def test_who_names_a_model_has_it_for_frames_of_color_alone_too():
    color = Frame(color=make_frame(33, 50, 1).color)
    with (
        stillray.Denoiser("kpyr-5-still", temporal=False) as alone,
        stillray.Denoiser("kpyr-5-still") as stream,
        stillray.Denoiser("high", temporal=False) as quality,
    ):
        image = alone.denoise(color)
        np.testing.assert_array_equal(image, stream.denoise(color))
        assert np.abs(image - quality.denoise(color)).max() > 0.001


@pytest.mark.parametrize("name", ["kpyr-5-color", "kpyr-5s-color"])
def test_a_model_of_color_alone_looks_at_no_more_whatever_a_frame_has(name):
    """Light was divided by an albedo that its network had never met."""
    frame = make_frame(33, 50, 1)
    with stillray.Denoiser(name, temporal=False) as denoiser:
        image = denoiser.denoise(Frame(color=frame.color))
        np.testing.assert_array_equal(denoiser.denoise(frame), image)
        assert not any(s.runs for s in denoiser.stages(frame) if "modulate" in s.name)
