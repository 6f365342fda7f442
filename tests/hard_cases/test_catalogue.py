"""The catalogue; its cases run in files of their own, which processes share."""

from __future__ import annotations

import stillray
from tests.hard_cases.catalogue import CASES


def test_what_falls_short_names_cases_of_models_that_there_are():
    names = {model.name for model in stillray.list_models()}
    assert names >= {name for case in CASES for name in case.falls_short}
    assert len({case.name for case in CASES}) == len(CASES)
