"""Every packaged model on every provider that computes here."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import stillray
from tests.hard_cases.catalogue import OfFrameSize, models_and_providers


@pytest.fixture(scope="module", params=models_and_providers(), ids="-".join)
def denoiser(request: pytest.FixtureRequest) -> Iterator[stillray.Denoiser]:
    model, provider = request.param
    with OfFrameSize(model, threads=1, providers=[provider]) as made:
        yield made
