"""The hard cases of time, for every packaged model and provider."""

from __future__ import annotations

import pytest

from tests.hard_cases.check import check
from tests.hard_cases.sequences import CASES


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_hard_case_stays_within_its_limit(case, denoiser, request):
    check(case, denoiser, request)
