"""stillray: clean frames from Monte Carlo renders of one to a few samples per pixel."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from stillray.denoiser import Denoiser, denoise
    from stillray.errors import InputError
    from stillray.exr import read_exr, write_exr
    from stillray.frame import Frame
    from stillray.registry import list_models

__version__ = "0.1.0"
__all__ = [
    "Denoiser",
    "Frame",
    "InputError",
    "denoise",
    "list_models",
    "read_exr",
    "write_exr",
]

# Names are fetched when first used: importing the package loads neither NumPy nor OpenCV.
_HOME = {
    "Denoiser": "stillray.denoiser",
    "Frame": "stillray.frame",
    "InputError": "stillray.errors",
    "denoise": "stillray.denoiser",
    "list_models": "stillray.registry",
    "read_exr": "stillray.exr",
    "write_exr": "stillray.exr",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'stillray' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
