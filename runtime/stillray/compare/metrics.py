"""Image metrics: exposure and tone mapping as the validation set states them, then the usual ones.

PSNR, SSIM, FLIP, flicker and FovVideoVDP see tone-mapped images; SMAPE and relative MSE see exposed
radiance. A metric whose package is not installed is left out; `require` makes that an error.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import numpy as np

from stillray.compare.display import display_exposure, tone_map
from stillray.errors import InputError

SMAPE_EPSILON = 0.01  # exposed radiance (Fan et al. 2021, eq. 6)
RELATIVE_MSE_EPSILON = 0.01  # exposed radiance, squared units
# A 24-inch Full HD monitor, peak 200 cd/m^2, office light of 250 lux, seen from 0.6 m: 38 pixels a
# degree. The image lies in its middle, pixel on pixel.
DISPLAY = "standard_fhd"
FRAMES_PER_SECOND = 30


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric's name, and how tables show it."""

    name: str
    title: str
    format: str
    module: str  # what has to be importable
    package: str  # what to install for that
    higher_is_better: bool = False

    @property
    def is_installed(self) -> bool:
        """Whether the metric can be measured here."""
        return find_spec(self.module) is not None


#: Every metric, in the order of the tables.
METRICS = (
    Metric(
        name="psnr", title="PSNR dB ↑", format=".2f", module="skimage", package="scikit-image",
        higher_is_better=True,
    ),
    Metric(
        name="ssim", title="SSIM ↑", format=".3f", module="skimage", package="scikit-image",
        higher_is_better=True,
    ),
    Metric(name="smape", title="SMAPE ↓", format=".4f", module="numpy", package="numpy"),
    Metric(name="relmse", title="relative MSE ↓", format=".3g", module="numpy", package="numpy"),
    Metric(
        name="flip", title="FLIP ↓", format=".3f", module="flip_evaluator", package="flip-evaluator"
    ),
    Metric(name="flicker", title="flicker ↓", format=".4f", module="numpy", package="numpy"),
    Metric(
        name="fovvideovdp", title="FovVideoVDP JOD ↑", format=".2f", module="pyfvvdp",
        package="pyfvvdp", higher_is_better=True,
    ),
)  # fmt: skip


def require(names: Collection[str]) -> None:
    """Raise `InputError` where the package of one of these metrics is not installed."""
    absent = [metric for metric in METRICS if metric.name in names and not metric.is_installed]
    if absent:
        packages = ", ".join(dict.fromkeys(metric.package for metric in absent))
        raise InputError(
            f"{', '.join(metric.name for metric in absent)} must be measured with {packages}, "
            "which is not installed: pip install 'stillray[compare]'"
        )


def evaluate(
    images: Sequence[np.ndarray],
    references: Sequence[np.ndarray],
    *,
    names: Collection[str] | None = None,
) -> dict[str, float]:
    """All metrics that can be measured here, or those named.

    Parameters
    ----------
    images, references : (h, w, 3) float32 each
        Scene-linear radiance of consecutive frames, one or more. Exposure is that of the last
        reference, and metrics of an image are those of the last one.
    names
        Names out of `METRICS`; None for all.

    Returns
    -------
    dict
        ``psnr`` in dB, ``ssim`` and ``fovvideovdp`` in JOD (higher is better), ``smape``,
        ``relmse``, ``flip`` and ``flicker`` (lower is better). ``flicker`` and ``fovvideovdp``
        take two frames or more.
    """
    image, reference = images[-1], references[-1]
    exposure = display_exposure(reference)
    shown, wanted = tone_map(image, exposure), tone_map(reference, exposure)
    a, b = image.astype(np.float64) * exposure, reference.astype(np.float64) * exposure
    values = {
        "smape": float(np.mean(np.abs(a - b) / (np.abs(a) + np.abs(b) + SMAPE_EPSILON))),
        "relmse": float(np.mean((a - b) ** 2 / (b**2 + RELATIVE_MSE_EPSILON))),
    }
    measured = {
        metric.name
        for metric in METRICS
        if metric.is_installed and (names is None or metric.name in names)
    }
    if measured & {"psnr", "ssim"}:
        from skimage.metrics import peak_signal_noise_ratio, structural_similarity

        with np.errstate(divide="ignore"):  # equal images: infinitely many decibels
            values["psnr"] = float(peak_signal_noise_ratio(wanted, shown, data_range=1.0))
        values["ssim"] = float(
            structural_similarity(wanted, shown, channel_axis=-1, data_range=1.0)
        )
    if "flip" in measured:
        _, values["flip"] = flip(image, reference)
    if len(images) > 1:
        values["flicker"] = flicker(images[-2], image, references[-2], reference)
        if "fovvideovdp" in measured:
            values["fovvideovdp"] = fovvideovdp(images, references)
    return {
        metric.name: values[metric.name]
        for metric in METRICS
        if metric.name in measured and metric.name in values
    }


def flip(image: np.ndarray, reference: np.ndarray) -> tuple[np.ndarray, float]:
    """FLIP of tone-mapped images (Andersson et al. 2020), 67 pixels a degree.

    Parameters
    ----------
    image, reference : (h, w, 3) float32
        Scene-linear radiance, exposed for the reference.

    Returns
    -------
    map : (h, w) float32
        Error of each pixel in [0, 1].
    mean : float
    """
    import flip_evaluator

    exposure = display_exposure(reference)
    shown, wanted = (
        tone_map(picture, exposure).astype(np.float32) for picture in (image, reference)
    )
    errors, mean, _ = flip_evaluator.evaluate(
        wanted, shown, "LDR", inputsRGB=True, applyMagma=False
    )
    return errors[..., 0], float(mean)


def flicker(
    before: np.ndarray, image: np.ndarray, reference_before: np.ndarray, reference: np.ndarray
) -> float:
    """Mean absolute error of the tone-mapped difference between two consecutive frames.

    Parameters
    ----------
    before, image : (h, w, 3) float32
        Scene-linear radiance of the two frames.
    reference_before, reference : (h, w, 3) float32
        Their references; both pairs are exposed for ``reference``.

    Returns
    -------
    float
        In [0, 2]; 0 where the image changes exactly as it should.
    """
    exposure = display_exposure(reference)
    change = tone_map(image, exposure) - tone_map(before, exposure)
    wanted = tone_map(reference, exposure) - tone_map(reference_before, exposure)
    return float(np.mean(np.abs(change - wanted)))


def fovvideovdp(images: Sequence[np.ndarray], references: Sequence[np.ndarray]) -> float:
    """Quality of a video as seen on `DISPLAY` (Mantiuk et al. 2021, FovVideoVDP, not foveated).

    The metric looks back a quarter of a second. A sequence that is shorter goes on before its first
    frame as a still of that frame: with two frames, what is seen is one change.

    Its package is licensed for non-commercial use (CC BY-NC 4.0).

    Parameters
    ----------
    images, references : (h, w, 3) float32 each
        Scene-linear radiance of two or more consecutive frames, `FRAMES_PER_SECOND`; exposed for
        the last reference.

    Returns
    -------
    float
        Just-objectionable differences: 10 where no difference is seen, one less where three of
        four viewers prefer the reference.
    """
    exposure = display_exposure(references[-1])
    shown, wanted = (
        np.stack([tone_map(frame, exposure) for frame in frames]).astype(np.float32)
        for frames in (images, references)
    )
    quality, _ = _fovvideovdp().predict(
        shown, wanted, dim_order="FHWC", frames_per_second=FRAMES_PER_SECOND
    )
    return float(quality)


@cache
def _fovvideovdp() -> Any:
    from pyfvvdp import fvvdp

    # on the processor wherever it runs, so that figures compare
    return fvvdp(display_name=DISPLAY, quiet=True, device="cpu")
