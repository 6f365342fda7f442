"""Recurrent training of models that denoise and upscale: network, patches, losses, the loop."""

from __future__ import annotations

import csv
import functools
import json
import time
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.errors import InputError  # noqa: E402
from stillray.families.feature_filters import FeatureFiltersModel  # noqa: E402
from stillray.frame import Frame  # noqa: E402
from stillray.io.exr.read import read_exr  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training import contact_sheets as sheets  # noqa: E402
from stillray_training.bright_windows import draw_window  # noqa: E402
from stillray_training.checkpoint import load_network  # noqa: E402
from stillray_training.fine_shapes import FINE  # noqa: E402
from stillray_training.heavy_tail import Tail  # noqa: E402
from stillray_training.loss_log import LOG  # noqa: E402
from stillray_training.machine import Batches, Machine  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.multi_branch import MultiBranchBlock, multi_branch_net  # noqa: E402
from stillray_training.networks.repvgg import by_branches  # noqa: E402
from stillray_training.simulate.sequence import RECORD, write  # noqa: E402
from stillray_training.upscaling import (  # noqa: E402
    agreement,
    clips,
    compare,
    contact_sheets,
    loop,
    price_list,
    tails,
    time_in_turn,
    unroll,
)
from stillray_training.upscaling.clip import load_clip, of_several_samples  # noqa: E402
from stillray_training.upscaling.clips import ClipSampler  # noqa: E402
from stillray_training.upscaling.price_list import Way, prices  # noqa: E402
from stillray_training.upscaling.time_in_turn import times_in_turn  # noqa: E402
from stillray_training.upscaling.windows import frame_behind_bars, through_window  # noqa: E402


def small(name="munet-x2", **recipe):
    """The model with a narrow network and a short recipe."""
    spec = load(name)
    network = replace(spec.network, radiance_widths=(8, 8), guide_widths=(4, 4))
    # channels this few are no kernels to Muon; what the recipe that shipped last says has no part
    defaults = {
        "steps": 40, "batch": 2, "patch": 16, "frames": 3, "optimiser": "adam",
        "learning_rate": 4e-2, "warm_frames": 0, "average": 0.0, "shade_share": 0.0,
        "firefly_share": 0.0, "paint_share": 0.0, "fresh_share": 0.0, "mean_share": 0.0,
        "plain_share": 0.0, "seed": 131,
    }  # fmt: skip
    training = replace(spec.training, **{**defaults, **recipe})
    return replace(spec, network=network, training=training)


def render(folder, frames=4, size=(10, 12), scale=2):
    """A textured plane that slides by half a pixel a frame under noisy light."""
    rng = np.random.default_rng(5)
    folder.mkdir(parents=True)
    jitters = rng.uniform(-0.5, 0.5, (frames, 2))

    def surface(x, y):
        waves = [np.sin(0.9 * x + phase) * np.cos(0.7 * y) for phase in (0.0, 1.0, 2.0)]
        return (0.5 + 0.4 * np.stack(waves, -1)).astype(np.float32)

    for number in range(frames):
        y, x = np.indices(size) + 0.5
        x, y = x + jitters[number, 0] + 0.5 * number, y + jitters[number, 1]
        albedo = surface(x, y)
        noise = rng.exponential(1.0, (*size, 1))
        flat = np.ones(size, np.float32)
        motion = np.stack([0.5 * flat, 0 * flat], -1)
        features = {
            "albedo": albedo, "normal": np.stack([0 * flat, 0 * flat, flat], -1),
            "depth": 3 * flat, "motion": motion, "roughness": flat, "specular_albedo": 0 * albedo,
        }  # fmt: skip
        write(folder / f"frame_{number:04d}.exr", {"color": albedo * noise, **features})
        y, x = (np.indices((size[0] * scale, size[1] * scale)) + 0.5) / scale
        wanted = surface(x + 0.5 * number, y)
        write(
            folder / f"ref_{number:04d}.exr",
            {"color": wanted, "albedo": wanted, "specular_albedo": 0 * wanted},
        )
    record = {"options": {"spp": 1}, "cameras": [{"jitter": list(j)} for j in jitters]}
    (folder / RECORD).write_text(json.dumps(record))
    return folder


def test_the_network_has_the_paper_s_size_and_fuses():
    torch.manual_seed(0)
    for name in ("munet-x2", "munet-x1"):
        weights = sum(part.numel() for part in fuse(multi_branch_net(load(name))).parameters())
        assert 0.6e6 < weights < 0.7e6
    spec = small()
    network = multi_branch_net(spec).double()
    planes = torch.randn(1, len(spec.network.features), 8, 12, dtype=torch.float64)
    with by_branches(network):
        for one, other in zip(fuse(network)(planes), network(planes), strict=True):
            torch.testing.assert_close(one, other)


def test_partial_convolutions_leave_half_of_the_channels_as_they_are():
    spec = load("munet-x2")
    block = MultiBranchBlock(8, 4, spec.network, partial=True)
    light, guides = torch.randn(1, 8, 5, 5), torch.randn(1, 4, 5, 5)
    rest = block.residual(light)[:, 4:]
    torch.testing.assert_close(rest, light[:, 4:])
    whole = MultiBranchBlock(8, 4, spec.network, partial=False)
    weights = [sum(p.numel() for p in made.parameters()) for made in (block, whole)]
    assert weights[0] < 0.5 * weights[1]
    # guides multiply what is added: where they say nothing, light passes
    with torch.no_grad():
        block.merge.weight.zero_()
        block.merge.bias.zero_()
    torch.testing.assert_close(block(light, guides)[0], light.relu())


@pytest.mark.parametrize("name", ["munet-x2", "munet-x1"])
def test_patches_show_the_same_in_frame_and_reference(tmp_path, name):
    spec = small(name, frames=4, drop_feature=0.0)
    scale = spec.decoder.scale
    clip = load_clip(render(tmp_path / "plane-0-0", scale=scale), spec, Strips(1))
    sampler = ClipSampler([clip], small(name, patch=8 * scale, frames=4, drop_feature=0.0))
    for step in range(6):  # turned and mirrored otherwise every time
        batch = sampler.batch(step)
        assert len(batch) == 4
        before = None
        for sample in batch:
            assert sample["color"].shape == (2, 3, 8 * scale, 8 * scale)
            # the sample next to a pixel, one or two of which lie half a frame's pixel away
            apart = np.abs(sample["albedo"] - sample["wanted_albedo"]).mean()
            assert apart < 0.2
            if before is not None:
                # warped by motion, the last reference is this one
                last = torch.from_numpy(before["wanted_albedo"])
                moved = unroll.warped(last, torch.from_numpy(sample["positions"])).numpy()
                inside = sample["inside"][:, :, 2:-2, 2:-2] > 0
                error = np.abs(moved - sample["wanted_albedo"])[..., 2:-2, 2:-2] * inside
                assert error.max() < 0.05
            before = sample


def without_and_with(folder, name, share):
    """Samplers of one clip, of patches none or all of which have what a recipe gives a share of."""
    recipe = {"frames": 4, "drop_feature": 0.0, "plain_share": 0.0, "batch": 1}
    scale = load(name).decoder.scale
    clip = load_clip(render(folder / "plane-0-0", scale=scale), small(name), Strips(1))
    return (
        ClipSampler([clip], small(name, patch=8 * scale, **recipe, **{share: given}))
        for given in (0.0, 1.0)
    )


@pytest.mark.parametrize("name", ["munet-x2", "munet-x1"])
def test_light_that_changes_changes_in_frame_and_reference(tmp_path, name):
    steady, shaded = without_and_with(tmp_path, name, "shade_share")
    seen = []
    for step in range(12):
        for before, after in zip(steady.batch(step), shaded.batch(step), strict=True):
            factor = after["wanted"] / before["wanted"]
            np.testing.assert_allclose(after["color"], factor * before["color"], rtol=1e-5)
            np.testing.assert_array_equal(after["albedo"], before["albedo"])
            np.testing.assert_array_equal(after["wanted_albedo"], before["wanted_albedo"])
            seen.append(factor)
    assert 0.09 < np.min(seen) < 0.6
    assert 1.5 < np.max(seen) < 11
    # from frame to frame of a patch
    changes = np.abs(np.diff(np.log(np.stack(seen).reshape(12, 4, -1)), axis=1)).max(axis=(1, 2))
    assert (changes > 0.05).mean() > 0.7


@pytest.mark.parametrize("name", ["munet-x2", "munet-x1"])
def test_paint_is_in_albedo_and_light_of_frame_and_reference_unless_black(tmp_path, name):
    plain, painted = without_and_with(tmp_path, name, "paint_share")
    changed, black = 0, 0
    for step in range(24):
        factors = []
        for before, after in zip(plain.batch(step), painted.batch(step), strict=True):
            factor = after["wanted_albedo"] / before["wanted_albedo"]
            assert 0 <= factor.min() <= factor.max() <= 1
            light = 1.0 if (factor == 0).any() else factor
            for key in ("color", "wanted"):
                np.testing.assert_allclose(after[key], light * before[key], rtol=1e-5)
            for key in ("albedo", "specular", "wanted_specular"):
                np.testing.assert_allclose(after[key], factor * before[key], rtol=1e-5)
            np.testing.assert_array_equal(after["normal"], before["normal"])
            factors.append(factor)
        black += bool(np.min(factors) == 0)
        changed += bool(np.ptp(np.stack(factors), axis=0).max() > 0.05)
    assert black >= 1
    assert changed >= 6


def test_fireflies_come_to_frames_and_not_to_references(tmp_path):
    clip = load_clip(render(tmp_path / "plane-0-0"), small(), Strips(1))
    recipe = {"frames": 4, "drop_feature": 0.0, "patch": 16, "batch": 4}
    plain, lit = (ClipSampler([clip], small(firefly_share=share, **recipe)) for share in (0.0, 1.0))
    brighter, frames_lit = [], set()
    for step in range(40):
        lit_ones = []
        for before, after in zip(plain.batch(step), lit.batch(step), strict=True):
            changed = after["color"].max(1) > 4 * before["color"].max()
            brighter.append(changed.mean())
            lit_ones.append(changed.any(axis=(1, 2)))
            # the first patch is the same, but for them
            np.testing.assert_array_equal(after["wanted"][0], before["wanted"][0])
            np.testing.assert_array_equal(after["albedo"][0], before["albedo"][0])
        frames_lit.update(np.sum(lit_ones, axis=0).tolist())
    assert 0.001 < np.mean(brighter) < 0.1
    # some shine once, some in every frame in a row
    assert {0, 1, 4} <= frames_lit


def test_what_cannot_be_learned_from_is_refused(tmp_path):
    folder = render(tmp_path / "plane-0-0", frames=2)
    spec = small(frames=3)
    with pytest.raises(InputError, match="must have 3 frames of 8 pixels each way, got 2 of 10"):
        ClipSampler([load_clip(folder, spec, Strips(1))], spec)
    (folder / "ref_0001.exr").unlink()
    with pytest.raises(InputError, match="the last frame must have a reference"):
        load_clip(folder, spec, Strips(1))
    with pytest.raises(InputError, match="must have motion, depth, albedo, normal"):
        load_clip(without(folder, "depth"), spec, Strips(1))
    folder = without(render(tmp_path / "plane-1-0"), "albedo", of="ref")
    with pytest.raises(InputError, match=r"must have albedo and the size \(20, 24\) or a multiple"):
        load_clip(folder, spec, Strips(1))


def without(folder, *names, of="frame"):
    """A folder whose files no longer have some layers."""
    for path in folder.glob(f"{of}_*.exr"):
        image = read_exr(path)
        kept = {name: getattr(image, name) for name in image.given - {*names, "jitter"}}
        write(path, kept)
    return folder


def unreferenced(folder, frames=4):
    """A sequence as other models learn from it: the last frame alone has a reference."""
    render(folder, frames=frames, size=(20, 24), scale=1)
    for number in range(frames - 1):
        (folder / f"ref_{number:04d}.exr").unlink()
    without(folder, "roughness", "specular_albedo")
    without(folder, "specular_albedo", of="ref")
    record = {"options": {"spp": 1}, "seed": 3}
    (folder / RECORD).write_text(json.dumps(record))
    return folder


def test_sequences_with_one_reference_and_few_guides_are_learned_from(tmp_path):
    spec = small("munet-x1", frames=3, batch=1, drop_feature=0.0)
    clip = load_clip(unreferenced(tmp_path / "plane-0-0"), spec, Strips(1))
    assert [reference is None for reference in clip.references] == [True, True, True, False]
    assert not clip.still
    for frame in clip.frames:
        assert not frame.roughness.any()
        assert not frame.specular_albedo.any()
        assert not frame.jitter.any()
    sampler = ClipSampler([clip], spec)
    for step in range(5):  # the last frame is that with the reference, wherever patches lie
        batch = sampler.batch(step)
        assert [float(sample["known"].item()) for sample in batch] == [0, 0, 1]
        assert batch[2]["wanted"].any()
    # the others are learned from as what the last remembers, whatever their wanted pictures say
    network = multi_branch_net(spec)
    loss = loop.sequence_loss(network, batch, spec)
    told = [{**sample} for sample in batch]
    for sample in told[:2]:
        sample["wanted"], sample["wanted_albedo"] = sample["color"], sample["albedo"]
    torch.testing.assert_close(loop.sequence_loss(network, told, spec), loss)
    rules, names = FeatureFiltersModel(spec).rules, spec.network.features
    before = None
    for sample in batch:
        frame = {name: torch.from_numpy(array) for name, array in sample.items()}
        image, before, _ = unroll.step(network, frame, before, names, rules)
    alone = loop.frame_loss(image, before, frame, spec.training)
    torch.testing.assert_close(loss, alone.mean())
    batch[0]["color"] *= 2
    assert not torch.isclose(loop.sequence_loss(network, batch, spec), loss)


def test_a_perfect_recurrence_has_no_loss_and_a_flickering_one_has(tmp_path):
    spec = small(frames=3)
    batch = ClipSampler([load_clip(render(tmp_path / "plane-0-0"), spec, Strips(1))], spec).batch(0)
    frame = {name: torch.from_numpy(array) for name, array in batch[1].items()}
    wanted, was = frame["wanted"], 0.9 * frame["wanted"]
    same = loop.temporal_loss((wanted, was), (wanted, was), frame)
    torch.testing.assert_close(same, torch.zeros(2))
    flicker = loop.temporal_loss((1.2 * wanted, was), (wanted, was), frame)
    assert (flicker > 0.01).all()


def test_frames_before_those_that_are_learned_from_make_their_past(tmp_path):
    clip = [load_clip(render(tmp_path / "plane-0-0", frames=6), small(), Strips(1))]
    spec = small(frames=2, warm_frames=4)
    sampler = ClipSampler(clip, spec)
    batches = [sampler.batch(step) for step in range(30)]
    assert {len(batch) for batch in batches} == {2, 3, 4, 5, 6}
    network = multi_branch_net(spec)
    batch = max(batches, key=len)
    loss = loop.sequence_loss(network, batch, spec)
    # the same as of the two last frames after the others, and not as of them alone
    whole = replace(spec, training=replace(spec.training, frames=6))
    assert not torch.isclose(loss, loop.sequence_loss(network, batch[-2:], spec))
    assert not torch.isclose(loss, loop.sequence_loss(network, batch, whole))
    (gradient,) = torch.autograd.grad(loss, network.heads[0].bias)
    assert gradient.abs().max() > 0
    with pytest.raises(InputError, match="must have 7 frames"):
        ClipSampler(clip, small(frames=2, warm_frames=5))


def test_a_long_past_is_that_of_the_sequences_that_have_one(tmp_path):
    short, long = (
        load_clip(render(tmp_path / f"{name}-0-0", frames=count), small(), Strips(1))
        for name, count in (("short", 3), ("long", 9))
    )
    for reference in long.references:
        reference.color[:] = 7.0
    sampler = ClipSampler([short, long], small(frames=2, warm_frames=7, batch=2))
    counts = []
    for step in range(80):
        batch = sampler.batch(step)
        counts.append(len(batch))
        of_long = batch[-1]["wanted"].min(axis=(1, 2, 3)) > 2
        assert of_long.all() or len(batch) <= 3
    assert set(counts) == set(range(2, 10))
    assert 0.4 < np.mean([count <= 3 for count in counts]) < 0.8  # half are of the short one


def test_a_share_of_batches_begins_without_a_past(tmp_path):
    clip = [load_clip(render(tmp_path / "plane-0-0", frames=9), small(), Strips(1))]
    counts = {}
    for share in (0.0, 0.5, 1.0):
        spec = small(frames=2, warm_frames=7, fresh_share=share)
        sampler = ClipSampler(clip, spec)
        counts[share] = [len(sampler.batch(step)) for step in range(60)]
    assert set(counts[0.0]) == set(counts[0.5]) == set(range(2, 10))
    assert counts[0.0].count(2) < 20 < counts[0.5].count(2) < 45
    assert set(counts[1.0]) == {2}


def still_clip(folder, frames=24):
    """A clip of one view, as its frames would be that nothing moves in."""
    render(folder, frames=1)
    clip = load_clip(folder, small(), Strips(1))
    rng = np.random.default_rng(3)
    seen = [
        replace(
            clip.frames[0],
            color=clip.references[0].color[::2, ::2] * rng.exponential(1.0, (10, 12, 1)),
            jitter=rng.uniform(-0.5, 0.5, 2).astype(np.float32),
        )
        for _ in range(frames)
    ]
    every = {name: getattr(clip, name) * frames for name in ("references", "exposures")}
    return replace(clip, frames=seen, depth_units=clip.depth_units * frames, still=True, **every)


def test_frames_of_several_samples_have_less_noise_and_no_jitter(tmp_path):
    clip = still_clip(tmp_path / "still-0-0")
    box = cv2.resize(clip.references[0].color, (12, 10), interpolation=cv2.INTER_AREA)
    own = np.mean([np.abs(frame.color - box).mean() for frame in clip.frames])
    noises = []
    for seed in range(40):
        made = of_several_samples(clip, 3, np.random.default_rng(seed))
        assert len(made.frames) == len(made.references) == len(made.exposures) == 3
        assert not any(frame.jitter.any() for frame in made.frames)
        errors = [frame.color - box for frame in made.frames]
        noises.append(np.mean(np.abs(errors)) / own)
        # frames share no sample
        assert abs(np.corrcoef(errors[0].ravel(), errors[1].ravel())[0, 1]) < 0.4
    assert min(noises) < 0.1
    assert 0.3 < np.median(noises) < 0.9
    assert max(noises) <= 1.1


def test_frames_are_of_several_samples_in_a_share_of_still_patches(tmp_path):
    clip = still_clip(tmp_path / "still-0-0")
    recipe = {"frames": 3, "batch": 1, "plain_share": 0.0}
    for share, still, expected in ((0.0, True, 0), (1.0, True, 10), (1.0, False, 0)):
        sampler = ClipSampler([replace(clip, still=still)], small(mean_share=share, **recipe))
        batches = [sampler.batch(step) for step in range(10)]
        # where jitter is zero, samples lie a quarter of a frame's pixel away
        without = [
            np.allclose(np.abs(b["offset"]), np.abs(b["offset"]).max()) for (b, *_) in batches
        ]
        assert sum(without) == expected


def test_a_frame_meets_a_window_where_its_samples_lie(tmp_path):
    frame = still_clip(tmp_path / "still-0-0", frames=1).frames[0]
    depth = np.full((20, 24), 3.0, np.float32)
    for seed in range(8):
        window = draw_window(depth[..., None], depth, None, np.random.default_rng(seed))
        seen = frame_behind_bars(frame, window, 2)
        x, y = frame.jitter
        for row, column in np.ndindex(10, 12):
            at = int((row + 0.5 + y) * 2 * FINE), int((column + 0.5 + x) * 2 * FINE)
            dimmed = window.light[2 * row : 2 * row + 2, 2 * column : 2 * column + 2].mean()
            pixel = (row, column)
            if window.opening[at]:
                np.testing.assert_array_equal(seen.color[pixel], window.lamp.radiance)
                np.testing.assert_array_equal(seen.albedo[pixel], window.lamp.albedo)
                assert seen.depth[pixel] == np.float32(window.lamp.distance)
                assert not seen.specular_albedo[pixel].any()
            else:
                np.testing.assert_allclose(seen.color[pixel], frame.color[pixel] * dimmed, 1e-5)
                np.testing.assert_array_equal(seen.normal[pixel], frame.normal[pixel])


def test_many_frames_behind_bars_are_their_reference(tmp_path):
    clip = still_clip(tmp_path / "still-0-0", frames=1)
    spec = small()
    spec = replace(spec, temporal=replace(spec.temporal, outlier_ratio=1e9))  # nothing bounded
    flat = replace(clip.references[0], color=np.ones((20, 24, 3), np.float32))
    lit = replace(clip.frames[0], color=np.ones((10, 12, 3), np.float32))
    steps = (np.arange(16) + 0.5) / 16 - 0.5
    jitters = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2).astype(np.float32)
    frames = [replace(lit, jitter=jitter) for jitter in jitters]
    many = replace(clip, frames=frames, references=[flat] * len(frames))
    for seed in range(4):
        made = through_window(many, spec, np.random.default_rng(seed))
        assert len(made.exposures) == len(made.depth_units) == len(made.references) == 256
        assert made.references[-1].color.max() > 2
        mean = np.mean([frame.color for frame in made.frames], axis=0)
        wanted = cv2.resize(made.references[-1].color, (12, 10), interpolation=cv2.INTER_AREA)
        np.testing.assert_allclose(mean, wanted, rtol=0.05)


def test_windows_are_painted_into_a_share_of_still_patches(tmp_path):
    clip = still_clip(tmp_path / "still-0-0")
    recipe = {"frames": 3, "batch": 1}
    plain = ClipSampler([clip], small(**recipe)).batch(0)
    for share, still, expected in ((0.0, True, 0), (1.0, True, 10), (1.0, False, 0)):
        sampler = ClipSampler([replace(clip, still=still)], small(window_share=share, **recipe))
        brightest = [sampler.batch(step)[0]["wanted"].max() for step in range(10)]
        lit = sum(light > 2 * plain[0]["wanted"].max() for light in brightest)
        assert lit >= 0.5 * expected if expected else lit == 0


@pytest.mark.parametrize("samples", [1, 16])
def test_many_frames_with_a_tail_are_their_reference(tmp_path, monkeypatch, samples):
    clip = still_clip(tmp_path / "still-0-0", frames=1)
    most = 30.0  # so short a tail that means settle
    often = np.full((10, 12), 0.05, np.float32)
    light = np.zeros((10, 12, 3), np.float32)  # of no account: it is the albedo's
    monkeypatch.setattr(tails, "draw_tail", lambda _, rng: Tail(often, light, most))
    monkeypatch.setattr(tails, "SAMPLES", (samples, samples * (1 + 1e-9)))
    spec = small()
    spec = replace(spec, temporal=replace(spec.temporal, outlier_ratio=1e9))  # nothing bounded
    albedo = np.linspace(0.2, 0.8, 10 * 12 * 3, dtype=np.float32).reshape(10, 12, 3)
    first = replace(clip.frames[0], color=np.full((10, 12, 3), 0.5, np.float32), albedo=albedo)
    large = np.repeat(np.repeat(albedo, 2, 0), 2, 1)
    whole = replace(clip.references[0], color=np.full((20, 24, 3), 0.5, np.float32), albedo=large)
    frames, references = [first] * 4096, [None, *[whole] * 4095]
    made = tails.with_tail(
        replace(clip, frames=frames, references=references), spec, np.random.default_rng(5)
    )
    assert made.references[0] is None
    added = 0.05 * np.log(most / 3) * 0.5
    np.testing.assert_allclose(made.references[-1].color, 0.5 + added * large, rtol=1e-5)
    total = np.mean([frame.color for frame in made.frames], axis=0) - first.color
    assert total.sum() == pytest.approx((added * albedo).sum(), rel=0.03)
    lit = np.mean([(frame.color != first.color).any(-1) for frame in made.frames])
    assert lit == pytest.approx(1 - np.exp(-0.05 * samples * (1 / 3 - 1 / most)), rel=0.05)


def test_tails_are_painted_into_a_share_of_patches(tmp_path, monkeypatch):
    clip = load_clip(render(tmp_path / "plane-0-0", frames=4), small(), Strips(1))
    bright = [replace(frame, color=frame.color + 1000) for frame in clip.frames]
    monkeypatch.setattr(clips, "with_tail", lambda clip, *_: replace(clip, frames=bright))
    counts = []
    for share in (0.0, 0.5, 1.0):
        sampler = ClipSampler([clip], small(frames=3, batch=1, tail_share=share))
        counts.append(sum(sampler.batch(step)[0]["shown"].min() > 300 for step in range(16)))
    assert counts[0] == 0
    assert 2 < counts[1] < 14
    assert counts[2] == 16


def test_where_nothing_moves_one_reference_is_enough(tmp_path):
    folder = render(tmp_path / "still-0-0", frames=3)
    for number in range(2):
        (folder / f"ref_{number:04d}.exr").unlink()
    record = json.loads((folder / RECORD).read_text())
    still = [{**camera, "camera_to_world": [[1, 0], [0, 1]]} for camera in record["cameras"]]
    moved = [*still[:2], {**still[2], "camera_to_world": [[1, 1], [0, 1]]}]
    (folder / RECORD).write_text(json.dumps({**record, "moving": [], "cameras": still}))
    clip = load_clip(folder, small(), Strips(1))
    last = load_clip(render(tmp_path / "whole-0-0", frames=3), small(), Strips(1)).references[2]
    for reference in clip.references:
        np.testing.assert_array_equal(reference.color, last.color)
    assert clip.still
    for changed in ({"moving": [], "cameras": moved}, {"moving": ["lamp"], "cameras": still}):
        (folder / RECORD).write_text(json.dumps({**record, **changed}))
        found = load_clip(folder, small(), Strips(1))
        assert found.references[:2] == [None, None]
        assert not found.still
    # frames whose samples all lie alike are not those of one sample a pixel that others are made of
    alike = [{**camera, "jitter": [0, 0]} for camera in still]
    (folder / RECORD).write_text(json.dumps({**record, "moving": [], "cameras": alike}))
    found = load_clip(folder, small(), Strips(1))
    assert not found.still
    np.testing.assert_array_equal(found.references[0].color, last.color)


def test_training_learns_and_resumes(tmp_path):
    render(tmp_path / "data" / "plane-0-0")
    spec = small()
    out = tmp_path / "run"
    loop.train_recurrent(
        replace(spec, training=replace(spec.training, steps=10)), [tmp_path / "data"], out
    )
    trained = loop.train_recurrent(spec, [tmp_path / "data"], out)
    with (out / LOG).open() as file:
        assert [int(row["step"]) for row in csv.DictReader(file)] == [20, 40]
    torch.manual_seed(spec.training.seed)
    untrained = multi_branch_net(spec)
    clips = [load_clip(tmp_path / "data" / "plane-0-0", spec, Strips(1))]
    batch = ClipSampler(clips, spec).batch(1000)
    with torch.no_grad():
        losses = [
            float(loop.sequence_loss(network, batch, spec)) for network in (untrained, trained)
        ]
    assert losses[1] < 0.8 * losses[0]
    loaded, step = load_network(spec, out / "checkpoint.safetensors")
    assert step == 40
    for one, other in zip(loaded.parameters(), trained.parameters(), strict=True):
        torch.testing.assert_close(one, other)


def test_gradients_reach_every_weight_through_the_past(tmp_path):
    spec = small(frames=2)
    network = multi_branch_net(spec)
    batch = ClipSampler([load_clip(render(tmp_path / "plane-0-0"), spec, Strips(1))], spec).batch(0)
    loop.sequence_loss(network, batch, spec).backward()
    for name, parameter in network.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.isfinite().all(), name
    # the second picture alone depends on what the first accumulated
    frames = [{k: torch.from_numpy(v) for k, v in sample.items()} for sample in batch]
    frames[0]["color"].requires_grad_()
    rules, names = FeatureFiltersModel(spec).rules, spec.network.features
    _, before, _ = unroll.step(network, frames[0], None, names, rules)
    image, _, _ = unroll.step(network, frames[1], before, names, rules)
    (gradient,) = torch.autograd.grad(image.sum(), frames[0]["color"])
    assert gradient.abs().max() > 0


def test_batches_of_trainings_begin_anew_where_light_disagrees(tmp_path, monkeypatch):
    """The left half of every frame disagrees with its past: no gradient comes from there."""
    spec = small(frames=2, batch=1)
    clip = load_clip(render(tmp_path / "plane-0-0"), spec, Strips(1))
    batch = Batches(ClipSampler([clip], spec).batch, 1, Machine())(0)

    def disagreeing(light, shown, scale, motion, noise, strips):
        share = np.ones(shown.color.shape[:2], np.float32)
        share[:, : share.shape[1] // 2] = 0
        return share, noise

    monkeypatch.setattr(agreement, "agreement", disagreeing)
    network, names = multi_branch_net(spec), spec.network.features
    rules = FeatureFiltersModel(spec).rules
    _, before, _ = unroll.step(network, batch[0], None, names, rules)
    _, after, recalled = unroll.step(network, batch[1], before, names, rules)
    columns = batch[1]["columns"][0]
    left = columns < (int(columns.max()) + 1) // 2
    first, later = (remembered.light[:, 3] for remembered in (before, after))
    torch.testing.assert_close(later[..., left], first[..., left])
    assert (later[..., ~left] > first[..., ~left]).any()
    assert recalled[..., left].abs().max() == 0
    assert recalled[..., ~left].abs().max() > 0


def test_methods_are_timed_in_turn_and_the_first_round_is_left_out():
    seen = []
    methods = {name: lambda turn, name=name: seen.append((turn, name)) for name in "ab"}
    times = times_in_turn(methods, 0.0)
    assert seen == [(turn, name) for turn in range(4) for name in "ab"]
    assert {name: len(values) for name, values in times.items()} == {"a": 3, "b": 3}


def test_ratios_are_medians_over_the_rounds():
    times = {"ours": [10.0, 40.0, 100.0], "peer": [20.0, 40.0, 400.0]}
    _, _, ours, peer = time_in_turn.table(times, ["peer"])
    assert ours == "| ours | 40 | 0.50 |"  # the medians' ratio would be 1
    assert peer == "| peer | 40 | 1.00 |"


def test_times_and_rooflines_go_into_a_report(tmp_path):
    report = tmp_path / "times.md"
    frames = str(Path(__file__).parents[1] / "data" / "room" / "frame_####.exr")
    time_in_turn.main(frames, frames, "munet-x2", height=48, width=64, seconds=0.0, report=report)
    text = report.read_text()
    for row in ("| munet-x2 |", "| kpyr-5 |", "| OIDN fast |"):
        assert row in text
    network = next(line for line in text.splitlines() if line.startswith("| network |"))
    milliseconds, roofline, ratio = map(float, network.split("|")[2:5])
    assert ratio == pytest.approx(milliseconds / roofline, rel=0.5)
    assert "munet-x2 is given 32x24 pixels" in text
    assert "Peak memory" in text
    with pytest.raises(InputError, match="must be multiples of 2, got 47x64"):
        time_in_turn.main(frames, frames, "munet-x2", height=47, width=64)


def test_a_price_is_of_the_way_that_made_the_picture():
    truth = [np.full((16, 20, 3), 0.25 + 0.05 * index, np.float32) for index in range(4)]
    seen = []

    def slow(frame):
        seen.append("slow")
        time.sleep(0.02 if len(seen) > 2 else 0.2)  # the first frame allocates, and is left out
        return frame.color

    ways = [
        Way(label="right", frames=[Frame(color=image) for image in truth], denoise=slow),
        Way(
            label="dark",
            frames=[Frame(color=image) for image in truth],
            denoise=lambda frame: seen.append("dark") or frame.color / 2,
        ),
    ]
    found = prices(ways, [7.0, 3.0], truth[-2:])
    assert seen == ["slow", "dark"] * 4
    assert [price.render for price in found.values()] == [7.0, 3.0]
    assert 20 <= found["right"].denoise < 150
    assert found["dark"].denoise < found["right"].denoise
    assert found["right"].scores["smape"] < 1e-6 < 0.3 < found["dark"].scores["smape"]


def test_renders_without_recorded_cameras_have_no_price(tmp_path):
    folder = render(tmp_path / "scene-0")
    record = {"scene": "scene", "options": {"frames": 4, "height": 10, "width": 12}}
    (folder / RECORD).write_text(json.dumps(record))
    with pytest.raises(InputError, match="must have recorded cameras"):
        price_list.read_record(folder)


def test_the_last_pictures_are_shown_at_the_references_size(tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "open_image_denoise", lambda color, *_: color)
    sequence = render(tmp_path / "plane-0-0")
    found = compare.measure(sequence, "munet-x2", "kpyr-5s", pictures=tmp_path / "seen")
    assert set(found) == {"munet-x2", "kpyr-5s + Lanczos", "oidn-high + Lanczos"}
    names = {path.stem.removeprefix("plane-0-0-") for path in (tmp_path / "seen").iterdir()}
    methods = {"munet-x2", "kpyr-5s-Lanczos", "oidn-high-Lanczos"}
    assert names == {"noisy", *methods, "reference"}
    shapes = {cv2.imread(str(path)).shape for path in (tmp_path / "seen").iterdir()}
    assert shapes == {(20, 24, 3)}


def test_contact_sheets_show_every_method_of_the_scenes_that_have_crops(tmp_path, monkeypatch):
    monkeypatch.setattr(compare, "open_image_denoise", lambda color, *_: color)
    folder = render(tmp_path / "data" / "plane-0-0")
    (folder / RECORD).write_text(json.dumps({"scene": "plane"}))
    crops = tmp_path / "crops.toml"
    begin = "side = 8\nenlargement = 2\n"
    sheet = '[[sheets]]\nfile = "{0}"\nset = "sequences"\ncase = "{0}"\n'
    sheet += 'crops = [{{ what = "a corner", x = 16, y = 12 }}]\n'
    crops.write_text(begin + sheet.format("plane") + sheet.format("elsewhere"))
    out = tmp_path / "sheets"
    show = functools.partial(contact_sheets.main, model="munet-x2", flagship="kpyr-5s", out=out)
    show(tmp_path / "data", crops=crops)
    assert [path.name for path in out.iterdir()] == ["plane-x2.png"]
    # noisy, three methods, the reference
    height, width, _ = cv2.imread(str(out / "plane-x2.png")).shape
    step = 8 * 2 + sheets.GAP
    assert (height, width) == (sheets.TOP + 5 * step, sheets.LEFT + step)
    crops.write_text(begin + sheet.format("elsewhere"))
    with pytest.raises(InputError, match=r"data must hold scenes that .*crops\.toml has crops of"):
        show(tmp_path / "data", crops=crops)
