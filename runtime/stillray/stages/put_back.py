"""The stages that put back what a filter took for fireflies: which of them a model has."""

from __future__ import annotations

from stillray.model_spec.stages import Lamps, RareLight
from stillray.stages.plan import Stage


def put_back(lamps: Lamps, rare_light: RareLight) -> list[Stage]:
    """Those of `stillray.stages.lamps` and `stillray.stages.rare_light`, in their order."""
    blocks = "blocks of bright samples that were filtered away"
    many = "light of samples that stand far above the picture, where many do"
    stages = [Stage("lamps", True, blocks)] if lamps.restored else []
    return [*stages, Stage("rare_light", True, many)] if rare_light.restored else stages
