"""One call for one image, in the shape of pyoidn's."""

from __future__ import annotations

import ctypes
import os
import threading
from typing import Any

import numpy as np

from stillray.errors import InputError
from stillray.oidn import constants
from stillray.oidn.device import Device
from stillray.oidn.filtering import FILTER_TYPES, Parameters
from stillray.oidn.memory import is_tensor

_QUALITIES = ("high", "balanced", "fast", "default")
_lock = threading.Lock()
_device: Device | None = None


def denoise(
    color: Any,
    albedo: Any = None,
    normal: Any = None,
    *,
    hdr: bool = False,
    clean_aux: bool = False,
    quality: str | int = "high",
    filter_type: str = constants.OIDN_FILTER_TYPE_RT,
) -> Any:
    """Denoise one image. Models are loaded once; calls from several threads take turns.

    Parameters
    ----------
    color : (h, w, 3) float16 or float32
        A NumPy array, or a tensor of torch: linear, in [0, 1], or radiance with ``hdr``.
    albedo, normal : (h, w, 3), optional
        Of the same kind: in [0, 1] and in [-1, 1].
    hdr
        Whether color is radiance, 0 and more; always so with ``"RTLightmap"``.
    clean_aux
        Whether albedo has no noise: it is not filtered first.
    quality
        ``"high"``, ``"balanced"``, ``"fast"``, ``"default"``, or ``OIDN_QUALITY_*``.
    filter_type
        ``"RT"``, or ``"RTLightmap"``, which takes no albedo and no normal.

    Returns
    -------
    (h, w, 3)
        A new array or tensor of color's type, and on its device.

    Raises
    ------
    TypeError
        An image or an option is of a wrong type.
    ValueError
        Shapes differ, or options do not go together.
    RuntimeError
        It could not be denoised.

    Examples
    --------
    >>> import numpy as np
    >>> from stillray import oidn as pyoidn
    >>> pyoidn.denoise(np.full((4, 6, 3), 0.5, np.float32)).shape
    (4, 6, 3)
    """
    images = {"color": _host(color, "color", color)}
    for name, image in (("albedo", albedo), ("normal", normal)):
        if image is not None:
            images[name] = _host(image, name, color)
    if not isinstance(hdr, bool) or not isinstance(clean_aux, bool):
        raise TypeError(f"hdr and clean_aux must be bools, got {hdr!r} and {clean_aux!r}")
    if filter_type not in FILTER_TYPES:
        raise InputError(f"filter_type must be {' or '.join(FILTER_TYPES)}, got {filter_type}")
    if filter_type == constants.OIDN_FILTER_TYPE_RT_LIGHTMAP and (len(images) > 1 or clean_aux):
        raise InputError("albedo, normal and clean_aux must not be given with RTLightmap")
    model = _model(quality)
    parameters = Parameters(filter_type=filter_type, hdr=hdr, clean_aux=clean_aux)
    output = np.empty(images["color"].shape, images["color"].dtype)
    with _lock:
        device = _shared_device()
        device._run(images, output, parameters, model)
        error = device.get_error()
    if error is not None:
        raise RuntimeError(error)
    return color.detach().new_tensor(output) if is_tensor(color) else output


def _model(quality: str | int) -> str:
    if isinstance(quality, bool) or not isinstance(quality, str | int):
        raise TypeError(f"quality must be a name or an OIDN_QUALITY_* value, got {quality!r}")
    if isinstance(quality, int):
        if quality not in constants.QUALITY_NAMES:
            raise InputError(f"quality must be an OIDN_QUALITY_* value, got {quality}")
        return constants.QUALITY_NAMES[quality]
    if quality not in _QUALITIES:
        raise InputError(f"quality must be one of {', '.join(_QUALITIES)}, got {quality}")
    return "high" if quality == "default" else quality


def _host(image: Any, name: str, color: Any) -> np.ndarray:
    """An image as an array of the host, checked against color."""
    if isinstance(image, np.ndarray):
        array = image
    elif is_tensor(image):
        array = image.detach().cpu().numpy()
    else:
        raise TypeError(f"{name} must be a NumPy array or a tensor of torch, got {type(image)}")
    if is_tensor(image) != is_tensor(color):
        raise TypeError(f"{name} must be of color's kind {type(color)}, got {type(image)}")
    if is_tensor(image) and image.device != color.device:
        raise InputError(f"{name} must be on color's device {color.device}, got {image.device}")
    if array.dtype not in (np.float16, np.float32):
        raise TypeError(f"{name} must be float16 or float32, got {array.dtype}")
    if array.ndim != 3 or array.shape[2] != 3 or 0 in array.shape:
        raise InputError(f"{name} must have shape (height, width, 3), got {array.shape}")
    if array.shape != tuple(color.shape):
        raise InputError(f"{name} must have color's shape {tuple(color.shape)}, got {array.shape}")
    return array


def _shared_device() -> Device:
    global _device
    if _device is None:
        _device = Device()
        _device.commit()
    return _device


def _forget() -> None:
    """A child process has none of its parent's threads: it begins anew."""
    global _device, _lock
    if _device is not None:
        # never destroyed: ONNX Runtime would wait for threads that the child does not have
        ctypes.pythonapi.Py_IncRef(ctypes.py_object(_device))
    _device, _lock = None, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget)
