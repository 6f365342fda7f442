"""How much of a sequence's figures is the noise of its references."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch", reason="training is of the extra train")
pytest.importorskip("pyoidn", reason="references are made smooth by a peer")

from stillray_training.reference_noise import figures_of, smooth


def _pair(rng, noise):
    """Two frames of soft light that slides by a pixel, and references of them with noise."""
    x = np.arange(97) / 12
    light = np.broadcast_to(0.4 + 0.2 * np.sin(x)[None, :, None], (80, 97, 3)).astype(np.float32)
    frames = light[:, :-1], light[:, 1:]
    references = tuple(
        (frame * (1 + noise * rng.normal(size=frame.shape))).astype(np.float32) for frame in frames
    )
    return frames, references


def test_what_a_perfect_method_flickers_by_is_the_noise_of_references(rng):
    frames, references = _pair(rng, 0.1)
    as_rendered, against_smooth = (
        figures_of(frames, each) for each in (references, smooth(references))
    )
    assert as_rendered.flicker > 0.015
    assert against_smooth.flicker < 0.25 * as_rendered.flicker
    assert against_smooth.psnr > as_rendered.psnr + 10


def test_a_method_that_flickers_does_so_against_smooth_references_too(rng):
    frames, references = _pair(rng, 0.02)
    shown = frames[0], 1.1 * frames[1]
    found = figures_of(shown, smooth(references))
    assert found.flicker == pytest.approx(figures_of(shown, frames).flicker, rel=0.1)


def test_references_themselves_are_perfect(rng):
    _, references = _pair(rng, 0.02)
    assert figures_of(references, references).flicker == 0
    assert figures_of(references, references).psnr == 120
