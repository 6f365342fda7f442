from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.arrays.strips import Strips  # noqa: E402
from stillray.families import bilateral_grid as grid  # noqa: E402
from stillray.model_spec import load  # noqa: E402
from stillray_training.decoders.bilateral_grids import Tent, bilateral_grids  # noqa: E402
from stillray_training.families import FAMILIES  # noqa: E402
from stillray_training.networks.fuse import fuse  # noqa: E402
from stillray_training.networks.guide import GuideNet  # noqa: E402
from tests import oracles  # noqa: E402
from tests.families.test_bilateral_grid import ROUNDING, draw  # noqa: E402

OPTIONS = load("nbg-2x3").decoder


def decode(mean, maps, options=OPTIONS, kind=torch.float64):
    planes = torch.from_numpy(mean.transpose(2, 0, 1).copy())[None].to(kind)
    maps = torch.from_numpy(maps)[None].to(kind)
    image = bilateral_grids(planes[:, :3], planes[:, 3:], maps, options)
    return image[0].permute(1, 2, 0).numpy()


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (17, 18)])
def test_decoder_equals_the_loop_oracle(size):
    mean, maps = draw(*size, OPTIONS)
    mean[size[0] // 2, :, 3] = 0
    expected = oracles.bilateral_grids(mean, maps, OPTIONS)
    np.testing.assert_allclose(decode(mean, maps), expected, rtol=1e-9)


def test_decoder_equals_the_runtime_over_several_strips():
    mean, maps = draw(100, 900, OPTIONS)
    got = grid.filter_grids(mean, maps, OPTIONS, Strips(1))
    np.testing.assert_allclose(got, decode(mean, maps), atol=ROUNDING * mean[..., :3].max())


def test_images_of_a_batch_do_not_mix():
    draws = [draw(9, 14, OPTIONS, seed) for seed in (0, 1)]
    planes = torch.from_numpy(np.stack([mean.transpose(2, 0, 1) for mean, _ in draws])).double()
    maps = torch.from_numpy(np.stack([maps for _, maps in draws])).double()
    both = bilateral_grids(planes[:, :3], planes[:, 3:], maps, OPTIONS)
    for image, (mean, alone) in zip(both, draws, strict=True):
        np.testing.assert_allclose(image.permute(1, 2, 0), decode(mean, alone), rtol=1e-12)


def test_gradients_equal_finite_differences():
    torch.manual_seed(0)
    height, width = 7, 6
    light = torch.rand(1, 3, height, width, dtype=torch.float64, requires_grad=True)
    samples = torch.rand(1, 1, height, width, dtype=torch.float64) + 0.1
    maps = torch.rand(1, 5, height, width, dtype=torch.float64)
    # guides near each other, so that pixels meet, but away from cells, where the tent has its tip
    for scale in range(3):
        spacing = OPTIONS.depth_spacing * 2**scale / 255
        place = torch.randint(8, 10, (height, width)) + 0.2 + 0.6 * maps[0, scale]
        maps[0, scale] = place * spacing
    maps.requires_grad_()
    assert torch.autograd.gradcheck(
        lambda light, maps: bilateral_grids(light, samples, maps, OPTIONS),
        (light, maps),
        atol=1e-6,
        rtol=1e-5,  # e / 2 a^2 of the rounded tip, at a = 0.2
    )


def test_the_tent_is_exact_and_its_slope_rounded_at_the_tip():
    part = torch.tensor([0.0, 1e-3, 0.5], dtype=torch.float64, requires_grad=True)
    near, far = Tent.apply(part)
    assert torch.equal(near, 1 - part)
    assert torch.equal(far, part)
    slope = torch.autograd.grad(near.sum(), part)[0]
    expected = -part / (part**2 + 1e-7).sqrt()
    torch.testing.assert_close(slope, expected.detach())
    assert slope[0] == 0


def test_pixels_that_hold_nothing_leave_gradients_finite():
    mean, maps = draw(9, 14, OPTIONS)
    planes = torch.from_numpy(mean.transpose(2, 0, 1).copy())[None]
    given = torch.from_numpy(maps)[None].requires_grad_()
    bilateral_grids(planes[:, :3], planes[:, 3:] * 0, given, OPTIONS).sum().backward()
    assert (given.grad == 0).all()


@pytest.mark.parametrize(("name", "layers", "maps"), [
    ("nbg-2x1", 2, 1), ("nbg-2x3", 2, 5), ("nbg-7x3", 7, 5),
])  # fmt: skip
def test_guide_nets_have_their_layers_and_end_in_a_sigmoid(name, layers, maps):
    torch.manual_seed(0)
    spec = load(name)
    fused = fuse(GuideNet(spec))
    convolutions = [part for part in fused.modules() if isinstance(part, torch.nn.Conv2d)]
    assert len(convolutions) == layers
    assert all(part.kernel_size == (5, 5) for part in convolutions)
    given = fused(1e3 * torch.randn(1, len(spec.network.features), 9, 14))
    assert given.shape == (1, maps, 9, 14)
    assert given.min() >= 0
    assert given.max() <= 1
    assert FAMILIES[spec.family].network is GuideNet
