"""A draw that generators of scenes share."""

from random import Random


def log_uniform(drawn: Random, low: float, high: float) -> float:
    """Between two positive numbers, as often in each of as many doublings."""
    return float(low * (high / low) ** drawn.random())
