"""What the loader asks of a network is what the families' decoders take apart."""

from dataclasses import replace
from itertools import product

import pytest

from stillray.families.filter_layout import level_layout, target_layout
from stillray.families.multi_resolution import level_planes
from stillray.families.pyramid_logits import level_logits
from stillray.model_spec import load
from stillray.model_spec.network_outputs import network_outputs


@pytest.mark.parametrize(("finest", "predicted"), product((True, False), repeat=2))
@pytest.mark.parametrize("kernel_sizes", [(3,), (3, 5, 7)])
@pytest.mark.parametrize("distances", [(), (1, 3)])
@pytest.mark.parametrize("filters", [(), (4, 1)])
@pytest.mark.parametrize("name", ["kpyr-5", "kpyr-5s"])
def test_a_pyramid_gives_the_logits_of_every_level(
    name, filters, distances, kernel_sizes, finest, predicted
):
    spec = load(name)
    decoder = replace(
        spec.decoder,
        kernel_sizes=kernel_sizes,
        finest_kernels=finest,
        predicted=predicted,
        finest_neighbours=distances,
        finest_filters=filters,
        filter_features=5 * bool(filters),
    )
    spec = replace(spec, decoder=decoder)
    levels, block = spec.network.resolutions, spec.network.block
    planes = [level_logits(level, levels, decoder) for level in range(levels)]
    wanted = [(planes[0] * block**2, block)]
    wanted += [(count, 2**level) for level, count in enumerate(planes) if level]
    assert network_outputs(spec) == wanted


def test_fused_kernels_at_several_resolutions():
    spec = load("wskp-mr")
    levels = spec.network.resolutions
    planes = [level_planes(level, levels, spec.decoder) for level in range(levels)]
    assert network_outputs(spec) == list(zip(planes, [1, 2, 4], strict=True))


@pytest.mark.parametrize("widths", [(8,), (8, 16), (32, 96, 192)])
def test_feature_filters_at_several_resolutions(widths):
    spec = load("munet-x2")
    network = replace(spec.network, radiance_widths=widths, guide_widths=widths)
    spec = replace(spec, network=network, decoder=replace(spec.decoder, features=7))
    levels = len(widths) + 1
    wanted = [(4 * target_layout(levels, spec.decoder).planes, 2)]
    wanted += [
        (level_layout(level, levels, spec.decoder).planes, 2**level) for level in range(1, levels)
    ]
    assert network_outputs(spec) == wanted
