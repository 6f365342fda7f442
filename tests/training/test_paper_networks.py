"""Networks beside the text of their papers: layers, filters, branches, outputs and weights."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from math import prod

import pytest

torch = pytest.importorskip("torch")

from stillray.model_spec import load  # noqa: E402
from stillray.model_spec.network_weights import network_weights  # noqa: E402
from stillray_training.ablation import variants  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.multi_branch import multi_branch_net  # noqa: E402
from stillray_training.networks.repvgg import RepVGGBlock  # noqa: E402

FEATURES = 12  # the papers have ten: docs/differences.md
STUDY = {variant.name: variant for variant in variants.study()}


def network(name):
    spec = load(name)
    return FAMILIES[spec.family].network(spec)


def convolutions(module):
    """Of a network, ``(outputs, inputs, size)`` in the order in which they were made."""
    return [
        (one.out_channels, one.in_channels, one.kernel_size[0])
        for one in module.modules()
        if isinstance(one, torch.nn.Conv2d)
    ]


def blocks(module):
    return [one for one in module.modules() if isinstance(one, RepVGGBlock)]


def weights(module):
    return sum(one.numel() for one in module.parameters())


def of_convolution(inputs, outputs, *sizes):
    """Weights of convolutions side by side, a bias each."""
    return sum(inputs * outputs * size**2 + outputs for size in sizes)


def test_wskp_6_is_six_blocks_of_three_convolutions_and_an_identity():
    # section 4.1: 1x1, 3x3, 5x5 and identity branches, after training one 5x5 convolution;
    # supplement 1.1: the identity only where outputs equal inputs;
    # section 5.3: six importance maps and as many of averaging weights
    widths = [FEATURES, 16, 16, 16, 16, 16, 12]
    made = network("wskp-6")
    assert [sorted(one.kernel_size[0] for one in block.branches()) for block in blocks(made)] == [
        [1, 3, 5]
    ] * 6
    assert [block.identity for block in blocks(made)] == [a == b for a, b in pairwise(widths)]
    assert convolutions(fuse(made)) == [(b, a, 5) for a, b in pairwise(widths)]
    assert weights(made) == sum(of_convolution(a, b, 5, 3, 1) for a, b in pairwise(widths))
    assert weights(fuse(made)) == sum(of_convolution(a, b, 5) for a, b in pairwise(widths))


def test_predicting_kernels_takes_169_outputs_and_nearly_three_times_the_weights():
    # section 3: 169 kernels of the last layer; section 7.1: nearly 3x larger, without its branches
    ours, peer = (fuse(one.family.network(one.spec)) for one in (STUDY["wskp-6"], STUDY["KP"]))
    assert [outputs for outputs, _, _ in convolutions(peer)] == [16] * 5 + [169]
    assert 2.5 < weights(peer) / weights(ours) < 3


def test_fused_predictions_take_a_kernel_of_each_size_and_its_share():
    # supplement 2.3: KP with the kernel fusion module, 3x3 to 13x13
    fusion = STUDY["KP-fusion"]
    made = fuse(fusion.family.network(fusion.spec))
    outputs = sum(size**2 for size in (3, 5, 7, 9, 11, 13)) + 6
    assert [count for count, _, _ in convolutions(made)] == [16] * 5 + [outputs]


def test_without_branches_the_convolutions_are_those_that_run():
    # table 5, "w/o": plain 5x5 convolutions, of as many weights as the fused ones
    for name in ("wskp-6", "KP"):
        plain, branched = STUDY[f"{name}, no branches"], STUDY[name]
        made = plain.family.network(plain.spec)
        fused = fuse(branched.family.network(branched.spec))
        assert [one.kernel_size[0] for b in blocks(made) for one in b.branches()] == [5] * 6
        assert not any(block.identity for block in blocks(made))
        assert weights(made) == weights(fused)


def test_kp_1_and_kp_2_are_the_paper_s_smaller_predictors():
    # table 6: two layers and 13x13, five layers and 7x7
    for name, layers, size in (("KP-1", 2, 13), ("KP-2", 5, 7)):
        made = fuse(STUDY[name].family.network(STUDY[name].spec))
        assert [count for count, _, _ in convolutions(made)] == [16] * (layers - 1) + [size**2]


def test_the_paper_s_input_has_ten_planes():
    # section 5.1: displayed color with albedo, albedo, normal and depth
    spec = STUDY["wskp-6, the paper's input"].spec
    assert len(spec.network.features) == 10
    made = FAMILIES[spec.family].network(spec)
    assert convolutions(fuse(made))[0] == (16, 10, 5)
    assert weights(fuse(network("wskp-6"))) - weights(fuse(made)) == 2 * 16 * 25


def test_mr_kp_predicts_a_kernel_of_5x5_at_each_of_three_resolutions():
    # section 6.1: the same U-Net; 25 weights a pixel, and what the coarser level is blended by
    made = STUDY["MR-KP"].family.network(STUDY["MR-KP"].spec)
    assert [head.out_channels for head in made.heads] == [26, 26, 25]
    ours = network("wskp-mr")
    assert weights(made.encode) == weights(ours.encode)
    assert weights(made.decode) == weights(ours.decode)


@pytest.mark.parametrize(
    ("name", "grids", "spacing"), [("nbg-2x1", 1, 4), ("nbg-2x3", 3, 4), ("nbg-7x3", 3, 4)]
)
def test_grids_have_the_paper_s_resolutions(name, grids, spacing):
    # Fan et al. 2021, figure 6: 320x180x64 to 80x45x16 of 1280x720, each half of the one before
    decoder = load(name).decoder
    assert (decoder.grids, decoder.spacing, decoder.depth_spacing) == (grids, spacing, 4)
    finest, *coarser = (decoder.spacing << scale for scale in range(decoder.grids))
    assert (1280 // finest, 720 // finest, round(255 / decoder.depth_spacing)) == (320, 180, 64)
    if coarser:
        assert (1280 // coarser[-1], 720 // coarser[-1]) == (80, 45)


def test_wskp_3_is_three_such_blocks_and_as_they_are_in_the_study():
    # section 4.1 and supplement 1.1: half of the layers, the rest as wskp-6
    made, study = network("wskp-3"), STUDY["wskp-3"].family.network(STUDY["wskp-3"].spec)
    assert [sorted(one.kernel_size[0] for one in block.branches()) for block in blocks(made)] == [
        [1, 3, 5]
    ] * 3
    assert [block.identity for block in blocks(made)] == [False, True, False]
    for fused in (fuse(made), fuse(study)):
        assert convolutions(fused) == [(16, FEATURES, 5), (16, 16, 5), (12, 16, 5)]
    six, three = load("wskp-6"), load("wskp-3")
    alike = ("inputs", "demodulate", "transfer", "temporal", "decoder", "training")
    assert [getattr(three, part) for part in alike] == [getattr(six, part) for part in alike]


def test_wskp_3s_works_on_squares_of_pixels():
    # twelve logits for each of four pixels
    assert convolutions(fuse(network("wskp-3s"))) == [(32, 8, 6), (32, 32, 3), (48, 32, 3)]
    assert len(blocks(network("wskp-3s"))) == 3


def test_wskp_mr_is_a_u_net_with_a_head_at_each_of_three_resolutions():
    # section 5.2 and supplement 1.2: three resolutions, a layer more at each, which gives the
    # importance of kernels of 3x3 and 5x5, their shares, and what the coarser level is blended by
    spec = load("wskp-mr")
    assert spec.decoder.kernel_sizes == (3, 5)
    made = network("wskp-mr")
    features = torch.zeros(1, FEATURES, 16, 24)
    assert [tuple(one.shape[1:]) for one in made(features)] == [
        (5, 16, 24), (5, 8, 12), (4, 4, 6),
    ]  # fmt: skip
    strides = [one for one in made.modules() if getattr(one, "stride", 1) == (2, 2)]
    assert len(strides) == 2
    assert weights(fuse(made)) == 144_094


@pytest.mark.parametrize(("name", "grids"), [("nbg-2x1", 1), ("nbg-2x3", 3)])
def test_the_small_guide_net_is_two_layers_of_twenty_filters_and_the_maps(name, grids):
    # figure 2, left, and section 4.1: 5x5; three guides and two weights, one guide of one grid
    maps = 2 * grids - 1
    assert convolutions(fuse(network(name))) == [(20, FEATURES, 5), (maps, 20, 5)]
    assert weights(fuse(network(name))) == of_convolution(FEATURES, 20, 5) + of_convolution(
        20, maps, 5
    )


def test_the_large_guide_net_has_a_dense_block_of_five_layers():
    # figure 2, right, and section 4.1: seven layers of 5x5, five of which see all before them
    made = fuse(network("nbg-7x3"))
    entry, *dense, last = convolutions(made)
    assert entry == (20, FEATURES, 5)
    assert dense == [(10, 20 + 10 * before, 5) for before in range(5)]
    assert last == (5, 70, 5)
    assert weights(made) == sum(of_convolution(a, b, size) for b, a, size in convolutions(made))


def test_partial_convolutions_have_the_paper_s_weights_and_full_ones_more():
    spec = load("munet-x2")
    full = dataclasses.replace(spec, network=dataclasses.replace(spec.network, partial=False))
    assert weights(fuse(multi_branch_net(spec))) == 644_537  # table 3: 0.644 million
    # table 5 has 1.05 million: docs/differences.md
    assert weights(fuse(multi_branch_net(full))) == 1_958_489


def test_the_network_that_learns_online_has_30_thousand_weights():
    # section 4.4: two poolings, 8, 16, 32, 16 and 8 filters of 3x3, and 1x1 to six parameters
    shapes = [shape for _, shape in network_weights(load("online")) if len(shape) == 4]
    assert [shape[0] for shape in shapes] == [8, 8, 16, 16, 32, 32, 16, 16, 8, 8, 6]
    assert [shape[2] for shape in shapes] == [3] * 10 + [1]
    biases = sum(shape[0] for shape in shapes)
    assert round(sum(prod(shape) for shape in shapes) + biases, -4) == 30_000
