"""One catalogue of hard cases: what must hold as a number, for every model and provider."""
