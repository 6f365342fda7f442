"""A rendered sequence as it is learned from: some have lamps, windows or shadows painted in."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stillray.errors import InputError
from stillray.frame import Frame
from stillray.model_spec.training import Training
from stillray_training.blocks import frames_of, mean_frame, read_blocks
from stillray_training.bright_windows import draw_window, frame_through, reference_through
from stillray_training.defocus import (
    draw_opening,
    frame_through_lens,
    lens_before,
    reference_through_lens,
    sample_through_lens,
)
from stillray_training.fine_textures import draw_texture
from stillray_training.glints import draw_glints, glinting_frame, glinting_reference
from stillray_training.heavy_tail import draw_tail, frame_with, reference_with
from stillray_training.leaves import draw_leaves
from stillray_training.met_textures import MetTexture
from stillray_training.mixed_materials import draw_mixtures, mixed_frame, mixed_reference
from stillray_training.pages import draw_page
from stillray_training.ripples import draw_ripples
from stillray_training.sheen import draw_sheen, shining_frame, shining_reference
from stillray_training.small_lamps import draw_lamps, lit_frame, lit_reference
from stillray_training.targets import read_albedo_target, read_filter, read_target
from stillray_training.thin_shadows import draw_shadow, in_shadow, reference_in_shadow
from stillray_training.thinned import draw_kept, thinned

# share of painted albedos that have no noise, as renderers give them that look once
_NOISELESS = 0.35


@dataclass(frozen=True, kw_only=True, eq=False)
class Rendered:
    """What was rendered of a sequence.

    Attributes
    ----------
    frames
        All, in order.
    blocks
        The last and, where they were asked for, its further blocks, each with its samples a pixel.
    reference : (h, w, 3) float32
        What the last is to become.
    spp
        Samples a pixel of a frame.
    spread
        Standard deviation of the pixel filter, in pixels; None where it is not known.
    """

    frames: list[Frame]
    blocks: list[tuple[Frame, float]]
    reference: np.ndarray
    spp: float
    spread: float | None

    @property
    def depth(self) -> np.ndarray:
        """Of the last frame, ``(h, w)``."""
        depth = self.frames[-1].depth
        assert depth is not None
        return depth


def numbered(draw: int) -> tuple[int, ...]:
    """What of a drawing's number goes into seeds: nothing of the first one's."""
    return (draw,) if draw else ()


def read_rendered(
    sequence: Path, recipe: Training, *, with_blocks: bool = True, draw: int = 0
) -> Rendered:
    """Read a sequence, and paint into it what a recipe asks for in some share of sequences.

    The same sequence, seed and drawing give the same ones every time, with further blocks and
    without.

    Raises
    ------
    InputError
        It lacks its frames or its reference.
    """
    frames = frames_of(sequence)
    if not frames:
        raise InputError(f"{sequence}: must hold frames, frame_0000.exr and on")
    reference, spp = read_target(sequence)
    blocks = read_blocks(sequence, frames[-1], spp) if with_blocks else [(frames[-1], spp)]
    rendered = Rendered(
        frames=frames, blocks=blocks, reference=reference, spp=spp, spread=read_filter(sequence)
    )
    if recipe.layer == "albedo":
        rendered = _of_albedo(rendered, read_albedo_target(sequence))
    # drawn by themselves: whatever the share of windows, a sequence has the same lamps
    name = zlib.crc32(sequence.name.encode())
    for own, share, paint in (
        (5, recipe.thin_share, _thinned),
        (4, recipe.tail_share, _with_tail),
        (11, recipe.sheen_share, _with_sheen),
        (3, recipe.shadow_share, _with_shadow),
        (2, recipe.window_share, _with_window),
        (1, recipe.lamp_share, _with_lamps),
        (9, recipe.glint_share, _with_glints),
        (13, recipe.ripple_share, _with_ripples),
        (7, recipe.texture_share, _with_texture),
        (10, recipe.leaf_share, _with_leaves),
        (12, recipe.page_share, _with_page),
        (8, recipe.mixture_share, _with_mixtures),
        (6, recipe.defocus_share, _through_lens),
    ):
        rng = np.random.default_rng([recipe.seed, name, own, *numbered(draw)])
        if rng.random() < share:
            rendered = paint(rendered, rng)
    return rendered


def _of_albedo(rendered: Rendered, target: np.ndarray | None) -> Rendered:
    """A sequence of the frames' albedos, to learn to denoise those; without targets of their own
    they become the mean of all samples."""
    blocks = [(albedo_frame(frame), count) for frame, count in rendered.blocks]
    return replace(
        rendered,
        frames=[albedo_frame(frame) for frame in rendered.frames],
        blocks=blocks,
        reference=mean_frame(blocks).color if target is None else target,
    )


def albedo_frame(frame: Frame) -> Frame:
    """A frame whose albedo is what is denoised."""
    assert frame.albedo is not None
    return replace(frame, color=np.clip(frame.albedo, 0, 1), albedo=None)


def _thinned(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    kept = draw_kept(rendered.reference, rng)
    return _painted(
        rendered,
        rendered.reference,
        lambda frame, samples: thinned(frame, kept, samples, rng),
    )


def _with_tail(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    tail = draw_tail(rendered.reference, rng)
    return _painted(
        rendered,
        reference_with(rendered.reference, tail),
        lambda frame, samples: frame_with(frame, tail, samples, rng),
    )


def _with_sheen(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    sheen = draw_sheen(rendered.reference, rendered.frames[-1], rng)
    return _painted(
        rendered,
        shining_reference(rendered.reference, sheen),
        lambda frame, samples: shining_frame(frame, sheen, samples, rng),
    )


def _with_lamps(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    lamps = draw_lamps(rendered.reference, rendered.depth, rendered.spread, rng)
    return _painted(
        rendered,
        lit_reference(rendered.reference, lamps),
        lambda frame, samples: lit_frame(frame, lamps, samples, rng),
    )


def _with_glints(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    glints = draw_glints(rendered.reference, rendered.spread, rng)
    return _painted(
        rendered,
        glinting_reference(rendered.reference, glints),
        lambda frame, samples: glinting_frame(frame, glints, samples, rng),
    )


def _with_window(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    window = draw_window(rendered.reference, rendered.depth, rendered.spread, rng)
    return _painted(
        rendered,
        reference_through(rendered.reference, window),
        lambda frame, samples: frame_through(frame, window, samples, rng),
    )


def _with_shadow(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    light = draw_shadow(rendered.reference.shape[:2], rendered.spread, rng)
    return _painted(
        rendered,
        reference_in_shadow(rendered.reference, light, rendered.depth),
        lambda frame, samples: in_shadow(frame, light),
    )


def _with_texture(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    texture = draw_texture(rendered.reference.shape[:2], rendered.spread, rng)
    clean = rendered.reference * texture
    noiseless = rng.random() < _NOISELESS
    return _painted(
        rendered,
        clean,
        lambda frame, samples: replace(frame, color=clean if noiseless else frame.color * texture),
    )


def _with_ripples(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    pattern = draw_ripples(rendered.reference.shape[:2], rng)
    return _painted(
        rendered,
        rendered.reference * pattern,
        lambda frame, samples: replace(frame, color=frame.color * pattern),
    )


def _with_leaves(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    return _met(rendered, draw_leaves(rendered.reference.shape[:2], rendered.spread, rng), rng)


def _with_page(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    return _met(rendered, draw_page(rendered.reference.shape[:2], rendered.spread, rng), rng)


def _met(rendered: Rendered, texture: MetTexture, rng: np.random.Generator) -> Rendered:
    return _painted(
        rendered,
        rendered.reference * texture.mean,
        lambda frame, samples: replace(frame, color=frame.color * texture.met(samples, rng)),
    )


def _with_mixtures(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    mixtures = draw_mixtures(rendered.reference, rendered.spread, rng)
    return _painted(
        rendered,
        mixed_reference(rendered.reference, mixtures),
        lambda frame, samples: mixed_frame(frame, mixtures, samples, rng),
    )


def _through_lens(rendered: Rendered, rng: np.random.Generator) -> Rendered:
    opening = draw_opening(rendered.depth, rng)
    lens, reference = lens_before(rendered.depth, opening), rendered.reference
    before = [
        frame if frame.depth is None else sample_through_lens(
            frame, lens_before(frame.depth, opening), rng
        )
        for frame in rendered.frames[:-1]
    ]  # fmt: skip
    soft = reference_through_lens(reference, lens, rng)
    # last: without further blocks all else is drawn alike
    blocks = [
        (frame_through_lens(frame, reference, lens, count, rng), count)
        for frame, count in rendered.blocks
    ]
    return replace(rendered, frames=[*before, blocks[0][0]], blocks=blocks, reference=soft)


def _painted(
    rendered: Rendered, reference: np.ndarray, paint: Callable[[Frame, float], Frame]
) -> Rendered:
    frames = [paint(frame, rendered.spp) for frame in rendered.frames]
    more = [(paint(frame, count), count) for frame, count in rendered.blocks[1:]]
    blocks = [(frames[-1], rendered.spp), *more]
    return replace(rendered, frames=frames, blocks=blocks, reference=reference)
