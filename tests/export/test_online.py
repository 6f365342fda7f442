"""The graphs of the model that learns while it denoises are what torch would compute."""

import cv2
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("onnx")

from stillray.errors import InputError  # noqa: E402
from stillray.families.filter_network import join  # noqa: E402
from stillray.families.filter_network import split as split_arrays  # noqa: E402
from stillray.families.online import THINNED  # noqa: E402
from stillray.families.online_learning import CROP  # noqa: E402
from stillray.models.network import Network  # noqa: E402
from stillray.models.onnx_file import parse_onnx  # noqa: E402
from stillray.models.registry import find_model, steps_of  # noqa: E402
from stillray_export.online import layout_of, mixed  # noqa: E402
from stillray_training.decoders.cross_bilateral import cross_bilateral  # noqa: E402
from stillray_training.networks.filter_parameters import (  # noqa: E402
    Differentiable,
    filter_parameters,
    split,
    start,
)
from stillray_training.online.step import (  # noqa: E402
    LOSS_EPSILON,
    Learning,
    loss,
    train_step,
)


@pytest.fixture(scope="module")
def model():
    return find_model("online")


@pytest.fixture(scope="module")
def network(model):
    engine = Network(model.path, threads=1, providers=None, steps=steps_of(model.family))
    yield engine
    engine.close()


def lesson(rng):
    """A part of a frame: smooth light and noise of both halves; some of it is beyond its edge."""

    def smooth():
        planes = cv2.resize(rng.random((8, 8, 3), np.float32), (CROP, CROP))
        return planes.transpose(2, 0, 1)

    light = smooth()
    noisy = [light + 0.2 * rng.random(light.shape) for _ in range(4)]
    inside = np.ones((1, 1, CROP, CROP), np.float32)
    inside[..., 100:] = 0
    valid = rng.random((1, CROP, CROP)) < 0.8
    features = np.concatenate([*noisy[:2], smooth(), smooth(), light * valid])
    return {
        "features": features[None].astype(np.float32),
        "halves": np.concatenate(noisy[2:])[None].astype(np.float32),
        "inside": inside,
    }


def test_steps_are_those_of_torch_in_float64(model, network, rng):
    """Twenty steps: weights whose slope is rounding must not go ways of their own."""
    layout = layout_of(model.spec)
    how = Learning(layout=layout, loss_epsilon=LOSS_EPSILON, thinned=THINNED)
    begun = start(layout, model.spec.training.seed)[None]
    state = [begun.double(), *[torch.zeros_like(begun).double()] * 2]
    arrays = [tensor.float().numpy() for tensor in state]
    for number in range(1, 21):
        crop = {**lesson(rng), "rate": np.array([1e-3], np.float32)}
        crop["step"] = np.array([number], np.float32)
        given = dict(zip(("weights", "first", "second"), arrays, strict=True))
        found = network.run("train_step", given | crop)
        arrays = [found[f"next_{name}"][None] for name in ("weights", "first", "second")]
        exact = {name: torch.from_numpy(array).double() for name, array in crop.items()}
        value, *state = train_step(*state, **exact, how=how)
        assert float(found["loss"]) == pytest.approx(float(value), rel=1e-5)
    apart = np.abs(arrays[0] - state[0].numpy())
    assert apart.max() < 1e-5
    assert np.abs(arrays[0] - begun.numpy()).max() > 1e-2


def test_slopes_are_those_of_finite_differences(model, rng):
    """In float64: of the loss as it is written, with respect to a few weights."""
    layout = layout_of(model.spec)
    how = Learning(layout=layout, loss_epsilon=LOSS_EPSILON, thinned=THINNED)
    weights = start(layout, 3).double()
    crop = {name: torch.from_numpy(a[..., :16, :16]).double() for name, a in lesson(rng).items()}
    given = (crop["features"], crop["halves"], crop["inside"])
    slopes = torch.func.grad(loss)(weights, *given, how)
    for index in (0, 1080, -50, -3, -1):
        step = torch.zeros_like(weights)
        step[index] = 1e-6
        change = loss(weights + step, *given, how) - loss(weights - step, *given, how)
        assert float(change) / 2e-6 == pytest.approx(float(slopes[index]), rel=1e-3, abs=1e-9)


def test_the_loss_is_of_the_other_half_s_pilot_and_of_a_half_s_own_samples(model, rng):
    """Pixel by pixel, as eq. 12 has it, two thirds and one third."""
    layout = layout_of(model.spec)
    how = Learning(layout=layout, loss_epsilon=LOSS_EPSILON, thinned=THINNED)
    weights = start(layout, 3).double()
    crop = {name: torch.from_numpy(a[..., 88:112]).double() for name, a in lesson(rng).items()}
    features, halves, inside = (crop[name] for name in ("features", "halves", "inside"))
    theta = filter_parameters(split(weights, layout), features)[0]
    planes = features[0]
    filtered, _ = cross_bilateral(planes[:6], planes[6:12], inside[0], theta, thinned=THINNED)
    pilots, own = (given.reshape(2, 3, CROP, 24).numpy() for given in (planes[:6], halves[0]))
    total = count = 0.0
    for y, x in np.argwhere(inside[0, 0].numpy() > 0):
        count += 1
        total += float(theta[-1, y, x]) ** 2
        for half in range(2):
            for wanted, share in ((pilots[1 - half], 2 / 3), (own[half], 1 / 3)):
                color = wanted[:, y, x]
                square = ((filtered[half, :, y, x].numpy() - color) ** 2).sum()
                total += share * square / ((color**2).sum() + 1e-2) / 2
    value = float(loss(weights, features, halves, inside, how))
    assert value == pytest.approx(total / count, rel=1e-9)


def test_learned_weights_take_the_place_of_those_in_the_file(model, network, rng):
    layout = layout_of(model.spec)
    features = lesson(rng)["features"][..., :20, :28]
    held = network.run("weights", {})
    assert list(held) == [name for name, _ in layout]
    other = start(layout, 99)
    for weights, given in (
        ({name: torch.tensor(array) for name, array in held.items()}, {}),
        (split(other, layout), split_arrays(other.numpy(), layout)),
    ):
        (found,) = network.run("network", {"features": features, **given}).values()
        for operators in (None, Differentiable()):
            wanted = filter_parameters(weights, torch.from_numpy(features), operators)
            np.testing.assert_allclose(found, wanted[0].numpy(), atol=1e-5)


def test_a_mean_with_the_weights_before_says_so():
    info = find_model("online-warm")
    before = join(parse_onnx(info.path.read_bytes()).graph.tensors, layout_of(info.spec))
    weights = torch.ones(len(before))
    mean, about = mixed(info.spec, weights, {"steps": 3}, 0.25)
    np.testing.assert_allclose(mean, 0.75 * before + 0.25, atol=1e-6)
    assert about["steps"] == 3
    assert about["started_from"]["share_of_its_weights"] == 0.75
    assert mixed(info.spec, weights, {}, 1.0) == (weights, {})
    with pytest.raises(InputError, match=r"share must be .*, got 1\.5"):
        mixed(info.spec, weights, {}, 1.5)
