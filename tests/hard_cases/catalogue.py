"""All hard cases, in the order of the table."""

from __future__ import annotations

from tests.hard_cases import features, samples, sequences

CASES = [*samples.CASES, *features.CASES, *sequences.CASES]
