"""All hard cases, in the order of the table."""

from __future__ import annotations

from typing import Any

import numpy as np

import stillray
from tests.hard_cases import features, samples, sequences

CASES = [*samples.CASES, *features.CASES, *sequences.CASES]

#: Models that are not listed, and take frames of one color: measured, not held to the limits. The
#: first take no past: what a case asks of one is met by having none.
BY_NAME = (
    "kpyr-5-still", "kpyr-5s-still", "kpyr-5-color", "kpyr-5s-color", "munet-x1", "munet-x2",
)  # fmt: skip
# onnxruntime lists it everywhere; it sends work to a service and computes nothing here
_REMOTE = {"AzureExecutionProvider"}


class OfFrameSize(stillray.Denoiser):
    """A denoiser whose pictures are as large as the frames: means of what a model made larger."""

    def denoise(self, frame: stillray.Frame, **options: Any) -> np.ndarray:
        """As `stillray.Denoiser.denoise`."""
        image = super().denoise(frame, **options)
        if self.scale == 1:
            return image
        shape = (frame.shape[0], self.scale, frame.shape[1], self.scale, 3)
        # in float64: fireflies are as bright as float32 can hold
        return image.reshape(shape).mean(axis=(1, 3), dtype=np.float64).astype(np.float32)


def models_and_providers() -> list[tuple[str, str]]:
    """Every listed model with every installed provider that computes on this machine."""
    import onnxruntime

    providers = [name for name in onnxruntime.get_available_providers() if name not in _REMOTE]
    return [(model.name, provider) for model in stillray.list_models() for provider in providers]
