"""A family that shares nothing with the others comes in by the contract alone."""

from __future__ import annotations

import numpy as np
import pytest

import stillray
from stillray.frame import Frame
from stillray.pipeline.denoiser import Denoiser
from tests.families.smallest import Smallest


class Small(Denoiser):
    families = {"bilateral-grids": Smallest}  # noqa: RUF012  read only


@pytest.fixture
def denoiser():
    with Small("nbg-2x1", threads=1) as made:
        yield made


def frame(light, noise=0.5, size=(6, 8)):
    color = np.full((*size, 3), light, np.float32)
    return Frame(color=color - noise, color_b=color + noise)


def test_its_pictures_are_larger_than_frames_and_hold_the_past(denoiser):
    assert denoiser.denoise(frame(2.0)).shape == (12, 16, 3)
    np.testing.assert_allclose(denoiser.denoise(frame(4.0)), 3.0)


def test_what_is_learned_outlives_a_cut_and_what_is_seen_does_not(denoiser):
    denoiser.denoise(frame(2.0, noise=1.0))
    denoiser.reset()
    np.testing.assert_allclose(denoiser.denoise(frame(4.0, noise=2.0)), 4.0)
    assert denoiser.state.learned == 3.0  # mean of differences of 2 and 4


def test_its_stages_are_said_as_they_run(denoiser):
    for given in (frame(1.0), frame(2.0), frame(1.0, size=(4, 4))):
        said = {stage.name for stage in denoiser.stages(given) if stage.runs}
        denoiser.denoise(given)
        assert said == set(denoiser.last_timings)


def test_a_buffer_that_it_needs_must_be_given(denoiser):
    with pytest.raises(stillray.InputError, match="nbg-2x1 needs the buffer color_b"):
        denoiser.denoise(Frame(color=np.ones((6, 8, 3))))


def test_layers_and_tiles_that_it_cannot_do_are_refused(denoiser):
    given = frame(1.0)
    with pytest.raises(stillray.InputError, match="layers must be none with nbg-2x1, got a"):
        denoiser.denoise_layers(given, {"a": given.color})
    denoiser.max_memory = 1 << 30
    with pytest.raises(stillray.InputError, match="max_memory must not be given with nbg-2x1"):
        denoiser.denoise(given)
