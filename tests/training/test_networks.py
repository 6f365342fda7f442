from __future__ import annotations

import dataclasses

import pytest

torch = pytest.importorskip("torch")

from stillray.families import pyramid_logits as pyramid_layout  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.importance import ImportanceNet  # noqa: E402
from stillray_training.networks.repvgg import (  # noqa: E402
    RepVGGBlock,
    by_branches,
    without_branches,
)


@pytest.mark.parametrize(("width_in", "width_out"), [(5, 5), (5, 8)])
def test_block_s_one_convolution_equals_its_branches(width_in, width_out):
    torch.manual_seed(0)
    block = RepVGGBlock(width_in, width_out, (5, 3, 1), identity=True, activation=True).double()
    assert block.identity == (width_in == width_out)
    image = torch.randn(2, width_in, 9, 7, dtype=torch.float64)
    merged = block(image)
    with by_branches(block):
        torch.testing.assert_close(merged, block(image))


def test_block_s_gradients_equal_those_of_its_branches():
    torch.manual_seed(0)
    block = RepVGGBlock(4, 4, (5, 3, 1), identity=True, activation=True).double()
    image = torch.randn(1, 4, 6, 6, dtype=torch.float64)
    merged = torch.autograd.grad(block(image).square().sum(), list(block.parameters()))
    with by_branches(block):
        branches = torch.autograd.grad(block(image).square().sum(), list(block.parameters()))
    for one, other in zip(merged, branches, strict=True):
        torch.testing.assert_close(one, other)


@pytest.mark.parametrize("name", ["wskp-3s", "wskp-6", "kpyr-5", "kpyr-5s", "nbg-7x3", "wskp-mr"])
def test_fused_network_equals_the_trained_one_which_stays_as_it_was(name):
    torch.manual_seed(0)
    spec = load(name)
    network = FAMILIES[spec.family].network(spec).double()
    before = {key: value.clone() for key, value in network.state_dict().items()}
    fused = fuse(network)
    features = torch.randn(1, len(spec.network.features), 32, 48, dtype=torch.float64)
    with by_branches(network):
        torch.testing.assert_close(fused(features), network(features))
    for parameter in fused.parameters():
        parameter.data.zero_()
    for key, value in network.state_dict().items():
        torch.testing.assert_close(value, before[key])


def test_fused_networks_differ_in_depth_and_have_one_convolution_a_block():
    for name, sizes in (("wskp-3s", [6, 3, 3]), ("wskp-6", [5] * 6)):
        layers = list(fuse(ImportanceNet(load(name))).modules())
        convolutions = [layer for layer in layers if isinstance(layer, torch.nn.Conv2d)]
        assert [layer.kernel_size for layer in convolutions] == [(size, size) for size in sizes]
        assert not isinstance(layers[-1], torch.nn.ReLU)


def test_blocks_have_kernel_sizes_of_their_own():
    spec = load("wskp-6")
    spec = dataclasses.replace(
        spec, network=dataclasses.replace(spec.network, widths=(16, 16), kernel_sizes=(5, 3, 1))
    )
    network = ImportanceNet(spec)
    sizes = [[one.kernel_size[0] for one in block.branches()] for block in network.blocks]
    assert sizes == [[5, 3, 1], [3, 1], [1]]
    fused = [layer for layer in fuse(network).modules() if isinstance(layer, torch.nn.Conv2d)]
    assert [layer.kernel_size for layer in fused] == [(5, 5), (3, 3), (1, 1)]
    alone = [len(block.branches()) for block in ImportanceNet(without_branches(spec)).blocks]
    assert alone == [1, 1, 1]


def test_a_block_that_works_on_squares_of_pixels_sees_all_of_them_and_their_neighbours():
    torch.manual_seed(0)
    block = RepVGGBlock(3, 12, (3, 1), identity=True, activation=False, block=2).double()
    assert block.identity
    fused = fuse(torch.nn.Sequential(block))[0]
    assert (fused.kernel_size, fused.stride, fused.padding) == ((6, 6), (2, 2), (2, 2))
    image = torch.randn(1, 3, 8, 12, dtype=torch.float64, requires_grad=True)
    given = block(image)
    assert given.shape == (1, 12, 4, 6)
    given[0, :, 2, 3].sum().backward()
    seen = image.grad.abs().sum((0, 1)) > 0
    expected = torch.zeros(8, 12, dtype=torch.bool)
    expected[2:8, 4:10] = True
    assert torch.equal(seen, expected)
    with by_branches(block), torch.no_grad():
        torch.testing.assert_close(fused(image), block(image))
        for branch in block.branches():
            torch.nn.init.zeros_(branch.weight)
            torch.nn.init.zeros_(branch.bias)
        # what is left is the pixels themselves, four planes for one
        torch.testing.assert_close(torch.pixel_shuffle(block(image), 2), image)


def test_plain_variant_fuses_to_the_same_shape_with_fewer_weights_in_training():
    spec = load("wskp-6")
    plain = without_branches(spec)
    assert dataclasses.replace(plain, network=spec.network) == spec
    full, bare = ImportanceNet(spec), ImportanceNet(plain)
    count = [sum(p.numel() for p in network.parameters()) for network in (full, bare)]
    assert count[0] > count[1]
    assert [p.shape for p in fuse(full).parameters()] == [p.shape for p in fuse(bare).parameters()]


def test_pyramid_gives_a_map_a_level_and_starts_unresolved():
    spec = load("kpyr-5")
    network = FAMILIES[spec.family].network(spec)
    features = torch.zeros(2, len(spec.network.features), 32, 48)
    maps = network(features)
    assert [tuple(level.shape[2:]) for level in maps] == [(32 >> i, 48 >> i) for i in range(5)]
    resolve = pyramid_layout.level_layout(0, 5, spec.decoder).resolve
    assert float(maps[0][:, resolve].mean()) < -2


def test_a_pyramid_that_works_on_blocks_gives_four_planes_for_one_and_the_blocks_own():
    spec = load("kpyr-5s")
    network = FAMILIES[spec.family].network(spec)
    features = torch.zeros(2, len(spec.network.features), 32, 48)
    maps = network(features)
    assert [tuple(level.shape[2:]) for level in maps] == [(16, 24)] + [
        (32 >> i, 48 >> i) for i in range(1, 5)
    ]
    planes = [pyramid_layout.level_logits(level, 5, spec.decoder) for level in range(5)]
    assert [level.shape[1] for level in maps] == [4 * planes[0], *planes[1:]]
    resolve = pyramid_layout.level_layout(0, 5, spec.decoder).resolve
    assert float(torch.pixel_shuffle(maps[0], 2)[:, resolve].mean()) < -2


def test_every_pixel_of_a_block_sees_its_neighbours():
    spec = load("kpyr-5s")
    entry = FAMILIES[spec.family].network(spec).enter[0]
    features = torch.zeros(1, len(spec.network.features), 16, 16)
    inside = []
    for column in range(16):
        features[..., 8, column] = 1
        changed = (entry(features) != entry(torch.zeros_like(features))).any(1)[0, 4]
        inside.append(changed.nonzero().flatten().tolist())
        features.zero_()
    # block 4 stands for columns 8 and 9, and looks from 7 to 10
    assert [column for column in range(16) if 4 in inside[column]] == [7, 8, 9, 10]
