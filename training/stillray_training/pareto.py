"""Which of several methods are worth their time, and what a little more time buys."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from stillray.compare.metrics import Metric

_WITH_UNIT = ("psnr", "cvvdp")  # metrics whose title ends with a unit


@dataclass(frozen=True, kw_only=True)
class Priced:
    """A method's price and what it gives.

    Attributes
    ----------
    label
        Of the method.
    milliseconds
        Of a frame.
    scores
        Metric to value.
    """

    label: str
    milliseconds: float
    scores: dict[str, float]


def pareto_front(methods: Sequence[Priced], metric: Metric) -> list[Priced]:
    """The methods than which none is both as fast and better, fastest first.

    Parameters
    ----------
    methods
        Those that the metric was not measured of are left out.
    metric
        What is better, says it.
    """
    measured = [method for method in methods if metric.name in method.scores]

    def loss(method: Priced) -> float:
        return metric.loss(method.scores[metric.name])

    front: list[Priced] = []
    for method in sorted(measured, key=lambda m: (m.milliseconds, loss(m))):
        if not front or loss(method) < loss(front[-1]):
            front.append(method)
    return front


def advice(methods: Sequence[Priced], metric: Metric) -> str:
    """A sentence to act on: the fastest, and what each further step costs and buys.

    A step whose gain does not show in the metric's own digits is passed over.
    """
    front = pareto_front(methods, metric)
    if not front:
        return f"{metric.title}: not measured"
    now = front[0]
    title, _arrow = metric.title.rsplit(" ", 1)
    name, unit = title.rsplit(" ", 1) if metric.name in _WITH_UNIT else (title, "")

    def shown(value: float) -> str:
        return f"{value:{metric.format}} {unit}".rstrip()

    parts = [
        f"{name}: for {now.milliseconds:.0f} ms use {now.label} ({shown(now.scores[metric.name])})"
    ]
    for step in front[1:]:
        gain = metric.loss(now.scores[metric.name]) - metric.loss(step.scores[metric.name])
        if float(format(gain, metric.format)) == 0:
            continue
        parts.append(
            f"{step.milliseconds - now.milliseconds:.0f} ms more buys {shown(gain)}: {step.label}"
        )
        now = step
    return "; ".join(parts)
