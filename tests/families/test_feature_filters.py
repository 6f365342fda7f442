"""Models that denoise and upscale at once: their frames, their past, and their twin in training."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import stillray
from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.feature_filters import FeatureFiltersModel, Remembered, warped
from stillray.families.feature_reconstruction import Accumulated
from stillray.families.filter_layout import target_layout
from stillray.families.target_grid import Grid, dilated, recalled
from stillray.frame import Frame
from stillray.model_spec import load
from stillray.model_spec.network_outputs import network_outputs
from stillray.models.network_graph import Interface, Planes
from stillray.models.registry import ModelInfo
from stillray.pipeline.denoiser import Denoiser
from stillray.stages import features, rare_light
from stillray.stages.accumulate import bounded
from stillray_training.networks.multi_branch import multi_branch_net
from stillray_training.upscaling import unroll

BOTH = ["munet-x2", "munet-x1"]


def info(name, *, sharp=True, **temporal):
    spec = load(name)
    decoder = replace(spec.decoder, sharp_recall=sharp)
    temporal = {"sharp_contrast": 4.0 if sharp else 0.0, **temporal}
    spec = replace(spec, temporal=replace(spec.temporal, **temporal), decoder=decoder)
    outputs = tuple(Planes(count, part) for count, part in network_outputs(spec))
    return ModelInfo(
        name=spec.name, family=spec.family, summary="", aliases=(), path=Path("none.onnx"),
        parameters=0, size_bytes=0, inputs=spec.inputs.required,
        optional_inputs=spec.inputs.optional, scores={}, provenance={}, spec=spec,
        interface=Interface(features=len(spec.network.features), outputs=outputs,
                            multiplications=1.0),
    )  # fmt: skip


class Untrained:
    """An engine that runs a network of random weights."""

    def __init__(self, name):
        torch.manual_seed(3)
        self.network = multi_branch_net(load(name)).eval()

    def run(self, graph, inputs):
        with torch.no_grad():
            outputs = self.network(torch.from_numpy(inputs["features"]))
        return {str(index): 3 * part[0].numpy() for index, part in enumerate(outputs)}

    def close(self):
        pass


@pytest.fixture(params=BOTH)
def denoiser(request):
    with Denoiser(info(request.param), threads=1, engine=Untrained(request.param)) as made:
        yield made


def frame(rng, size=(7, 11), move=0.4, **changes):
    """Every buffer, of some noise, with a mirror and background."""
    buffers = {
        "color": rng.lognormal(0, 1, (*size, 3)),
        "albedo": rng.random((*size, 3)) * (rng.random((*size, 1)) < 0.8),
        "normal": rng.uniform(-1, 1, (*size, 3)),
        "depth": rng.uniform(1, 9, size) * (rng.random(size) < 0.9),
        "motion": move * rng.normal(size=(*size, 2)),
        "roughness": rng.random(size),
        "specular_albedo": rng.random((*size, 3)),
        "jitter": rng.uniform(-0.5, 0.5, 2),
    }
    buffers.update(changes)
    return Frame(**{name: buffer for name, buffer in buffers.items() if buffer is not None})


def scale_of(denoiser):
    return denoiser.model.spec.decoder.scale


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (16, 8)])
def test_pictures_are_of_the_scales_size_and_finite(rng, denoiser, size):
    for _ in range(3):
        image = denoiser.denoise(frame(rng, size))
        assert image.shape == (size[0] * scale_of(denoiser), size[1] * scale_of(denoiser), 3)
        assert np.isfinite(image).all()
        assert image.min() >= 0


def test_what_is_said_is_what_runs(rng, denoiser):
    broken = np.ones((7, 11, 3))
    broken[2, 3] = np.nan
    given = [frame(rng), frame(rng), frame(rng, motion=None), frame(rng, (5, 5)),
             frame(rng, (5, 5), color=broken[:5, :5]), frame(rng, (5, 5), jitter=None)]  # fmt: skip
    for one in given:
        said = {stage.name for stage in denoiser.stages(one) if stage.runs}
        assert np.isfinite(denoiser.denoise(one)).all()
        assert said == set(denoiser.last_timings)


def test_rare_light_is_remembered_at_lamps_as_around_them(rng, denoiser, monkeypatch):
    """A lamp's own light is not, and what was there before it has the gain of the picture."""
    color = np.ones((40, 60, 3), np.float32)
    color[20:23, 30:33] = 100
    lit = frame(rng, (40, 60), color=color, jitter=None)
    remembered, images = [], []
    for gain in (1, 3):

        def restore(image, *given, gain=gain):
            image *= gain
            return np.full(image.shape[:2], np.float32(gain))

        monkeypatch.setattr(rare_light, "restore", restore)
        denoiser.reset()
        images.append(denoiser.denoise(lit))
        remembered.append(denoiser.state.temporal.output[..., :3].copy())
    np.testing.assert_allclose(images[1], 3 * images[0], rtol=1e-6)
    np.testing.assert_allclose(remembered[1], 3 * remembered[0], rtol=1e-6)
    assert (images[0] > 1.1 * remembered[0]).any()


def test_a_cut_a_new_size_and_missing_motion_begin_anew(rng, denoiser):
    first, second = frame(rng), frame(rng)
    alone = denoiser.denoise(second)
    denoiser.reset()
    denoiser.denoise(first)
    assert np.abs(denoiser.denoise(second) - alone).max() > 1e-3
    denoiser.reset()
    np.testing.assert_array_equal(denoiser.denoise(second), alone)
    denoiser.denoise(frame(rng, (4, 4)))
    np.testing.assert_array_equal(denoiser.denoise(second), alone)
    denoiser.denoise(first)
    still = frame(np.random.default_rng(1), motion=None)
    held = denoiser.denoise(still)
    denoiser.reset()
    np.testing.assert_array_equal(denoiser.denoise(still), held)


@pytest.mark.parametrize("name", ["albedo", "normal", "depth", "roughness", "specular_albedo",
                                  "jitter"])  # fmt: skip
def test_a_buffer_may_be_missing(rng, denoiser, name):
    for _ in range(2):
        assert np.isfinite(denoiser.denoise(frame(rng, **{name: None}))).all()


def test_broken_guides_are_repaired(rng, denoiser):
    rough, gloss = rng.random((7, 11)), rng.random((7, 11, 3))
    rough[0, 0], gloss[1, 1] = np.nan, np.inf
    motion = rng.normal(size=(7, 11, 2))
    motion[3, 3] = np.nan
    for _ in range(2):
        given = frame(rng, roughness=rough, specular_albedo=gloss, motion=motion)
        assert np.isfinite(denoiser.denoise(given)).all()


def test_pictures_scale_with_their_light(rng, denoiser):
    given = [frame(rng) for _ in range(3)]
    plain = [denoiser.denoise(one) for one in given][-1]
    denoiser.reset()
    bright = [Frame(**{**vars(one), "color": one.color * np.float32(1e4)}) for one in given]
    np.testing.assert_allclose(
        [denoiser.denoise(one) for one in bright][-1], 1e4 * plain, rtol=2e-3
    )


# a sharp look at the border sees whether the picture ends there, as it does not in a padded one
@pytest.mark.parametrize(
    ("most_blur", "sharp", "size"),
    [(0.0, False, (7, 11)), (0.3, False, (7, 11)), (0.3, True, (8, 16))],
)
@pytest.mark.parametrize("name", BOTH)
def test_training_sees_what_the_runtime_does(rng, name, most_blur, sharp, size):
    """The recurrence in PyTorch on the same frames gives the same pictures, at odd sizes too."""
    model = info(name, most_blur=most_blur, sharp=sharp)
    given = [frame(rng, size) for _ in range(4)]
    # the runtime takes another depth for another view, which training does not have
    depths = (np.where(one.depth > 0, 2 + one.depth / 20, 0) for one in given)
    given = [replace(one, depth=depth) for one, depth in zip(given, depths, strict=True)]
    assert_same_pictures(model, given)


@pytest.mark.parametrize("name", BOTH)
def test_training_lets_go_of_a_past_as_the_runtime_does(rng, name):
    """A shadow over a part of the frame, then one that is a little darker."""
    size = (16, 160)
    depth, still = np.full(size, 3.0), np.zeros((*size, 2))
    given = []
    for shade in (1.0, 1.0, 0.2, 0.2, 0.15):
        light = rng.gamma(16, 1 / 16, (*size, 1)) * np.ones(3)
        light[:, :14] *= shade
        given.append(frame(rng, size, color=light, depth=depth, motion=still))
    kept = assert_same_pictures(info(name, most_blur=0.0), given)
    # where the light changed, and where it did not: the samples that are held, frame by frame
    shaded, lit = ([held[..., part].mean() for held in kept] for part in np.s_[2:10, -8:-2])
    assert shaded[1] > 1.5
    assert shaded[2] == 1
    assert lit[2] > lit[1]


def assert_same_pictures(model, given):
    """Denoised by the runtime and by the recurrence; what that accumulates of light, samples."""
    spec, engine = model.spec, Untrained(model.name)
    network, kept = engine.network, []
    before, exposure = None, None
    denoiser = Denoiser(model, threads=1, engine=engine)
    for one in given:
        expected = denoiser.denoise(one)
        own = features.frame_exposure(features.luminance(one.color), spec.transfer)
        exposure = (
            own if exposure is None else features.steady_exposure(own, exposure, spec.transfer)
        )
        light = bounded(one.color, exposure, spec.transfer, spec.temporal)
        sample = as_training_does(replace(one, color=light), spec, exposure)

        def tripled(planes):
            return tuple(3 * part for part in network(planes))

        with torch.no_grad():
            image, before, _ = unroll.step(
                tripled, sample, before, spec.network.features, FeatureFiltersModel(spec).rules
            )
        height, width = expected.shape[:2]
        found = image[0, :, :height, :width].permute(1, 2, 0).numpy()
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-4)
        kept.append(before.light[0, 3, :height, :width].numpy())
    return kept


def as_training_does(one, spec, exposure):
    grid = Grid.of(one.shape, spec.decoder.scale, FeatureFiltersModel(spec).alignment, one.jitter)
    every = slice(0, grid.full[0])
    positions, inside = grid.past_positions(dilated(one.motion, one.depth, Strips(1)), every)

    def planes(image):
        return torch.from_numpy(np.atleast_3d(grid.take(image, every)).transpose(2, 0, 1).copy())

    right, down = np.broadcast_arrays(grid.right, grid.down[:, None])
    names = {"color": "color", "albedo": "albedo", "specular": "specular_albedo",
             "normal": "normal", "roughness": "roughness", "depth": "depth"}  # fmt: skip
    sample = {name: planes(getattr(one, buffer)) for name, buffer in names.items()}
    sample |= {
        "shown": torch.from_numpy(one.color.transpose(2, 0, 1).copy()),
        "moved": torch.from_numpy(one.motion.transpose(2, 0, 1).copy()),
        "rows": torch.from_numpy(grid.rows),
        "columns": torch.from_numpy(grid.columns),
        "offset": torch.from_numpy(np.stack([right, down])),
        "positions": torch.from_numpy(positions),
        "inside": torch.from_numpy(inside[None].astype(np.float32)),
        "exposure": torch.full((1, 1, 1), exposure),
        "depth_unit": torch.full((1, 1, 1), features.depth_scale(one.depth)),
    }
    return {name: value[None] for name, value in sample.items()}


@pytest.mark.parametrize("jitter", [None, (0.0, 0.0), (0.4, -0.3), (-0.5, 0.49)])
def test_a_pixel_takes_the_sample_next_to_it(jitter):
    grid = Grid.of((5, 3), 2, 8, None if jitter is None else np.array(jitter))
    x, y = jitter or (0.0, 0.0)
    assert grid.shape == (10, 6)
    assert grid.full == (16, 8)
    for offset, index, far, count in (
        (grid.right, grid.columns, x, 3),
        (grid.down, grid.rows, y, 5),
    ):
        for pixel in range(2 * count):
            apart = [2 * (i + 0.5 + far) - (pixel + 0.5) for i in range(count)]
            assert abs(apart[index[pixel]]) == min(map(abs, apart))
            assert offset[pixel] == pytest.approx(apart[index[pixel]], abs=1e-6)


@pytest.mark.parametrize("most_blur", [0.0, 0.25, 1.5])
def test_a_past_is_worth_no_more_samples_than_looks_have_blurred(rng, most_blur):
    grid = Grid.of((5, 7), 2, 8, None)
    motion = rng.integers(-4, 5, (5, 7, 2)).astype(np.float32) / 4 + np.float32(0.05)
    motion[2:4] = 1.5  # three pixels of the picture: nothing is blurred
    full = [rng.uniform(0, 30, (*grid.shape, 4)).astype(np.float32) for _ in range(4)]
    before = Remembered(Accumulated(*full[:3]), full[3], 1.0)
    rules = replace(FeatureFiltersModel(load("munet-x1")).rules, most_blur=most_blur)
    filters = replace(rules.filters, sharp_recall=False)
    rules = replace(rules, filters=filters, sharp_contrast=0.0)
    found = warped(before, grid, motion, rules, Strips(1), Workspace())
    positions, inside = grid.past_positions(motion, slice(0, grid.full[0]))
    kept = found.accumulated
    for image, source in zip((kept.light, kept.albedo, kept.specular), full, strict=False):
        expected = recalled(source, positions)
        for y, x in np.ndindex(grid.full):
            apart = positions[y, x].astype(np.float64) % 1
            blur = sum(share * (1 - share) for share in apart)
            if most_blur and blur > 0:
                expected[y, x, 3] = min(expected[y, x, 3], most_blur / blur)
            if not inside[y, x]:
                expected[y, x] = 0
        np.testing.assert_allclose(image, expected, rtol=1e-5)
    assert kept.light[5, 3, 3] == pytest.approx(full[0][8, 6, 3])
    np.testing.assert_array_equal(found.output[inside], recalled(full[3], positions)[inside])


def test_an_edge_that_moves_frame_after_frame_stays_sharp():
    grid, flat = Grid.of((8, 64), 1, 8, None), np.ones((8, 64, 4), np.float32)
    motion = np.zeros((8, 64, 2), np.float32)
    motion[..., 0] = -0.5
    widths = {}
    for sharp in (False, True):
        rules = FeatureFiltersModel(info("munet-x1", sharp=sharp).spec).rules
        picture = flat.copy()
        picture[:, :20, :3] = 0
        for _ in range(16):
            before = Remembered(Accumulated(flat, picture, flat), picture, 1.0)
            found = warped(before, grid, motion, rules, Strips(1), Workspace())
            assert found.output.max() <= 1 + 1e-6
            picture = found.output
            picture[:, :2] = picture[:, 2:3]
        line = picture[4, :, 0]
        widths[sharp] = int(((line > 0.05) & (line < 0.95)).sum())
        apart = np.abs(found.output - found.accumulated.albedo)[..., :3].max()
        assert (apart > 0.02) == sharp  # the albedo is not sharpened
    assert widths[True] <= 3 < 2 * widths[True] < widths[False]


def test_light_is_looked_up_as_sharply_as_the_picture_where_that_has_an_edge(rng):
    grid, even = Grid.of((8, 64), 1, 8, None), np.ones((8, 64, 4), np.float32)
    motion = np.zeros((8, 64, 2), np.float32)
    motion[..., 0] = -0.3
    light = rng.uniform(1, 2, (8, 64, 4)).astype(np.float32)
    picture, found = even.copy(), {}
    picture[:, :20, :3] = 0.1
    picture[:, 40:, :3] = 3  # not four times as bright
    light[:, :20, :3] /= 10
    for contrast in (0.0, 4.0):
        rules = FeatureFiltersModel(info("munet-x1", sharp_contrast=contrast).spec).rules
        before = Remembered(Accumulated(light, even, even), picture, 1.0)
        found[contrast] = warped(before, grid, motion, rules, Strips(1), Workspace()).accumulated
    factor = found[4.0].light[..., :3] / found[0.0].light[..., :3]
    places = np.flatnonzero(np.abs(factor[4, :, 0] - 1) > 1e-3)
    assert places.tolist() == [20]
    np.testing.assert_array_equal(found[4.0].albedo, found[0.0].albedo)
    np.testing.assert_array_equal(found[4.0].light[..., 3], found[0.0].light[..., 3])


def test_past_positions_are_those_of_the_picture():
    grid = Grid.of((4, 4), 2, 8, None)
    motion = np.zeros((4, 4, 2), np.float32)
    motion[..., 0], motion[3, 3] = 0.5, 100
    positions, inside = grid.past_positions(motion, slice(0, 8))
    np.testing.assert_allclose(positions[2, 3], [4, 2])
    assert not inside[0, 7]  # was a pixel to the right of the last
    assert not inside[7, 7]
    assert inside[2, 3]
    assert positions.max() <= 7


class Exact:
    """An engine that keeps a sample where it fell into a pixel, and filters nothing."""

    def __init__(self, spec):
        self.spec = spec

    def run(self, graph, inputs):
        planes = dict(zip(self.spec.network.features, inputs["features"][0], strict=True))
        height, width = planes["offset.x"].shape
        far = np.maximum(abs(planes["offset.x"]), abs(planes["offset.y"])) > 0.5
        y, x = np.indices((height, width))
        layout = target_layout(4, self.spec.decoder)
        finest = np.zeros((layout.planes, height, width), np.float32)
        for planes in (layout.light, layout.guides, layout.denoise):
            # features so far apart that a pixel sees itself alone
            finest[planes.features][:2] = 8.0 * (x % 3 - 1), 8.0 * (y % 3 - 1)
        finest[layout.keep] = np.where(far, 8.0, 0.0)  # keep the past where no sample fell
        finest[[layout.coarser, layout.compose.stop - 1, layout.output]] = -8
        blocks = finest.reshape(-1, height // 2, 2, width // 2, 2).transpose(0, 2, 4, 1, 3)
        outputs = [blocks.reshape(104, height // 2, width // 2)]
        for count, part in network_outputs(self.spec)[1:]:
            outputs.append(np.zeros((count, height // part, width // part), np.float32))
        return {str(index): np.ascontiguousarray(part) for index, part in enumerate(outputs)}

    def close(self):
        pass


def halton(index, base):
    value, fraction = 0.0, 1.0
    while index > 0:
        fraction /= base
        value += fraction * (index % base)
        index //= base
    return value - 0.5


def test_still_frames_become_the_picture_at_twice_the_size():
    def scene(x, y, height=1.0):  # detail that a frame's pixels are too large for
        return 1.5 + height * np.sin(2.1 * x) * np.cos(1.7 * y)

    y, x = np.indices((32, 48)) + 0.5
    # means over the pixels of the picture
    wanted = scene(x, y, np.sin(2.1 / 2) / (2.1 / 2) * np.sin(1.7 / 2) / (1.7 / 2))
    row, column = np.indices((16, 24)) + 0.5
    errors = []
    spec = load("munet-x2")
    with Denoiser(info("munet-x2"), threads=1, engine=Exact(spec)) as denoiser:
        for number in range(1, 49):
            jitter = np.array([halton(number, 2), halton(number, 3)])
            light = scene(2 * (column + jitter[0]), 2 * (row + jitter[1]))
            still = np.zeros((16, 24, 2))
            given = Frame(color=np.repeat(light[..., None], 3, -1), motion=still, jitter=jitter)
            errors.append(np.abs(denoiser.denoise(given)[..., 0] - wanted).mean())
    assert errors[-1] < 0.25 * errors[0]
    assert errors[-1] < 0.5 * errors[3]


def test_a_picture_goes_into_an_array_of_its_size(rng, denoiser):
    given = frame(rng)
    scale = denoiser.scale
    out = np.empty((7 * scale, 11 * scale, 3), np.float16)
    assert denoiser.denoise(given, out=out) is out
    if scale > 1:
        with pytest.raises(stillray.InputError, match="out must have shape"):
            denoiser.denoise(given, out=np.empty((7, 11, 3), np.float32))


def test_layers_are_refused(rng, denoiser):
    given = frame(rng)
    with pytest.raises(stillray.InputError, match="layers must be none with munet"):
        denoiser.denoise_layers(given, {"a": given.color})
