"""A frame's albedo, denoised before the frame is.

Of few samples, albedo out of focus, of things in motion, seen through glass or of materials that
are chosen by chance is noise. Light is divided by it, and the picture multiplied: as noisy as the
albedo was. A network that sees only the albedo and what lies below it tells noise from texture, as
Open Image Denoise's prefilters do.
"""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stillray.families.contract import Context
from stillray.frame import Frame
from stillray.model_spec.loader import ModelSpec
from stillray.models.network import WatchedEngine
from stillray.models.registry import find_model
from stillray.pipeline.opening import (
    Providers,
    engine_of_model,
    family_of_model,
    network_path,
)
from stillray.pipeline.plan import Asked, plan_frame
from stillray.stages.plan import Stage
from stillray.stages.sample_bounds import bound_by_samples
from stillray.stages.shared_noise import shared_spread

_BLACK = 1e-3  # albedo at or below which a pixel shows no surface, and its light is not divided
_GREY = 1e-2  # and that it may have when denoised, to be black still: else it was black by chance
#: The stage, as timings call it.
PREFILTER = "prefilter"


def prefilter_stages(frame: Frame, spec: ModelSpec) -> list[Stage]:
    """Whether a frame's albedo is denoised first, and why; none where a model never does that."""
    model = spec.prefilter.albedo
    if not model:
        return []
    if frame.albedo is None:
        return [Stage(PREFILTER, False, "there is no albedo")]
    if frame.clean_features:
        return [Stage(PREFILTER, False, "the albedo is said to have no noise")]
    return [Stage(PREFILTER, True, f"the albedo may have noise: {model}")]


def foretold(frame: Frame, spec: ModelSpec) -> tuple[list[Stage], Frame]:
    """`prefilter_stages`, and a frame by whose values one says what runs after them.

    An albedo that is to be denoised is finite and in [0, 1] there, as it will be.
    """
    stages = prefilter_stages(frame, spec)
    if frame.albedo is not None and any(stage.runs for stage in stages):
        albedo = np.clip(np.nan_to_num(np.asarray(frame.albedo, np.float32)), 0, 1)
        frame = replace(frame, albedo=albedo, clean_features=True)
    return stages, frame


def guides_of(frame: Frame, albedo: np.ndarray) -> Frame:
    """The frame that a prefilter denoises: an albedo ``(h, w, 3)`` for color, normal and depth.

    However many samples a pixel has, it is taken to have one, or none: of many a network expects
    little noise, and keeps that of glass and of mixed materials, which is there at any count.
    """
    samples = None if frame.samples is None else np.minimum(frame.samples, 1)
    return replace(
        frame, color=albedo, albedo=None, motion=None, color_b=None, alpha=None, jitter=None,
        roughness=None, specular_albedo=None, samples=samples,
    )  # fmt: skip


class Prefilter:
    """Denoises the albedo of frames by a model of its own.

    Parameters
    ----------
    model
        Its name.
    threads, providers, precision
        As `stillray.Denoiser` takes them.

    Raises
    ------
    InputError
        There is no such model.
    """

    def __init__(self, model: str, threads: int, providers: Providers, precision: str) -> None:
        self._model = find_model(model)
        self._family = family_of_model(self._model, providers)
        network = network_path(self._model, precision, providers)
        self._engine = engine_of_model(self._model, threads, providers, network)

    def close(self) -> None:
        """Close its network; may be called again."""
        self._engine.close()

    def denoised(self, frame: Frame, context: Context, max_memory: int | None) -> Frame:
        """A frame whose albedo has less noise.

        Parameters
        ----------
        frame
            With albedo.
        context
            Where the work runs; nothing is kept there but arrays.
        max_memory
            Bytes that the process should stay below; None for whole frames.

        Returns
        -------
        Frame
            The same but for its albedo: convex combinations of what was there, in [0, 1], and where
            the frame says its samples no further from it than those let it be. Skies,
            lamps and mirrors that are black stay black beside what is not: their light would be
            divided by next to nothing.
        """
        assert frame.albedo is not None
        strips = context.strips
        albedo = np.empty(frame.albedo.shape, np.float32)

        def bounded(rows: slice) -> None:
            np.clip(frame.albedo[rows], 0, 1, out=albedo[rows])  # type: ignore[index]

        strips.run(bounded, *frame.shape)
        guides = guides_of(frame, albedo)
        if guides.filter_spread is None:
            # light tells it, albedo hardly; what is no number yet tells nothing
            with np.errstate(all="ignore"):
                spread = shared_spread(frame.color, frame.albedo)
            guides = replace(guides, filter_spread=spread)
        engine = WatchedEngine(self._engine, strips.watch) if strips.watch.active else self._engine
        inner = Context(strips=strips, engine=engine, workspace=context.workspace)
        asked = Asked(model=self._model.name, temporal=False, max_memory=max_memory)
        plan = plan_frame(guides, None, self._family, asked, inner)
        image = self._family.step(plan, inner).image
        if frame.samples is not None:
            bound_by_samples(image, albedo, frame.samples, strips)

        def keep_black(rows: slice) -> None:
            black = cv2.bitwise_and(_within(albedo[rows], _BLACK), _within(image[rows], _GREY))
            image[rows][black > 0] = 0
            # rounding: what is above 1 would be repaired
            np.minimum(image[rows], 1, out=image[rows])

        strips.run(keep_black, *frame.shape)
        return replace(frame, albedo=image, clean_features=True)


def _within(albedo: np.ndarray, most: float) -> np.ndarray:
    """Where no channel is above a bound, ``(h, w)``: 255."""
    return cv2.inRange(albedo, (0.0, 0.0, 0.0), (most, most, most))
