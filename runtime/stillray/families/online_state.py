"""The state of a model that learns while it denoises, as plain arrays that files hold."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from stillray.errors import InputError
from stillray.families.contract import State
from stillray.families.online_learning import Learned
from stillray.families.online_past import Past
from stillray.stages.history_rejection import Noise
from stillray.stages.state import History

_VECTORS = ("weights", "first", "second", "kept")
_PLANES = ("mean_a", "mean_b", "output")
_MOST_PIXELS = 2**16  # of a side
_MOST_LETTERS = 64  # of a name that is shown


def pack(state: State, model: str) -> dict[str, np.ndarray]:
    """A state as float32 arrays by name, of which `unpack` makes the same state.

    Numbers of steps are exact up to 2 ** 24.

    Parameters
    ----------
    state
        The state.
    model
        Name of the model whose it is.
    """
    arrays = {"shape": np.array(state.shape, np.float32), "model": _letters(model)}
    if isinstance(state.learned, Learned):
        learned = state.learned
        arrays |= {name: getattr(learned, name) for name in _VECTORS}
        arrays["steps"] = np.array([learned.steps, learned.adam_steps], np.float32)
    if not isinstance(state.temporal, Past):
        return arrays
    past = state.temporal
    for name, history in (("a", past.first), ("b", past.second)):
        arrays[f"mean_{name}"] = history.mean
        arrays[f"exposure_{name}"] = _split(history.exposure)
        if history.frame_samples is not None:
            arrays[f"samples_{name}"] = _split(history.frame_samples)
        if (noise := history.noise) is not None:
            arrays[f"noise_{name}"] = noise.variance
            arrays[f"noise_exposure_{name}"] = _split(noise.exposure)
            arrays[f"noise_frames_{name}"] = np.array([noise.frames], np.float32)
    arrays |= {
        name: array
        for name, array in (
            ("output", past.first.output),
            ("guides", past.first.surface_guides),
            ("albedo", past.first.mean_albedo),
        )
        if array is not None
    }
    arrays["albedo_frames"] = np.array([past.first.mean_albedo_frames], np.float32)
    return arrays


def unpack(arrays: Mapping[str, np.ndarray], model: str, weights: int) -> State:
    """`pack` undone.

    Parameters
    ----------
    arrays
        Finite float32 arrays by name, of anybody.
    model
        Its name. Files of before names were kept have none: whose they are nobody knows, and they
        are taken for this one's, so that what was learned is not lost.
    weights
        How many the model has.

    Raises
    ------
    InputError
        The arrays are not those of a state of this model.
    """
    owner = arrays.get("model", _letters(model))
    if not np.array_equal(owner, _letters(model)):
        raise InputError(f"state must be one of {model}, got one of {_word(owner)}")
    shape = arrays.get("shape", np.empty(0, np.float32))
    if shape.shape != (2,) or not (shape >= 1).all() or not (shape <= _MOST_PIXELS).all():
        raise InputError(f"state must be one of {model}: it has no shape of a frame")
    height, width = (int(size) for size in shape)
    sizes: dict[str, tuple[int, ...]] = {name: (weights,) for name in _VECTORS}
    sizes |= {name: (height, width, 4) for name in (*_PLANES, "guides", "albedo")}
    sizes |= {"steps": (2,), "shape": (2,), "albedo_frames": (1,), "model": owner.shape}
    for half in "ab":
        sizes |= {f"{name}_{half}": (2,) for name in ("exposure", "samples", "noise_exposure")}
        # blocks of any size: the next frame begins anew where it has others
        noise = arrays.get(f"noise_{half}")
        if noise is not None and noise.ndim == 2 and noise.size <= height * width:
            sizes[f"noise_{half}"] = noise.shape
        sizes[f"noise_frames_{half}"] = (1,)
    for name, array in arrays.items():
        if array.shape != sizes.get(name):
            raise InputError(f"state must be one of {model}, got {name} of shape {array.shape}")
    return State(shape=(height, width), temporal=_past(arrays), learned=_learned(arrays))


def _letters(word: str) -> np.ndarray:
    """A word as numbers, since files hold nothing else."""
    return np.array([ord(letter) for letter in word], np.float32)


def _word(letters: np.ndarray) -> str:
    """`_letters` undone, as far as anybody's numbers are a word."""
    try:
        word = "".join(chr(int(letter)) for letter in letters.ravel()[:_MOST_LETTERS])
    except (ValueError, OverflowError):
        word = ""
    return word or "another model"


def _learned(arrays: Mapping[str, np.ndarray]) -> Learned | None:
    if not {*_VECTORS, "steps"} <= arrays.keys() or arrays["steps"].min() < 0:
        return None
    steps, adam_steps = (int(number) for number in arrays["steps"])
    vectors = {name: arrays[name] for name in _VECTORS}
    return Learned(steps=steps, adam_steps=adam_steps, **vectors)


def _past(arrays: Mapping[str, np.ndarray]) -> Past | None:
    if not {*_PLANES, "exposure_a", "exposure_b", "albedo_frames"} <= arrays.keys():
        return None
    frames = float(arrays["albedo_frames"][0])
    whole = all(_joined(arrays[f"exposure_{half}"]) > 0 for half in "ab") and frames >= 0
    # what a mean is worth, and its light
    whole = whole and all(arrays[name].min() >= 0 for name in _PLANES)
    if not whole:
        return None
    first, second = (
        History(
            mean=arrays[f"mean_{half}"],
            surface_guides=arrays.get("guides"),
            exposure=_joined(arrays[f"exposure_{half}"]),
            noise=_noise(arrays, half),
            output=arrays["output"],
            mean_albedo=arrays.get("albedo") if half == "a" else None,
            mean_albedo_frames=frames if half == "a" else 0.0,
            frame_samples=_positive(arrays, f"samples_{half}"),
        )
        for half in "ab"
    )
    return Past(first=first, second=second)


def _noise(arrays: Mapping[str, np.ndarray], half: str) -> Noise | None:
    exposure = _positive(arrays, f"noise_exposure_{half}")
    variance, frames = (arrays.get(f"{name}_{half}") for name in ("noise", "noise_frames"))
    if exposure is None or variance is None or frames is None:
        return None
    if variance.min() < 0 or frames[0] < 1:
        return None
    return Noise(variance=variance, exposure=exposure, frames=int(frames[0]))


def _positive(arrays: Mapping[str, np.ndarray], name: str) -> float | None:
    value = _joined(arrays[name]) if name in arrays else 0.0
    return value if value > 0 else None


def _split(number: float) -> np.ndarray:
    """A float64 in two float32, so that it goes on exactly as it was, but for its last bits."""
    high = np.float32(number)
    return np.array([high, number - float(high)], np.float32)


def _joined(parts: np.ndarray) -> float:
    return float(parts.astype(np.float64).sum())
