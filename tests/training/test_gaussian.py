"""The filter by feature distances with a gradient of its own, against the definition's."""

from __future__ import annotations

import pytest
import torch

from stillray.families.gaussian import MOST_DISTANCE
from stillray_training.decoders.gaussian import gaussian

SHAPES = [
    ((2, 3, 5, 6), 1),
    ((1, 3, 7, 9), 2),
    ((1, 1, 1, 4), 1),
    ((1, 2, 4, 1), 2),
    ((1, 2, 3, 3), 4),
]


def arguments(shape: tuple[int, ...]) -> list[torch.Tensor]:
    n, _, h, w = shape
    made = torch.Generator().manual_seed(1)
    values, features = torch.randn(shape, generator=made), torch.randn(n, 4, h, w, generator=made)
    weight, own = torch.rand(2, n, 1, h, w, generator=made) + 0.1
    return [part.double() for part in (values, features, weight, own)]


@pytest.mark.parametrize(("shape", "distance"), SHAPES)
def test_it_is_the_definition(shape: tuple[int, ...], distance: int) -> None:
    given = arguments(shape)
    with torch.no_grad():
        expected = gaussian(*given, distance)
    found = gaussian(*(part.requires_grad_() for part in given), distance)
    torch.testing.assert_close(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("shape", "distance"), SHAPES)
def test_its_gradient_is_that_of_differences(shape: tuple[int, ...], distance: int) -> None:
    given = [part.requires_grad_() for part in arguments(shape)]
    assert torch.autograd.gradcheck(lambda *parts: gaussian(*parts, distance), given)


def test_pixels_as_far_apart_as_can_be_pull_at_no_feature() -> None:
    values, features, weight, own = arguments((1, 1, 1, 2))
    features = (MOST_DISTANCE * features).requires_grad_()
    assert (features[..., 0] - features[..., 1]).square().sum() > MOST_DISTANCE
    gaussian(values, features, weight, own).sum().backward()
    assert features.grad is not None
    assert not features.grad.any()
