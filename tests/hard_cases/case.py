"""What a hard case is, and the small worlds that cases are made of."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

import stillray
from stillray.frame import Frame
from tests.conftest import clean_color, make_frame, remembered

HEIGHT, WIDTH = 24, 33
ROUNDING = 1e-4  # float32 sums of a window, a division and a multiplication by albedo


Measure = Callable[[stillray.Denoiser], float | Iterator[float]]


@dataclass(frozen=True, kw_only=True)
class Case:
    """One hard case.

    Attributes
    ----------
    name
        Of the test.
    what
        The input.
    holds
        What is measured; it must be at most ``limit``.
    limit
        Largest figure that passes; a NaN never does.
    measure
        From a denoiser without a past to the figure, or to one figure after the other, of which the
        worst counts.
    falls_short
        Models that do not keep the limit, and why: their tests are expected to fail.
    """

    name: str
    what: str
    holds: str
    limit: float
    measure: Measure
    falls_short: dict[str, str]

    def figures(self, denoiser: stillray.Denoiser) -> Iterator[float]:
        """What is measured, part by part: who needs no more may stop."""
        measured = self.measure(denoiser)
        if isinstance(measured, Iterator):
            yield from measured
        else:
            yield measured

    def worst(self, denoiser: stillray.Denoiser) -> float:
        """The figure that counts; NaN where any is."""
        return float(np.max(list(self.figures(denoiser))))

    def passes(self, figure: float) -> bool:
        """Whether a measured figure is within the limit."""
        return figure <= self.limit


def case(what: str, holds: str, limit: float, **falls_short: str) -> Callable[[Measure], Case]:
    """Make a case of a function that measures one; it lends its name."""

    def made(measure: Measure) -> Case:
        return Case(
            name=measure.__name__,
            what=what,
            holds=holds,
            limit=limit,
            measure=measure,
            falls_short={name.replace("_", "-"): why for name, why in falls_short.items()},
        )

    return made


def run(denoiser: stillray.Denoiser, frames: Iterable[Frame]) -> list[np.ndarray]:
    """The pictures of a sequence that begins anew; what is said to run is what does."""
    denoiser.reset()
    images = []
    for frame in frames:
        said = {stage.name for stage in denoiser.stages(frame) if stage.runs}
        images.append(denoiser.denoise(frame))
        assert said == set(denoiser.last_timings)
    return images


def still(height: int = HEIGHT, width: int = WIDTH) -> np.ndarray:
    """Motion of a still camera."""
    return np.zeros((height, width, 2), np.float32)


def flat(value: float, **buffers: np.ndarray) -> Frame:
    """A frame of one radiance under a still camera."""
    color = np.full((HEIGHT, WIDTH, 3), value, np.float32)
    return Frame(**{"color": color, "motion": still(), **buffers})


def changed(frame: Frame, **buffers: object) -> Frame:
    """A frame with other buffers, read anew."""
    names = ("color", "albedo", "normal", "depth", "motion")
    return Frame(**{**{name: getattr(frame, name) for name in names}, **buffers})  # type: ignore[arg-type]


def noisy(count: int, first: int = 0, light: float = 1.0) -> list[Frame]:
    """Frames of a wall and a box under a still camera, with 1-spp-like noise."""
    frames = [make_frame(HEIGHT, WIDTH, first + index) for index in range(count)]
    return [changed(frame, color=frame.color * np.float32(light)) for frame in frames]


def truth() -> np.ndarray:
    """What the `noisy` frames are estimates of."""
    return clean_color(HEIGHT, WIDTH)


def clean(count: int) -> list[Frame]:
    """`noisy` without its noise."""
    return [changed(make_frame(HEIGHT, WIDTH), color=truth()) for _ in range(count)]


def apart(images: object, wanted: object) -> float:
    """Largest relative difference, of the larger of both; NaN and infinity give infinity."""
    a, b = np.asarray(images, np.float64), np.asarray(wanted, np.float64)
    if not np.isfinite(a).all():
        return float("inf")
    largest = np.maximum(np.abs(a), np.abs(b))
    return float((np.abs(a - b) / np.where(largest > 0, largest, 1)).max())


def accumulated(denoiser: stillray.Denoiser, frame: Frame) -> np.ndarray:
    """Radiance as accumulated, before the kernels."""
    from stillray.stages.demodulate import demodulation_albedo

    mean = remembered(denoiser).mean[..., :3]
    if frame.albedo is None:
        return mean
    albedo = np.clip(frame.albedo, 0, 1)
    return mean * demodulation_albedo(albedo, denoiser.model.spec.demodulate)
