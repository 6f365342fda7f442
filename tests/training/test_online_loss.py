"""What the loss of the model that learns while it denoises teaches, of a view that stands still."""

import pytest

torch = pytest.importorskip("torch")

from stillray.families.online import THINNED  # noqa: E402
from stillray.models.registry import find_model  # noqa: E402
from stillray_export.online import layout_of  # noqa: E402
from stillray_training.decoders.cross_bilateral import cross_bilateral  # noqa: E402
from stillray_training.networks.filter_parameters import (  # noqa: E402
    filter_parameters,
    split,
    start,
)
from stillray_training.online.step import LOSS_EPSILON, Learning, train_step  # noqa: E402

_SIZE = 24
_INSIDE = torch.ones(1, 1, _SIZE, _SIZE)
_RATE = 5e-3  # many times the model's: 32 frames are enough


def pictures(frames, how):
    """Pilots that accumulate, filtered, blended and learned from.

    Yields
    ------
    share : float
        Mean share of the frame in the picture.
    error : float
        Mean square.
    """
    generator = torch.Generator().manual_seed(0)
    row, column = torch.meshgrid(torch.arange(_SIZE), torch.arange(_SIZE), indexing="ij")
    clean = (0.3 + 0.4 * ((row // 6 + column // 6) % 2)).expand(3, _SIZE, _SIZE)
    weights = start(how.layout, 1)[None]
    state = (weights, torch.zeros_like(weights), torch.zeros_like(weights))
    # of pilots, and of what explains them, whose noise they have not
    noise, guides = torch.zeros(2, 2, 3, _SIZE, _SIZE), torch.full((6, _SIZE, _SIZE), 0.5)
    picture = torch.zeros(3, _SIZE, _SIZE)
    rate = torch.tensor([_RATE])
    for count in range(1, frames + 1):
        noise += 0.6 * torch.randn(noise.shape, generator=generator)
        both, halves = (clean + noise / count).clamp_min(0).reshape(2, 6, _SIZE, _SIZE)
        features = torch.cat([both, guides, picture])[None]
        theta = filter_parameters(split(state[0][0], how.layout), features)[0]
        filtered, _ = cross_bilateral(both, guides, _INSIDE[0], theta, thinned=THINNED)
        share = torch.sigmoid(theta[5]) if count > 1 else torch.ones(_SIZE, _SIZE)
        picture = torch.lerp(picture, filtered.mean(0), share)
        yield float(share.mean()), float(((picture - clean) ** 2).mean())
        step = torch.tensor([float(count)])
        _, *state = train_step(*state, step, rate, features, halves[None], _INSIDE, how)


def test_a_still_view_does_not_freeze():
    """The last picture holds the pilots' own samples: a loss that it has a share in would learn to
    show nothing else: the share became 0, and the picture froze."""
    layout = layout_of(find_model("online").spec)
    how = Learning(layout=layout, loss_epsilon=LOSS_EPSILON, thinned=THINNED)
    shares, errors = zip(*pictures(32, how), strict=True)
    assert min(shares) > 0.4
    assert errors[31] < 0.7 * errors[23] < 0.7 * 0.7 * errors[15] < 0.7**2 * errors[7]
