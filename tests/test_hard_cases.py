"""Every hard case, for every packaged model on every provider that computes here."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

import stillray
from tests.hard_cases.catalogue import CASES, models_and_providers
from tests.hard_cases.features import ON_DEMAND


@pytest.fixture(scope="module", params=models_and_providers(), ids="-".join)
def denoiser(request: pytest.FixtureRequest) -> Iterator[stillray.Denoiser]:
    model, provider = request.param
    with stillray.Denoiser(model, threads=1, providers=[provider]) as made:
        yield made


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case_stays_within_its_limit(case, denoiser, request):
    if case.name == "eight_k" and not os.environ.get(ON_DEMAND):
        pytest.skip(f"set {ON_DEMAND}=1")
    if why := case.falls_short.get(denoiser.model.name):
        request.applymarker(pytest.mark.xfail(reason=why, strict=True))
    figure = case.measure(denoiser)
    assert case.passes(figure), f"{case.holds}: {figure:.4g}, must be at most {case.limit:g}"


def test_what_falls_short_names_cases_of_models_that_there_are():
    names = {model.name for model in stillray.list_models()}
    assert names >= {name for case in CASES for name in case.falls_short}
    assert len({case.name for case in CASES}) == len(CASES)
