"""Every stage of a frame graph beside the runtime's own."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.arrays.workspace import Workspace  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.model_spec.stages import ToldSamples  # noqa: E402
from stillray.stages import accumulate as runtime_accumulate  # noqa: E402
from stillray.stages import (  # noqa: E402
    albedo_history,
    demodulate,
    features,
    history_rejection,
    lamps,
    motion_dilation,
    previous_output,
    rare_light,
    relief,
    repair,
    specular_motion,
    texture,
)
from stillray.stages import recall as runtime_recall  # noqa: E402
from stillray.stages import reproject as runtime_reproject  # noqa: E402
from stillray.stages.decide import Wants  # noqa: E402
from stillray.stages.prepare import prepare  # noqa: E402
from stillray.stages.sample_counts import SampleCounts as RuntimeCounts  # noqa: E402
from stillray_export.frame_graph import (  # noqa: E402
    accumulation,
    albedo,
    camera,
    dilation,
    encode,
    exposure,
    frame,
    light,
    median,
    recall,
    reflections,
    rejection,
    reprojection,
    windows,
)
from stillray_export.frame_graph import lamps as graph_lamps  # noqa: E402
from stillray_export.frame_graph import rare_light as graph_rare_light  # noqa: E402
from stillray_export.frame_graph import relief as graph_relief  # noqa: E402
from stillray_export.frame_graph import repair as graph_repair  # noqa: E402
from stillray_export.frame_graph import texture as graph_texture  # noqa: E402
from stillray_export.frame_graph.moving import sequence  # noqa: E402
from stillray_training.decoders.demodulate import divisor  # noqa: E402

SPEC = load("kpyr-5")
SIZES = ((1, 1), (3, 17), (33, 18), (40, 49))


def planes(image: np.ndarray) -> torch.Tensor:
    """``(h, w, c)`` or ``(h, w)`` as ``(1, c, h, w)``."""
    image = image if image.ndim == 3 else image[..., None]
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


def image(tensor: torch.Tensor) -> np.ndarray:
    """``(1, c, h, w)`` as ``(h, w, c)``, of one channel as ``(h, w)``."""
    array = tensor[0].permute(1, 2, 0).numpy()
    return array[..., 0] if array.shape[2] == 1 else array


def scalar(value: float) -> torch.Tensor:
    return torch.tensor(value, dtype=torch.float32)


def light_of_frame(shape: tuple[int, int], seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).lognormal(0, 2, shape).astype(np.float32)


@pytest.mark.parametrize("count", [1, 2, 7, 100, 101])
def test_median_of_those_that_count(count):
    rng = np.random.default_rng(count)
    values = rng.lognormal(0, 20, 150).clip(1e-30, 1e30).astype(np.float32)
    counts = np.zeros(150, np.float32)
    counts[rng.permutation(150)[:count]] = 1
    got, number = median.masked_median(torch.from_numpy(values), torch.from_numpy(counts))
    assert number == count
    np.testing.assert_allclose(got, np.median(values[counts > 0]), rtol=1e-6)


def test_median_of_equal_values_is_that_value():
    values = torch.tensor([2.0, 0.0, 2.0, 2.0, 5.0])
    got, _ = median.masked_median(values, torch.tensor([1.0, 1.0, 1.0, 1.0, 0.0]))
    assert got == 2


@pytest.mark.parametrize(
    ("shape", "cells"), [((17, 30), (2, 3)), ((5, 9), (3, 5)), ((9, 16), (1, 2))]
)
def test_area_means_are_those_of_opencv(shape, cells):
    given = light_of_frame(shape)
    counted = (scalar(cells[0]), scalar(cells[1]))
    got = windows.area_means(planes(given), cells, counted, 16)
    wanted = cv2.resize(given, cells[::-1], interpolation=cv2.INTER_AREA)
    np.testing.assert_allclose(image(got).reshape(cells), wanted, rtol=1e-4)


@pytest.mark.parametrize("size", [*SIZES, (64, 97)])
def test_exposure_is_that_of_the_median_block(size):
    given = light_of_frame(size)
    given[: size[0] // 3] = 0
    wanted = features.frame_exposure(given, SPEC.transfer)
    got = exposure.frame_exposure(planes(given), SPEC.transfer)
    np.testing.assert_allclose(got, wanted, rtol=1e-4)


def test_exposure_of_a_black_frame_is_1_and_a_first_one_is_its_own():
    assert exposure.frame_exposure(torch.zeros(1, 1, 20, 20), SPEC.transfer) == 1
    assert exposure.steady_exposure(scalar(3), scalar(0), SPEC.transfer) == 3
    wanted = features.steady_exposure(3, 2, SPEC.transfer)
    np.testing.assert_allclose(
        exposure.steady_exposure(scalar(3), scalar(2), SPEC.transfer), wanted, rtol=1e-6
    )


@pytest.mark.parametrize("size", SIZES)
def test_local_luminance_and_divisor(size):
    toned = np.random.default_rng(1).uniform(0, 1, size).astype(np.float32)
    got = light.local_luminance(planes(toned), 13)
    np.testing.assert_allclose(
        image(got), features.local_luminance(toned, SPEC.transfer), rtol=1e-5
    )
    given = np.random.default_rng(2).uniform(0, 0.3, (*size, 3)).astype(np.float32)
    given[::2, ::2] = 0
    wanted = demodulate.demodulation_albedo(given, SPEC.demodulate)
    np.testing.assert_array_equal(image(divisor(planes(given), SPEC.demodulate)), wanted)


@pytest.mark.parametrize("size", SIZES)
def test_repair_of_radiance_fills_lone_pixels_from_the_same_windows(size):
    rng = np.random.default_rng(3)
    color = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    if color.size > 3:
        color[0, 0], color[-1, -1, 1], color[size[0] // 2, size[1] // 2, 2] = np.nan, np.inf, -3
    if min(size) > 20:
        color[10:13, 10:13] = np.nan  # the middle needs a window of 5x5
    wanted, broken = repair.repair_radiance(color)
    got, found = graph_repair.repair_radiance(planes(color), torch.zeros(1, 1, *size))
    np.testing.assert_allclose(image(got), wanted, rtol=1e-5)
    assert (image(found) > 0).sum() == (0 if broken is None else broken.sum())


@pytest.mark.parametrize("size", [(40, 49), (300, 70)])
def test_repair_fills_wide_holes_with_light_from_around(size):
    color = np.full((*size, 3), np.nan, np.float32)
    color[:, :3] = 2
    color[-1, -1] = 3
    got, broken = graph_repair.repair_radiance(planes(color), torch.zeros(1, 1, *size))
    assert got.min() >= 2 - 1e-5
    assert got.max() <= 3 + 1e-5
    assert broken.sum() == np.isnan(color[..., 0]).sum()
    nothing, _ = graph_repair.repair_radiance(planes(color * np.nan), torch.zeros(1, 1, *size))
    assert nothing.abs().max() == 0


def test_repair_of_features_and_motion():
    given = np.array([[np.nan, -2, 0.5, np.inf, 3e8]], np.float32)
    wanted = repair.repair_feature(given, -1, 1)
    np.testing.assert_array_equal(
        graph_repair.repair_feature(torch.from_numpy(given), -1, 1), wanted
    )
    wanted = repair.repair_motion(given)
    np.testing.assert_array_equal(graph_repair.repair_motion(torch.from_numpy(given)), wanted)


@pytest.mark.parametrize("size", SIZES)
def test_weights_of_samples_and_accumulation(size):
    rng = np.random.default_rng(4)
    luminance = light_of_frame(size)
    luminance.flat[0] = 1e31
    local = rng.uniform(0, 1, size).astype(np.float32)
    held = rng.uniform(0, 17, size).astype(np.float32)
    held[::3] = 0
    options = SPEC.temporal
    wanted = runtime_accumulate.sample_weight(luminance, local, held, 2.0, options).copy()
    got = accumulation.sample_weight(
        planes(luminance), planes(local), planes(held), scalar(2), options
    )
    np.testing.assert_allclose(image(got), wanted, rtol=1e-5)
    new = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    bounded, weight = accumulation.bound(planes(new), got)
    expected = runtime_accumulate.clamp_fireflies(new, wanted, new.copy())
    np.testing.assert_allclose(image(bounded), expected, rtol=1e-5)
    past = rng.lognormal(0, 2, (*size, 3)).astype(np.float32)
    stack = np.ascontiguousarray(np.concatenate([past, held[..., None]], -1).transpose(2, 0, 1))
    runtime_accumulate.accumulate(
        np.ascontiguousarray(expected.transpose(2, 0, 1)), wanted, stack, options
    )
    mean, samples = accumulation.accumulate(bounded, weight, planes(past), planes(held), options)
    np.testing.assert_allclose(image(mean), stack[:3].transpose(1, 2, 0), rtol=1e-5)
    np.testing.assert_allclose(image(samples), stack[3], rtol=1e-5)


@pytest.mark.parametrize("before", [0.0, 4.0])
def test_sample_counts(before):
    given = np.array([[1, 4, 0], [np.nan, 64, 7]], np.float32)
    wanted = RuntimeCounts.of(given, before or None)
    got = accumulation.SampleCounts(planes(given), scalar(before))
    np.testing.assert_allclose(got.mean, wanted.mean, rtol=1e-6)
    np.testing.assert_allclose(image(got.share), wanted.share, rtol=1e-6)
    np.testing.assert_allclose(got.past_scale, wanted.past_scale, rtol=1e-6)
    np.testing.assert_array_equal(image(got.empty), given == 0)
    silent = accumulation.SampleCounts(torch.full((1, 1, 2, 3), -1.0), scalar(before))
    assert silent.mean == before
    assert (silent.share == 1).all()
    assert silent.past_scale == 1


@pytest.mark.parametrize("given", ["both", "normal", "depth", "none"])
def test_guides_without_some_of_the_geometry_tell_the_same_pixels_apart(given):
    shown = sequence(1, 24, 31, broken=False)[0]
    normal = shown.normal if given in ("both", "normal") else None
    depth = shown.depth if given in ("both", "depth") else None
    got = reprojection.guide_planes(
        torch.zeros(1, 3, 24, 31) if normal is None else planes(normal),
        torch.zeros(1, 1, 24, 31) if depth is None else planes(depth),
    )
    if given == "none":
        assert (got == got[..., :1, :1]).all()
        return
    wanted = runtime_reproject.pack(normal, depth)
    np.testing.assert_allclose(image(got), wanted, atol=2e-6)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize(
    ("most_blur", "contrast", "edge_blur"),
    [(0.0, 0.0, 0.0), (1.5, 4.0, 0.0), (1.5, 4.0, 0.5), (0.0, 4.0, 0.5)],
)
def test_history_is_brought_here_tap_by_tap(size, most_blur, contrast, edge_blur):
    options = replace(
        SPEC.temporal, most_blur=most_blur, sharp_contrast=contrast, edge_blur=edge_blur
    )
    now, before = (sequence(2, *size, broken=False)[i] for i in (1, 0))
    rng = np.random.default_rng(5)
    history = rng.lognormal(0, 2, (*size, 4)).astype(np.float32)
    motion = now.motion + rng.normal(0, 1, now.motion.shape).astype(np.float32)
    motion[0, 0] = 1e6
    guides, past_guides = (runtime_reproject.pack(f.normal, f.depth) for f in (now, before))
    rows = slice(0, size[0])
    at = runtime_reproject.positions_of(motion, rows)
    discontinuous = np.zeros((size[0] + 1, size[1] + 1), np.uint8)
    runtime_reproject.mark_discontinuities(past_guides, rows, discontinuous)
    output = rng.lognormal(0, 2, (*size, 4)).astype(np.float32)
    edges = runtime_reproject.Edges.of(output, contrast, Strips(1))
    previous = runtime_reproject.PreviousFrame(history, past_guides, discontinuous, edges)
    wanted = runtime_reproject.reproject(previous, guides.transpose(2, 0, 1), at, rows, options)
    got = reprojection.reproject(
        torch.from_numpy(history),
        torch.from_numpy(past_guides),
        planes(guides),
        planes(at),
        options,
        torch.from_numpy(output[..., :3]),
    )
    np.testing.assert_allclose(image(got), wanted, rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("size", SIZES)
def test_silhouettes_follow_the_nearer_surface(size):
    shown = sequence(2, *size, broken=False)[1]
    wanted = runtime_reproject.positions_of(shown.motion, slice(0, size[0])).copy()
    motion_dilation.dilate_motion(wanted, shown.motion, shown.depth, slice(0, size[0]), Workspace())
    got = dilation.follow_nearer(planes(shown.motion), planes(shown.depth))
    np.testing.assert_allclose(image(got), wanted, atol=1e-4)


@pytest.mark.parametrize("sharp", [False, True])
@pytest.mark.parametrize("size", SIZES)
def test_the_last_output_is_recalled(size, sharp):
    rng = np.random.default_rng(6)
    output = np.ones((*size, 4), np.float32)
    output[..., :3] = rng.lognormal(0, 2, (*size, 3))
    places = np.stack(np.meshgrid(*(np.arange(n) for n in size[::-1])), -1).astype(np.float32)
    places += rng.normal(0, 2, places.shape).astype(np.float32)
    places[0, 0] = 1e6
    wanted = previous_output.resample(output, places, Strips(1), sharp=sharp)
    got, valid = recall.recall(torch.from_numpy(output[..., :3]), planes(places), sharp=sharp)
    np.testing.assert_allclose(image(got), wanted[..., :3], rtol=2e-3, atol=1e-5)
    np.testing.assert_allclose(image(valid), wanted[..., 3], atol=1e-5)


@pytest.mark.parametrize("samples", [None, 1.0, 16.0, "by pixel"])
@pytest.mark.parametrize("size", SIZES)
def test_as_much_of_the_last_output_is_recalled(size, samples, rng):
    light = rng.uniform(0.2, 2, (*size, 3)).astype(np.float32)
    color = light * np.exp(0.2 * rng.normal(size=(*size, 1))).astype(np.float32)
    color[rng.random(size) < 0.1] *= 20
    valid = (rng.random(size) < 0.9) * rng.random(size, np.float32)
    previous = np.dstack([light, valid])
    given = torch.full((1, 1, *size), -1.0)
    if samples == "by pixel":
        samples = rng.choice(np.float32([0, 0.5, 4, 100]), size)
        samples[0, 0] = 4
        given = torch.from_numpy(samples)[None, None]
    elif samples is not None:
        given = torch.full((1, 1, *size), samples)
    options = SPEC.decoder
    own = runtime_recall.Recall(
        power=options.recall_power,
        limit=options.recall_noise,
        counts=RuntimeCounts.of(samples, None),
    )
    worth = rng.uniform(0.1, 1.5, size).astype(np.float32)
    seen = runtime_recall.Compared(previous, previous, color, 0.7, worth)
    wanted = own.share(seen, Strips(1), Workspace())
    counts = accumulation.SampleCounts(given, scalar(0))
    lights = planes(light), planes(color)
    got = recall.recalled_share(lights, planes(worth), planes(valid), scalar(0.7), counts, options)
    for one, other in zip(got, (wanted.agreed, wanted.output), strict=True):
        np.testing.assert_allclose(image(one), other, rtol=2e-4, atol=1e-6)
    mean = rng.uniform(0.1, 9, (*size, 4)).astype(np.float32)
    sample = rng.uniform(0.1, 2, (4, *size)).astype(np.float32)
    agreed = wanted.agreed
    left = runtime_recall.believed(mean, sample, agreed, Strips(1), np.empty_like(mean))
    light, total = recall.believed(
        planes(mean[..., :3]), planes(mean[..., 3]), torch.from_numpy(sample)[None], planes(agreed)
    )
    np.testing.assert_allclose(image(light), left[..., :3], rtol=1e-5)
    np.testing.assert_allclose(image(total), left[..., 3], rtol=1e-5)


@pytest.mark.parametrize("size", [(17, 17), (33, 18), (101, 75)])
def test_history_is_rejected_where_light_changed(size):
    rng = np.random.default_rng(7)
    noise, got_noise = None, rejection.Noise(torch.zeros(1, 1, 1, 1), scalar(0), scalar(0))
    for step in range(3):
        past = rng.uniform(0.9, 1.1, (4, *size)).astype(np.float32)
        past[3] = 9
        shown = rng.gamma(4.0, 0.25, size).astype(np.float32)
        shown[:, size[1] // 2 :] *= 3
        weight = rng.uniform(0.05, 1, size).astype(np.float32)
        weight[0, 0] = 0
        motion = rng.normal(0, 4, (*size, 2)).astype(np.float32)
        halves = [-(-n // 2) for n in size]
        blocks = np.empty((history_rejection.PLANES, *halves), np.float32)
        history_rejection.compare(shown, weight, past.copy(), 0.5 + step, blocks, Workspace())
        got = rejection.compare(
            planes(shown), planes(weight), torch.from_numpy(past)[None], scalar(0.5 + step)
        )
        np.testing.assert_allclose(got[0], blocks, rtol=1e-5, atol=3e-5)
        wanted, noise = history_rejection.confidence(blocks, noise, motion, 0.5 + step, Strips(1))
        found, got_noise = rejection.confidence(
            torch.from_numpy(blocks)[None], got_noise, planes(motion), scalar(0.5 + step)
        )
        np.testing.assert_allclose(image(got_noise.variance), noise.variance, rtol=1e-3)
        assert wanted.min() < 0.1
        np.testing.assert_allclose(image(found), wanted, atol=2e-3)


@pytest.mark.parametrize("size", [(40, 49), (90, 120)])
def test_the_motion_of_the_camera_is_learned(size):
    shown = sequence(2, *size, broken=False)[1]
    wanted = specular_motion.camera_motion(shown.motion, shown.depth)
    got = camera.camera_motion(planes(shown.motion), planes(shown.depth))
    assert wanted is not None
    assert got.found == 1
    rows, columns = np.mgrid[: size[0], : size[1]]
    far, near = wanted.parts(rows, columns, np.full(size, 9, np.float32))
    longest = scalar(max(size))
    x = camera.place(planes(columns.astype(np.float32)), scalar(size[1]), longest)
    y = camera.place(planes(rows.astype(np.float32)), scalar(size[0]), longest)
    got_far, got_near = got.parts(x, y, torch.full((1, 1, *size), 9.0))
    np.testing.assert_allclose(image(got_far + got_near), far + near, atol=2e-3)
    astray = shown.motion + np.random.default_rng(0).normal(0, 3, shown.motion.shape)
    astray = astray.astype(np.float32)
    assert specular_motion.camera_motion(astray, shown.depth) is None
    assert camera.camera_motion(planes(astray), planes(shown.depth)).found == 0


@pytest.mark.parametrize("size", [(1, 1), (5, 7), (40, 49), (91, 120)])
def test_mirrors_are_followed(size):
    first, second = sequence(2, *size, broken=False)
    past = np.ones((*size, 4), np.float32)
    past[..., :3] = cv2.blur(first.color, (3, 3))
    now = features.luminance(cv2.blur(second.color, (3, 3)))
    wanted = second.motion
    if specular_motion.has_mirrors(second.albedo, SPEC.demodulate.black):
        surfaces = specular_motion.Surfaces(second.motion, second.depth, second.albedo)
        wanted = specular_motion.virtual_motion(
            surfaces, now, past, 0.3, SPEC.demodulate, Strips(1)
        )
        assert (wanted != second.motion).any()
    lights = (planes(now), reflections.light_of(torch.from_numpy(past)))
    buffers = (planes(second.motion), planes(second.depth))
    got = reflections.follow_reflections(
        *buffers, planes(second.albedo), lights, scalar(0.3), SPEC.demodulate
    )
    apart = np.abs(image(got) - wanted).max(-1)
    assert (apart > 0.01).mean() < 1e-3  # two depths that bring the past as near
    without = torch.full((1, 3, *size), -1.0)
    got = reflections.follow_reflections(*buffers, without, lights, scalar(0.3), SPEC.demodulate)
    np.testing.assert_array_equal(image(got), second.motion)


@pytest.mark.parametrize("held", [0.0, 1.0, 3.0])
@pytest.mark.parametrize("size", SIZES)
def test_albedo_is_accumulated(size, held):
    rng = np.random.default_rng(8)
    now = rng.uniform(0.1, 0.9, (*size, 3)).astype(np.float32)
    now[: size[0] // 2, : size[1] // 2] = 1
    past = np.ones((*size, 4), np.float32)
    past[..., :3] = rng.uniform(0.1, 0.9, (*size, 3))
    places = np.stack(np.meshgrid(*(np.arange(n) for n in size[::-1])), -1).astype(np.float32)
    places += rng.normal(0, 2, places.shape).astype(np.float32)
    remembered, modulator = np.empty_like(past), now.copy()
    if held:
        albedo_history.accumulate(
            now, past, min(held, 2), places, (remembered, modulator), Strips(1)
        )
    else:
        albedo_history.begin(now, remembered)
    got, mean, frames = albedo.accumulate_albedo(
        planes(now), torch.from_numpy(past[..., :3]), planes(places), scalar(held), scalar(2)
    )
    np.testing.assert_allclose(image(got), modulator, atol=1e-5)
    np.testing.assert_allclose(image(mean), remembered[..., :3], atol=1e-5)
    assert frames == min(held, 2) + 1


@pytest.mark.parametrize("size", SIZES)
def test_small_lamps_are_put_back(size):
    rng = np.random.default_rng(9)
    mean = np.ones((*size, 4), np.float32)
    mean[..., :3] = rng.exponential(1, (*size, 1)) + 0.1
    albedo = rng.uniform(0.2, 1, (*size, 3)).astype(np.float32)
    for _ in range(8):
        y, x = (int(rng.integers(length)) for length in size)
        mean[y : y + 3, x : x + 3, :3] = rng.uniform(5, 200)
    prepared = SimpleNamespace(
        history=SimpleNamespace(mean=mean, exposure=0.5),
        sample=None,
        remodulation_albedo=albedo,
    )
    wanted = albedo.copy()
    lamps.restore(wanted, prepared, Strips(1), Workspace())
    got = graph_lamps.restored(planes(albedo), planes(mean[..., :3] * albedo), scalar(0.5))
    assert np.any(wanted > 2 * albedo) or min(size) < 3
    np.testing.assert_allclose(image(got), wanted, rtol=1e-5)


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("samples", [0.0, 1.0, 2.0, 100.0])
def test_texture_is_put_back(size, samples):
    """Samples that nobody told are 0 here, and 1 to the network."""
    rng = np.random.default_rng(11)
    y, x = np.mgrid[: size[0], : size[1]]
    albedo = np.empty((*size, 3), np.float32)
    albedo[:] = 0.2 + 0.15 * np.sin(0.8 * x)[..., None] * np.cos(0.6 * y)[..., None]
    albedo[size[0] // 2 :, :2] = 0
    by = image(divisor(planes(albedo), SPEC.demodulate))
    mean = np.ones((*size, 4), np.float32)
    mean[..., :3] = rng.exponential(1, (*size, 1)) * albedo / by
    picture = (0.3 * by).astype(np.float32)
    normal = rng.normal(0, 0.2, (*size, 3)).astype(np.float32)
    depth = rng.uniform(1, 1.02, size).astype(np.float32)
    prepared = SimpleNamespace(
        albedo=albedo,
        depth=depth,
        normal=normal,
        luminance=mean[..., 0],
        mean=mean,
        remodulation_albedo=by,
        counts=SimpleNamespace(mean=samples),
        history=SimpleNamespace(exposure=0.5),
    )
    wanted, weights, workspace = picture.copy(), np.empty(size, np.float32), Workspace()
    relief.shade(picture.copy(), prepared, SPEC.relief.window, Strips(1), workspace, weights)
    if samples >= texture.FEWEST_SAMPLES:
        texture.put_back(wanted, prepared, SPEC, weights, Strips(1), workspace)
        assert np.abs(wanted / picture - 1).max() > 0.05 or min(size) < 3
    frame_ = SimpleNamespace(
        albedo=planes(albedo),
        irradiance=planes(mean[..., :3]),
        divisor=planes(by),
        told=scalar(samples or 1),
    )
    _, weight = graph_relief.surface_weight(planes(normal), planes(depth))
    got = graph_texture.texture_gain(planes(picture), frame_, weight, SPEC, scalar(0.5))
    np.testing.assert_allclose(image(got)[..., None] * picture, wanted, rtol=1e-5)


@pytest.mark.parametrize("size", [*SIZES, (64, 80), (131, 86)])
@pytest.mark.parametrize("often", [0.0, 0.05])
def test_the_light_of_rare_samples_is_put_back(size, often):
    rng = np.random.default_rng(10)
    picture = rng.uniform(0.5, 1, (*size, 3)).astype(np.float32)
    picture[: size[0] // 2] *= 30
    color = picture * rng.exponential(1, (*size, 1)).astype(np.float32)
    color[rng.random(size) < often] *= 1e3
    wanted = picture.copy()
    rare_light.restore(wanted, color, 0.3, Strips(1), Workspace())
    light = planes(color @ np.float32([0.2126, 0.7152, 0.0722]))
    gain = graph_rare_light.rare_light_gain(planes(picture), light, scalar(0.3))
    assert np.any(wanted > 1.5 * picture) or not often or min(size) < 64
    np.testing.assert_allclose(picture * image(gain)[..., None], wanted, rtol=1e-4)


@pytest.mark.parametrize(("name", "size"), [("kpyr-5", (61, 90)), ("kpyr-5s", (48, 77))])
def test_eight_frames_are_prepared_as_the_runtime_does(name, size):
    spec = load(name)
    graph = frame.FrameGraph(torch.nn.Identity(), spec)
    wants = Wants(sample=True, previous_output=True)
    past, state = None, frame.beginning(*size, spec)
    for shown in sequence(8, *size):
        wanted = prepare(shown, spec, past, Strips(1), wants)
        given = [getattr(shown, key) for key in ("color", "albedo", "normal", "depth", "motion")]
        buffers = frame.repaired(*map(torch.from_numpy, given), torch.full(size, -1.0), state)
        got, sample, left = graph.prepare(buffers, state)
        _same(left.mean, wanted.history.mean)
        _same(left.guides, wanted.history.surface_guides)
        _same(image(got.divisor), wanted.remodulation_albedo)
        np.testing.assert_allclose(left.numbers[0], wanted.history.exposure, rtol=1e-4)
        if past is not None:
            _same(image(sample), wanted.sample.transpose(1, 2, 0))
            recalled = previous_output.resampled(
                past, wanted, Strips(1), sharp=spec.decoder.sharp_recall
            )
            _same(image(got.previous), recalled[..., :3])
            _same(image(got.valid), recalled[..., 3])
        picture = np.ones((*size, 4), np.float32)
        picture[..., :3] = np.minimum(wanted.history.mean[..., :3], 50) * wanted.remodulation_albedo
        past = replace(wanted.history, output=picture)
        state = replace(left, output=torch.from_numpy(picture[..., :3].copy()))


def _same(got: np.ndarray | torch.Tensor, wanted: np.ndarray) -> None:
    """All but one pixel in a thousand to 1e-3: a threshold may be met by a rounding."""
    apart = np.abs(np.asarray(got) - wanted) / (np.abs(wanted) + 0.1 * np.abs(wanted).mean())
    assert (apart > 1e-3).mean() <= 1e-3


@pytest.mark.parametrize("share", [1.0, 0.25])
@pytest.mark.parametrize("samples", [None, 0.5, 3.0, 64.0])
def test_the_network_is_told_as_many_samples(share, samples, rng):
    spec = replace(load("kpyr-5-still"), told_samples=ToldSamples(share=share))
    held = rng.uniform(0.1, 9, (5, 6)).astype(np.float32)
    told = RuntimeCounts.of(samples, None).told(share)
    expected = np.sqrt(held * told / (held * told + spec.temporal.max_samples / 4))
    given = torch.full((1, 1, 5, 6), -1.0 if samples is None else samples)
    counts = accumulation.SampleCounts(given, scalar(0.0))
    told = SimpleNamespace(held=planes(held), told=counts.told)
    np.testing.assert_allclose(encode.samples_plane(told, spec)[0, 0], expected, rtol=1e-6)
