from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from stillray.model_spec import load  # noqa: E402
from stillray_training.decoders.multires import blended, multi_resolution_kernels  # noqa: E402
from tests import oracles  # noqa: E402
from tests.families.test_multi_resolution import draw  # noqa: E402

DECODER = load("wskp-mr").decoder


def decode(mean, logits):
    planes = mean.permute(2, 0, 1)[None]
    return multi_resolution_kernels(planes[:, :3], planes[:, 3:], logits, DECODER)


@pytest.mark.parametrize("spread", [2.0, 1e4])
def test_decoder_equals_the_loop_oracle(spread):
    mean, logits = draw(12, 20, spread=spread)
    got = decode(
        torch.from_numpy(mean).double(), [torch.from_numpy(part[None]).double() for part in logits]
    )
    expected = oracles.multi_resolution_kernels(mean, logits, DECODER)
    np.testing.assert_allclose(got[0].permute(1, 2, 0).numpy(), expected, rtol=1e-9)


def test_decoder_s_gradient_equals_finite_differences():
    mean, logits = draw(4, 4, light=0.5)
    light = torch.from_numpy(mean).double()
    given = [torch.from_numpy(part[None]).double().requires_grad_() for part in logits]
    assert torch.autograd.gradcheck(lambda *maps: decode(light, maps), given)


def test_a_block_moves_to_the_coarser_level_and_keeps_its_detail():
    fine = torch.tensor([[[[4.0, 6.0], [5.0, 5.0]]]])
    half = torch.full_like(fine, 0.5)
    moved = blended(fine, torch.full((1, 1, 1, 1), 8.0), half)
    torch.testing.assert_close(moved, fine + 1.5)


def test_what_leaves_the_range_is_held_at_its_end():
    fine = torch.zeros(1, 1, 2, 2)
    fine[..., 0, 0] = 8.0  # a firefly: the block's mean is 2
    one = torch.ones_like(fine)
    down = blended(fine, torch.full((1, 1, 1, 1), 1.0), one)  # eq. 7 says 7, and -1 elsewhere
    torch.testing.assert_close(down, torch.tensor([[[[7.0, 0.0], [0.0, 0.0]]]]))
    up = blended(fine, torch.full((1, 1, 1, 1), 4.0), one)  # 10, and 2 elsewhere
    torch.testing.assert_close(up, torch.tensor([[[[8.0, 2.0], [2.0, 2.0]]]]))
