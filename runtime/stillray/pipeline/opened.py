"""A model that is open: what decides and steps for it, where it runs, and in what numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from stillray.families.contract import Engine, Family
from stillray.families.registry import FAMILIES
from stillray.model_spec.loader import ModelSpec
from stillray.models.registry import ModelInfo
from stillray.pipeline.opening import (
    Providers,
    engine_of_model,
    family_of_model,
    network_path,
)
from stillray.pipeline.prefilter import Prefilter


@dataclass(kw_only=True)
class OpenedModel:
    """A model and what runs it.

    Attributes
    ----------
    model
        The model.
    family
        What decides and steps for it.
    engine
        Where its network runs; may be another in its place.
    precision
        In what numbers: ``"float32"`` or ``"int8"``.
    prefilter
        What denoises the albedo of its frames first; None where nothing does.
    owns_engine
        Whether the engine is closed with it.
    """

    model: ModelInfo
    family: Family
    engine: Engine
    precision: str
    prefilter: Prefilter | None
    owns_engine: bool = True

    @classmethod
    def of(
        cls,
        model: ModelInfo,
        *,
        threads: int,
        providers: Providers,
        precision: str,
        engine: Engine | None = None,
        families: Mapping[str, Callable[[ModelSpec], Family]] = FAMILIES,
    ) -> OpenedModel:
        """Open a model.

        Parameters
        ----------
        model
            From `stillray.pipeline.opening.model_of`.
        threads, providers, precision, engine
            As `stillray.Denoiser` takes them; an engine that is given stays open afterwards.
        families
            What makes a family's model of its specification.

        Raises
        ------
        InputError
            A file cannot be used, or a provider or precision is not there.
        """
        family = family_of_model(model, providers, families)
        network = network_path(model, precision, providers)
        runs = engine or engine_of_model(model, threads, providers, network)
        prefilter = model.spec.prefilter.albedo
        exact = precision if precision == "float32" else "auto"
        return cls(
            model=model,
            family=family,
            engine=runs,
            precision="float32" if network == model.path else "int8",
            prefilter=Prefilter(prefilter, threads, providers, exact) if prefilter else None,
            owns_engine=engine is None,
        )

    def close(self) -> None:
        """Close its networks, but not an engine that was given; may be called again."""
        if self.owns_engine:
            self.engine.close()
        if self.prefilter is not None:
            self.prefilter.close()
