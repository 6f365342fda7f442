"""Image metrics: exposure and tone mapping as the validation set states them, then the usual ones.

SMAPE and relative MSE see exposed radiance, all others see tone-mapped images. A metric whose
package is not installed is left out; `require` makes that an error.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from typing import Any

import cv2
import numpy as np

from stillray.compare.display import display_exposure, tone_map
from stillray.compare.warping import Followed, warping_error
from stillray.errors import InputError

SMAPE_EPSILON = 0.01  # exposed radiance (Fan et al. 2021, eq. 6)
RELATIVE_MSE_EPSILON = 0.01  # exposed radiance, squared units
# A 24-inch Full HD monitor, peak 200 cd/m^2, office light of 250 lux, seen from 0.6 m: 38 pixels a
# degree. The image lies in its middle, pixel on pixel.
DISPLAY = "standard_fhd"
FRAMES_PER_SECOND = 30
EDGE_BLUR = 1.0  # standard deviation of the Gaussian before slopes are taken, pixels
EDGE_SHARE = 0.1  # the pixels where the reference is steepest count as edges


@dataclass(frozen=True, kw_only=True)
class Metric:
    """A metric's name, and how tables show it."""

    name: str
    title: str
    format: str
    module: str  # what has to be importable
    package: str  # what to install for that
    higher_is_better: bool = False
    is_signed: bool = False  # 0 is best, and both directions are bad
    when_named: bool = False  # measured where it is named alone: another says the same

    def loss(self, value: float) -> float:
        """The value turned so that less is better."""
        if self.is_signed:
            return abs(value)
        return -value if self.higher_is_better else value

    def summary(self, values: Sequence[float]) -> float:
        """One value for several images: their mean; of signed ones, which cancel, the worst."""
        return float(max(values, key=abs) if self.is_signed else np.mean(values))

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
    Metric(
        name="rmse", title="RMSE ↓", format=".4f", module="numpy", package="numpy",
        when_named=True,
    ),
    Metric(name="smape", title="SMAPE ↓", format=".4f", module="numpy", package="numpy"),
    Metric(name="relmse", title="relative MSE ↓", format=".3g", module="numpy", package="numpy"),
    Metric(
        name="flip", title="FLIP ↓", format=".3f", module="flip_evaluator", package="flip-evaluator"
    ),
    Metric(name="edge", title="edge error ↓", format=".4f", module="cv2", package="opencv-python"),
    Metric(
        name="bias", title="bias % → 0", format="+.2f", module="numpy", package="numpy",
        is_signed=True,
    ),
    Metric(name="flicker", title="flicker ↓", format=".4f", module="numpy", package="numpy"),
    Metric(
        name="warping", title="warping error ↓", format=".4f", module="numpy", package="numpy"
    ),
    Metric(
        name="cvvdp", title="ColorVideoVDP JOD ↑", format=".2f", module="pycvvdp", package="cvvdp",
        higher_is_better=True,
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
    followed: Followed | None = None,
) -> dict[str, float]:
    """All metrics that can be measured here, or those named.

    Parameters
    ----------
    images, references : (h, w, 3) float32 each
        Scene-linear radiance of consecutive frames, one or more. Exposure is that of the last
        reference, and metrics of an image are those of the last one.
    names
        Names out of `METRICS`; None for all but those that are measured when named.
    followed
        Where the last image's pixels were in the one before, if that is known.

    Returns
    -------
    dict
        ``psnr`` in dB, ``ssim`` and ``cvvdp`` in JOD (higher is better), ``rmse``, ``smape``,
        ``relmse``, ``flip``, ``edge``, ``flicker`` and ``warping`` (lower is better), ``bias`` in
        percent (0 is best). ``rmse`` is of tone-mapped images, in [0, 1], so that ``psnr`` is -20
        log10 of it. ``flicker`` takes two frames or more, ``warping`` those and ``followed``, of
        which some pixel was seen before; ``cvvdp`` sees one frame as a still.
    """
    image, reference = images[-1], references[-1]
    exposure = display_exposure(reference)
    shown, wanted = tone_map(image, exposure), tone_map(reference, exposure)
    a, b = image.astype(np.float64) * exposure, reference.astype(np.float64) * exposure
    values = {
        "edge": edge_error(shown, wanted),
        "bias": brightness_bias(shown, wanted),
        "rmse": float(np.sqrt(np.mean((shown.astype(np.float64) - wanted) ** 2))),
        "smape": float(np.mean(np.abs(a - b) / (np.abs(a) + np.abs(b) + SMAPE_EPSILON))),
        "relmse": float(np.mean((a - b) ** 2 / (b**2 + RELATIVE_MSE_EPSILON))),
    }
    if names is None:
        names = [metric.name for metric in METRICS if not metric.when_named]
    measured = {metric.name for metric in METRICS if metric.is_installed and metric.name in names}
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
    if len(images) > 1 and followed is not None and followed.seen.any():
        values["warping"] = warping_error(images[-2], image, reference, followed)
    if "cvvdp" in measured:
        values["cvvdp"] = color_video_vdp(images, references)
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


def edge_error(shown: np.ndarray, wanted: np.ndarray) -> float:
    """Error of slopes at edges: blur, stairs and stipple raise it, noise on flat walls does not.

    Both images are blurred by a Gaussian of `EDGE_BLUR`, so that one pixel's noise is no slope.
    Edges are the `EDGE_SHARE` of the pixels where the reference's slope, the length of its gradient
    over both directions and three channels, is largest.

    Parameters
    ----------
    shown, wanted : (h, w, 3) float
        Tone-mapped image and reference, in [0, 1].

    Returns
    -------
    float
        Mean length of the difference of the two gradients at edges, in tone-mapped units a pixel.
    """
    slopes, wanted_slopes = _slopes(shown), _slopes(wanted)
    steepness = np.linalg.norm(wanted_slopes, axis=-1)
    count = max(1, round(EDGE_SHARE * steepness.size))
    edges = np.argpartition(steepness, -count, axis=None)[-count:]
    errors = np.linalg.norm(slopes - wanted_slopes, axis=-1)
    return float(np.mean(errors.reshape(-1)[edges]))


def _slopes(shown: np.ndarray) -> np.ndarray:
    """Differences a pixel in x and y of the blurred image, ``(h, w, 6)``."""
    soft = cv2.GaussianBlur(np.asarray(shown, np.float64), (0, 0), EDGE_BLUR)
    down, right = np.gradient(soft, axis=(0, 1))
    return np.concatenate([right, down], axis=-1)


def brightness_bias(shown: np.ndarray, wanted: np.ndarray) -> float:
    """How much too bright the image is, in percent of the reference's mean.

    Parameters
    ----------
    shown, wanted : (h, w, 3) float
        Tone-mapped image and reference, in [0, 1].
    """
    mean = float(np.mean(wanted))
    return 100 * (float(np.mean(shown)) / mean - 1) if mean > 0 else 0.0


def color_video_vdp(images: Sequence[np.ndarray], references: Sequence[np.ndarray]) -> float:
    """Quality as seen on `DISPLAY`, in colour (Mantiuk et al. 2024, ColorVideoVDP).

    The metric looks back a quarter of a second. A sequence that is shorter goes on before its first
    frame as a still of that frame: with two frames, what is seen is one change. One frame is seen
    as a still image.

    Parameters
    ----------
    images, references : (h, w, 3) float32 each
        Scene-linear radiance of consecutive frames, `FRAMES_PER_SECOND`; exposed for the last
        reference.

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
    if len(images) == 1:
        quality, _ = _color_video_vdp().predict(shown[0], wanted[0], dim_order="HWC")
    else:
        quality, _ = _color_video_vdp().predict(
            shown, wanted, dim_order="FHWC", frames_per_second=FRAMES_PER_SECOND
        )
    return float(quality)


@cache
def _color_video_vdp() -> Any:
    _import_torchvision()
    import torch
    from pycvvdp import cvvdp

    # on the processor wherever it runs, so that figures compare
    return cvvdp(display_name=DISPLAY, quiet=True, device=torch.device("cpu"))


def _import_torchvision() -> None:
    """Import what ColorVideoVDP blurs with, also beside a torch without CUDA.

    The compiled operators of PyPI's torchvision do not load there. They are not needed, but its
    import stops where names are missing.
    """
    import torch

    try:
        import torchvision
    except RuntimeError:
        library = torch.library.Library("torchvision", "DEF")
        for name in ("nms", "qnms"):
            library.define(f"{name}(Tensor dets, Tensor scores, float iou_threshold) -> Tensor")
        _declared.append(library)
        import torchvision  # noqa: F401


_declared: list[Any] = []  # a library's declarations live as long as it does
