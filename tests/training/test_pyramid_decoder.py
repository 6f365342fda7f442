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
@pytest.mark.parametrize("coarser", [(), ((2, 1), (), (1,))])
@pytest.mark.parametrize("averages", [(), (4, 2)])
def test_the_twin_equals_the_runtime(
    finest, predicted, distances, filters, tone, coarser, averages
):
    options = dataclasses.replace(
        OPTIONS,
        finest_kernels=finest,
        predicted=predicted,
        finest_neighbours=distances,
        finest_filters=filters,
        filter_features=3 * bool(filters or coarser),
        coarser_filters=coarser,
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


def test_the_twin_filters_further_channels_as_the_runtime_does():
    options = dataclasses.replace(
        OPTIONS, finest_filters=(2,), coarser_filters=((1,),), filter_features=3
    )
    mean, _, _, _, logits = draw(16, 24, options=options)
    more = np.random.default_rng(5).normal(size=(16, 24, 3)).astype(np.float32)
    mean = np.concatenate([mean[..., :3], more, mean[..., 3:]], 2)
    wanted = filter_pyramid(Filterable(mean=mean, exposure=0.3), logits, options, Strips(1))
    alone = Filterable(mean=np.delete(mean, np.s_[3:6], 2), exposure=0.3)
    # beside others light is filtered as it is alone
    np.testing.assert_array_equal(
        wanted[..., :3], filter_pyramid(alone, logits, options, Strips(1))
    )
    parts = level_parts([torch.from_numpy(level)[None] for level in logits], options)
    light, samples = _nchw(mean)[:, :6], _nchw(mean)[:, 6:]
    exposure = torch.full((1, 1, 1, 1), 0.3)
    # without a sample of its own a frame holds all of its samples in the mean
    image = kernel_pyramid(light, samples, parts, options, exposure=exposure)
    nothing = torch.zeros(1, 3, 16, 24)
    tone = torch.full((1, 1, 1, 1), options.resolve_tone * 0.3)
    weights = parts[0].resolve
    image = resolve(image, weights, torch.zeros_like(image), nothing[:, :1], tone)
    np.testing.assert_allclose(image[0].permute(1, 2, 0), wanted, rtol=2e-4, atol=1e-5)
