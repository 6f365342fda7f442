"""The families of models, by the name that specifications use."""

from __future__ import annotations

from collections.abc import Callable, Mapping

from stillray.errors import InputError
from stillray.families.bilateral_grid import BilateralGridModel
from stillray.families.contract import Family
from stillray.families.feature_filters import FeatureFiltersModel
from stillray.families.fused_kernels import FusedKernelsModel
from stillray.families.kernel_pyramid import KernelPyramidModel
from stillray.families.multi_resolution import MultiResolutionModel
from stillray.families.online import OnlineModel
from stillray.families.temporal_kernels import TemporalKernels
from stillray.model_spec.loader import ModelSpec

FAMILIES: Mapping[str, Callable[[ModelSpec], Family]] = {
    "weight-sharing-kernels": FusedKernelsModel,
    "kernel-pyramid": KernelPyramidModel,
    "multi-resolution-kernels": MultiResolutionModel,
    "bilateral-grids": BilateralGridModel,
    "cross-regression": OnlineModel,
    "feature-filters": FeatureFiltersModel,
}


def family_of(spec: ModelSpec) -> Family:
    """The model that a specification describes, by its family."""
    return FAMILIES[spec.family](spec)


def kernels_of(spec: ModelSpec) -> TemporalKernels:
    """`family_of` a specification of kernels, whose parts training and export look at.

    Raises
    ------
    InputError
        The model filters otherwise.
    """
    family = family_of(spec)
    if not isinstance(family, TemporalKernels):
        raise InputError(f"model must filter by kernels, got {spec.name} of {spec.family}")
    return family
