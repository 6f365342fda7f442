"""Networks beside the text of their papers: layers, filters, branches, outputs and weights."""

from __future__ import annotations

import dataclasses
from itertools import pairwise
from math import prod

import pytest

torch = pytest.importorskip("torch")

from stillray.families import cross_bilateral  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray.model_spec.network_outputs import network_outputs  # noqa: E402
from stillray.model_spec.network_weights import network_weights  # noqa: E402
from stillray_training.ablation import variants  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.networks.filter_parameters import filter_parameters, split  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.multi_branch import (  # noqa: E402
    MultiBranchBlock,
    Residual,
    multi_branch_net,
)
from stillray_training.networks.repvgg import RepVGGBlock  # noqa: E402
from stillray_training.online import step  # noqa: E402

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


@pytest.mark.parametrize("name", ["wskp-6", "wskp-3", "wskp-3s"])
def test_six_kernels_of_3x3_to_13x13_are_fused(name):
    # section 5.3: the first 3, then 2 more each; a map and an averaging weight for every one
    spec = load(name)
    assert spec.decoder.kernel_sizes == tuple(range(3, 14, 2))
    assert network_outputs(spec) == [(12 * spec.network.block**2, spec.network.block)]


@pytest.mark.parametrize("name", ["wskp-6", "wskp-3"])
def test_a_relu_follows_every_block_but_the_last(name):
    # section 4.1: added, then a ReLU; importance is of any sign (eq. 3)
    assert [block.activation for block in blocks(network(name))][:-1] == [True] * (
        len(blocks(network(name))) - 1
    )
    assert not blocks(network(name))[-1].activation


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


@pytest.mark.parametrize("name", ["munet-x1", "munet-x2"])
def test_munet_has_two_branches_in_three_levels_of_encoder_and_decoder(name):
    # section 3.3: 2x2 convolutions 2 apart into every level, the first one too; blocks of half of
    # the channels but in the first of the encoder and the last of the decoder; 1x1 where widths
    # differ; planes by 1x1 of what both branches say, at three scales and the picture's
    spec = load(name)
    made = multi_branch_net(spec)
    wide, narrow = spec.network.radiance_widths, spec.network.guide_widths
    assert (len(wide), len(narrow)) == (3, 3)
    assert all(guide < light for guide, light in zip(narrow, wide, strict=True))
    for entries, inputs, widths in (
        (made.enter, len(spec.network.radiance), wide),
        (made.enter_guides, len(spec.network.guides), narrow),
    ):
        assert convolutions(entries) == [(b, a, 2) for a, b in pairwise((inputs, *widths))]
        assert {one.stride for one in entries} == {(2, 2)}
    for level in (*made.encode, *made.decode):
        assert isinstance(level, MultiBranchBlock)
        assert convolutions(level.merge)[0][2] == 1
    for side in (made.encode, made.decode):
        shares = [block.residual.convolved / width for block, width in zip(side, wide, strict=True)]
        assert shares == [1, 0.5, 0.5]
        guided = [block.guide.convolved / width for block, width in zip(side, narrow, strict=True)]
        assert guided == [1, 0.5, 0.5]
    # the radiance branch has more convolutions, and wider ones
    assert [len(blocks(part)) for part in (made.encode[0].residual, made.encode[0].guide)] == [2, 1]
    assert isinstance(made.encode[0].residual, Residual)
    both = [a + b for a, b in zip(wide, narrow, strict=True)]
    planes = [count for count, _ in network_outputs(spec)]
    assert convolutions(made.heads) == [
        (count, width, 1) for count, width in zip(planes, (both[0], *both), strict=True)
    ]


@pytest.mark.parametrize("name", ["munet-x1", "munet-x2"])
def test_munet_s_branches_read_what_the_paper_s_do(name):
    # section 3.2: color and its past; diffuse and specular albedo, normal, roughness and theirs;
    # counts of accumulated samples as sines
    network = load(name).network
    light, guides = network.radiance, network.guides

    def of(planes):
        return {plane.split(".")[0] for plane in planes}

    assert {"color", "past", "output"} <= of(light)
    assert {"albedo", "specular", "normal", "roughness", "past_albedo", "past_specular"} <= of(
        guides
    )
    assert sum(plane.startswith("past.count") for plane in light) == 4
    assert not {"normal", "albedo", "specular", "roughness"} & of(light)
    assert "color" not in of(guides)


def test_the_guides_multiply_what_the_radiance_branch_adds():
    # section 3.3: merged to the residual features by an element-wise multiplication
    spec = load("munet-x2")
    torch.manual_seed(0)
    block = MultiBranchBlock(8, 4, spec.network, partial=False)
    light, guides = torch.randn(1, 8, 6, 6), torch.randn(1, 4, 6, 6)
    got, kept = block(light, guides)
    torch.testing.assert_close(got, (light + block.residual(light) * block.merge(kept)).relu())


def test_the_network_that_learns_online_is_a_u_net_of_two_poolings():
    # section 4.2 and 4.4: both pilots, textures, normals and the last output; a maximum of 2x2,
    # twice, and back; six parameters a pixel
    spec = load("online")
    kinds = [plane.split(".")[0] for plane in spec.network.features]
    assert [kinds.count(kind) for kind in dict.fromkeys(kinds)] == [3] * 5
    assert list(dict.fromkeys(kinds)) == ["pilot_a", "pilot_b", "albedo", "normal", "previous"]
    layout = network_weights(spec)
    assert network_weights(load("online-warm")) == layout
    count = sum(prod(shape) for _, shape in layout)
    torch.manual_seed(0)
    weights = split(torch.randn(count) / 20, layout)
    poolings = []

    class Counting(step.Differentiable):
        def pool(self, planes):
            poolings.append(tuple(planes.shape[2:]))
            return super().pool(planes)

    given = filter_parameters(weights, torch.randn(1, 15, 16, 24), Counting())
    assert given.shape == (1, 6, 16, 24)
    assert poolings == [(16, 24), (8, 12)]


def test_what_learns_online_has_the_paper_s_window_and_steps():
    # sections 4.2 and 4.4: windows of 11x11 for the filter; one step of Adam a frame. Its rate and
    # windows of the regression, 0.001 and 17x17, are docs/differences.md's
    assert cross_bilateral.WINDOW == 11
    for name in ("online", "online-warm"):
        spec = load(name)
        assert any("the rate is 1e-3" in line for line in spec.differs)
        assert spec.training.steps == 1
    assert step.BETAS == (0.9, 0.999)


def test_the_pyramids_have_their_levels_and_weights():
    # no paper has them: what the page of differences says of them
    for name, levels, count in (("kpyr-5", 5, 830_496), ("kpyr-5s", 5, 272_662)):
        spec = load(name)
        made = network(name)
        assert len(network_outputs(spec)) == levels
        assert weights(fuse(made)) == count


def test_the_network_that_learns_online_has_30_thousand_weights():
    # section 4.4: two poolings, 8, 16, 32, 16 and 8 filters of 3x3, and 1x1 to six parameters
    shapes = [shape for _, shape in network_weights(load("online")) if len(shape) == 4]
    assert [shape[0] for shape in shapes] == [8, 8, 16, 16, 32, 32, 16, 16, 8, 8, 6]
    assert [shape[2] for shape in shapes] == [3] * 10 + [1]
    biases = sum(shape[0] for shape in shapes)
    assert round(sum(prod(shape) for shape in shapes) + biases, -4) == 30_000
