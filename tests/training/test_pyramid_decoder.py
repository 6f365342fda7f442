"""The pyramid's twin in torch computes what the runtime does."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.families.kernel_pyramid import filter_pyramid  # noqa: E402
from stillray.stages.state import Filterable  # noqa: E402
from stillray_training.decoders.pyramid import (  # noqa: E402
    averaged_albedo,
    blended_with_sample,
    kernel_pyramid,
    level_parts,
    resolve,
)
from tests.families.test_kernel_pyramid import OPTIONS, draw  # noqa: E402


def _nchw(image):
    return torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1)))[None]


@pytest.mark.parametrize("finest", [True, False])
@pytest.mark.parametrize("predicted", [True, False])
@pytest.mark.parametrize("distances", [(), (1, 2)])
@pytest.mark.parametrize(("filters", "tone"), [((), 0.0), ((4, 1), 0.0), ((4, 1), 0.5)])
@pytest.mark.parametrize("averages", [(), (4, 2)])
def test_the_twin_equals_the_runtime(finest, predicted, distances, filters, tone, averages):
    options = dataclasses.replace(
        OPTIONS,
        finest_kernels=finest,
        predicted=predicted,
        finest_neighbours=distances,
        finest_filters=filters,
        filter_features=3 * bool(filters),
        filter_tone=tone,
        albedo_filters=averages,
    )
    mean, sample, albedo, previous, logits = draw(16, 24, options=options)
    light = Filterable(
        mean=mean, sample=sample, remodulation_albedo=albedo, previous=previous, exposure=0.3
    )
    wanted = filter_pyramid(light, logits, options, Strips(1))
    maps = [torch.from_numpy(level)[None] for level in logits]
    past, new, before = _nchw(mean), torch.from_numpy(sample)[None], _nchw(previous)
    parts = level_parts(maps, options)
    blend, weights = parts[0].sample_blend, parts[0].resolve
    given = blended_with_sample(past[:, :3], past[:, 3:], new[:, :3], new[:, 3:], blend)
    exposure = torch.full((1, 1, 1, 1), 0.3)
    image = kernel_pyramid(*given, parts, options, exposure=exposure)
    image = image * averaged_albedo(_nchw(albedo), weights, averages)
    tone = torch.full((1, 1, 1, 1), options.resolve_tone * 0.3)
    image = resolve(image, weights, before[:, :3], before[:, 3:], tone)
    np.testing.assert_allclose(image[0].permute(1, 2, 0), wanted, rtol=2e-5)
