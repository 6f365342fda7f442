"""Scripts written for Mitsuba's OptixDenoiser, run on the CPU."""

from __future__ import annotations

import inspect
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest

import stillray
from stillray.errors import InputError
from stillray.mitsuba import FAR, Denoiser, flow
from stillray_training.mitsuba_cost import costs
from tests.conftest import make_frame

mi.set_variant("scalar_rgb")
HEIGHT, WIDTH = 24, 32
FAST = {"model": "kpyr-5s", "threads": 1}


@pytest.fixture(scope="module")
def stream():
    with stillray.Denoiser("kpyr-5s", threads=1) as made:
        yield made


@pytest.fixture
def frames(stream):
    stream.reset()
    return [make_frame(HEIGHT, WIDTH, seed, shift=1.0) for seed in range(3)]


def tensor(array):
    return mi.TensorXf(np.ascontiguousarray(array, np.float32))


def test_arguments_are_theirs():
    theirs = mi.OptixDenoiser.__init__.__doc__.splitlines()[0]
    wanted = [part.split(":")[0].strip() for part in theirs[theirs.index("(") + 1 :].split(", ")]
    assert list(inspect.signature(Denoiser.__init__).parameters)[: len(wanted)] == wanted
    theirs = mi.OptixDenoiser.__call__.__doc__.splitlines()[0]
    wanted = [part.split(":")[0].strip() for part in theirs[theirs.index("(") + 1 :].split(", ")]
    assert list(inspect.signature(Denoiser.__call__).parameters)[: len(wanted)] == wanted


def test_the_film_s_filter_is_told(frames):
    color, albedo = frames[0].color.copy(), frames[0].albedo
    color[8:12, 10:14] = 50
    clean = {}
    for spread in (None, 0.5):
        with Denoiser((WIDTH, HEIGHT), albedo=True, filter_spread=spread, **FAST) as denoiser:
            clean[spread] = np.array(denoiser(tensor(color), tensor(albedo)))
        frame = stillray.Frame(color=color, albedo=albedo, filter_spread=spread)
        with stillray.Denoiser("kpyr-5s", threads=1, temporal=False) as bare:
            np.testing.assert_array_equal(clean[spread], bare.denoise(frame))
    assert not np.array_equal(clean[None], clean[0.5])
    with pytest.raises(InputError, match="filter_spread must be 0 to 4 pixels, got -1"):
        Denoiser((WIDTH, HEIGHT), filter_spread=-1)


def test_a_sequence_of_tensors_is_the_bare_stream(frames, stream):
    size = mi.ScalarVector2u(WIDTH, HEIGHT)
    with Denoiser(size, albedo=True, normals=True, temporal=True, **FAST) as denoiser:
        before = tensor(frames[0].color)
        for frame in frames:
            before = denoiser(
                tensor(frame.color),
                tensor(frame.albedo),
                tensor(frame.normal),
                flow=tensor(-frame.motion),  # theirs is current minus previous
                previous_denoised=before,
            )
            assert isinstance(before, mi.TensorXf)
            expected = stream.denoise(
                stillray.Frame(
                    color=frame.color,
                    albedo=frame.albedo,
                    normal=frame.normal,
                    motion=frame.motion,
                )
            )
            np.testing.assert_array_equal(np.array(before), expected)
        # the noisy picture as the previous one begins anew
        again = tensor(frames[0].color)
        first = denoiser(
            again,
            tensor(frames[0].albedo),
            tensor(frames[0].normal),
            None,
            tensor(-frames[0].motion),
            again,
        )
        stream.reset()
        single = stillray.Frame(
            color=frames[0].color, albedo=frames[0].albedo, normal=frames[0].normal,
            motion=frames[0].motion,
        )  # fmt: skip
        np.testing.assert_array_equal(np.array(first), stream.denoise(single))


def test_only_the_noisy_picture_itself_begins_anew(frames, stream):
    first, second = (stillray.Frame(color=f.color, motion=f.motion) for f in frames[:2])
    first.color[0, 0] = second.color[0, 0] = np.nan
    nearly = second.color.copy()
    nearly[-1, -1, 2] += 1
    stream.denoise(first)
    wanted = {"with a past": stream.denoise(second)}
    stream.reset()
    wanted["anew"] = stream.denoise(second)
    for how, before in (("with a past", nearly), ("anew", second.color)):
        with Denoiser((WIDTH, HEIGHT), temporal=True, **FAST) as denoiser:
            for frame, previous in ((first, None), (second, before)):
                flow_now = tensor(-frame.motion)
                previous = None if previous is None else tensor(previous)
                clean = denoiser(tensor(frame.color), flow=flow_now, previous_denoised=previous)
            np.testing.assert_array_equal(np.array(clean), wanted[how])
    assert not np.array_equal(wanted["anew"], wanted["with a past"])


def test_a_bitmap_of_many_channels_is_the_same_as_tensors(frames):
    frame = frames[0]
    flow_now = -frame.motion
    names = ["R", "G", "B", "A", "alb.R", "alb.G", "alb.B", "nn.X", "nn.Y", "nn.Z", "fl.X", "fl.Y"]
    alpha = np.random.default_rng(2).random((HEIGHT, WIDTH, 1), np.float32)
    noisy = np.concatenate([frame.color, alpha], axis=2)
    planes = np.concatenate([noisy, frame.albedo, frame.normal, flow_now], axis=2)
    bitmap = mi.Bitmap(np.ascontiguousarray(planes, np.float32), channel_names=names)
    to_sensor = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    with Denoiser((WIDTH, HEIGHT), True, True, temporal=True, **FAST) as denoiser:
        clean = denoiser(
            bitmap, albedo_ch="alb", normals_ch="nn", flow_ch="fl", to_sensor=to_sensor,
            previous_denoised_ch="<root>", noisy_ch="<root>",
        )  # fmt: skip
        assert isinstance(clean, mi.Bitmap)
        assert clean.pixel_format() == mi.Bitmap.PixelFormat.RGBA
        denoiser.reset()
        by_place = denoiser(bitmap, "alb", "nn", to_sensor, "fl")
        denoiser.reset()
        tensors = denoiser(
            tensor(noisy), tensor(frame.albedo), tensor(frame.normal), flow=tensor(flow_now)
        )
    np.testing.assert_array_equal(np.array(clean), np.array(tensors))
    np.testing.assert_array_equal(np.array(by_place), np.array(tensors))
    np.testing.assert_array_equal(np.array(clean)[..., 3], alpha[..., 0])  # kept as it is


def test_an_array_gives_an_array(frames, stream):
    with Denoiser((WIDTH, HEIGHT), **FAST) as denoiser:
        clean = denoiser(frames[0].color)
    assert type(clean) is np.ndarray
    np.testing.assert_array_equal(clean, stream.denoise(stillray.Frame(color=frames[0].color)))


def test_alpha_is_filtered_on_request(frames):
    alpha = (np.random.default_rng(2).random((HEIGHT, WIDTH, 1)) < 0.5).astype(np.float32)
    noisy = np.concatenate([frames[0].color, alpha], axis=2)
    with Denoiser((WIDTH, HEIGHT), denoise_alpha=True, **FAST) as denoiser:
        clean = np.array(denoiser(tensor(noisy)))
        rgb = np.array(denoiser(tensor(noisy[..., :3])))
    np.testing.assert_array_equal(clean[..., :3], rgb)
    assert clean[..., 3].std() < 0.6 * alpha.std()
    assert 0 <= clean[..., 3].min() <= clean[..., 3].max() <= 1


def test_what_is_missing_or_wrong_is_said(frames):
    noisy = tensor(frames[0].color)
    with Denoiser((WIDTH, HEIGHT), albedo=True, **FAST) as denoiser:
        with pytest.raises(InputError, match="albedo must be given"):
            denoiser(noisy)
        with pytest.raises(InputError, match=r"noisy must have shape \(24, 32, 3\)"):
            denoiser(tensor(np.zeros((WIDTH, HEIGHT, 3))), noisy)
        with pytest.raises(InputError, match="with a Bitmap only"):
            denoiser(noisy, albedo_ch="alb")
        bitmap = mi.Bitmap(frames[0].color)
        with pytest.raises(InputError, match="alb is not in"):
            denoiser(bitmap, albedo_ch="alb")
        with pytest.raises(InputError, match="albedo_channel is no argument"):
            denoiser(bitmap, albedo_channel="alb")
    with (
        Denoiser((WIDTH, HEIGHT), temporal=True, **FAST) as denoiser,
        pytest.raises(InputError, match=r"flow must have shape \(24, 32, 2\), got \(24, 32, 3\)"),
    ):
        denoiser(noisy, flow=noisy)
    with pytest.raises(InputError, match="input_size"):
        Denoiser((0, 4))


def test_a_call_takes_longer_than_its_stream():
    found, copies = costs("fast", (HEIGHT, WIDTH), 3, threads=1)
    assert np.shape(found) == (3, 2)
    assert np.shape(copies) == (3, 2)
    assert np.min(found) > 0
    assert np.min(copies) > 0


# Flow


def camera(origin, target=(0, 0, 0), *, offset=0.0, variant=mi):
    return variant.load_dict(
        {
            "type": "perspective",
            "fov": 40,
            "principal_point_offset_x": offset,
            "to_world": variant.ScalarTransform4f().look_at(origin, target, [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT},
        }
    )


def ray(sensor, x, y):
    """The renderer's own ray through a place of the picture, pixels."""
    place = mi.Point2f(float(x / WIDTH), float(y / HEIGHT))
    found = sensor.sample_ray(0, 0.5, place, mi.Point2f(0.5))[0]
    # of one ray, whichever variant is set
    return SimpleNamespace(o=np.array(found.o).ravel(), d=np.array(found.d).ravel())


@pytest.mark.parametrize("offset", [0.0, 0.13])
def test_flow_is_what_the_renderers_rays_say(offset):
    before = camera([0.4, -0.2, 5.5], [0.1, 0, 0], offset=offset)
    now = camera([0, 0.1, 5], offset=offset)
    rng = np.random.default_rng(4)
    position = np.zeros((HEIGHT, WIDTH, 3))
    expected = {}
    for y in range(0, HEIGHT, 5):
        for x in range(0, WIDTH, 6):
            # a point seen before at a place of our choice; where it is now, the answer must tell
            at = rng.uniform([2, 2], [WIDTH - 2, HEIGHT - 2])
            seen = ray(before, *at)
            position[y, x] = np.array(seen.o) + rng.uniform(2, 6) * np.array(seen.d)
            expected[y, x] = at
    got = flow(position, before, now)
    assert got.dtype == np.float32
    for (y, x), at in expected.items():
        now_at = at + got[y, x]
        again = ray(now, *now_at)
        along = position[y, x] - np.array(again.o)
        away = along - np.dot(along, np.array(again.d)) * np.array(again.d)
        assert np.linalg.norm(away) < 1e-4 * np.linalg.norm(along)


def test_flow_of_the_sky_is_that_of_directions():
    before = camera([0, 0, 5], [0.3, 0.2, 0], offset=0.1)
    now = camera([1, 2, 8], [0.7, 2.4, 0], offset=0.1)
    got = flow(np.zeros((HEIGHT, WIDTH, 3)), before, now)
    for y, x in ((3, 4), (12, 20), (20, 30)):
        direction = np.array(ray(now, x + 0.5, y + 0.5).d)
        earlier = ray(before, *(np.array([x + 0.5, y + 0.5]) - got[y, x]))
        np.testing.assert_allclose(np.array(earlier.d), direction, atol=1e-5)
    assert not flow(np.zeros((HEIGHT, WIDTH, 3)), now, now).round(4).any()


def test_what_was_behind_the_camera_comes_from_far_away():
    position = np.full((HEIGHT, WIDTH, 3), (0.1, 0.1, 2.0))
    assert (flow(position, camera([0, 0, 1], [0, 0, 0]), camera([0, 0, 5])) == FAR).all()
    with pytest.raises(InputError, match="position must have shape"):
        flow(position[..., :2], np.eye(4), np.eye(4))
    with pytest.raises(InputError, match="a camera must be"):
        flow(position, np.eye(3), np.eye(4))
