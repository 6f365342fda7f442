"""All hard cases, in the order of the table."""

from __future__ import annotations

import stillray
from tests.hard_cases import features, samples, sequences

CASES = [*samples.CASES, *features.CASES, *sequences.CASES]

# onnxruntime lists it everywhere; it sends work to a service and computes nothing here
_REMOTE = {"AzureExecutionProvider"}


def models_and_providers() -> list[tuple[str, str]]:
    """Every packaged model with every installed provider that computes on this machine."""
    import onnxruntime

    providers = [name for name in onnxruntime.get_available_providers() if name not in _REMOTE]
    return [(model.name, provider) for model in stillray.list_models() for provider in providers]
