"""stillray: clean frames from Monte Carlo renders of one to a few samples per pixel."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from stillray.version import __version__

if TYPE_CHECKING:
    from stillray.batch.api import ShotOptions, denoise_shot
    from stillray.errors import Cancelled, InputError
    from stillray.frame import Frame
    from stillray.io.exr.read import read_exr
    from stillray.io.exr.write import write_exr
    from stillray.models.registry import list_models
    from stillray.pipeline.denoiser import Denoiser, denoise

__all__ = [
    "Cancelled",
    "Denoiser",
    "Frame",
    "InputError",
    "ShotOptions",
    "__version__",
    "denoise",
    "denoise_shot",
    "list_models",
    "read_exr",
    "write_exr",
]

# Names are fetched when first used: importing the package loads neither NumPy nor OpenCV.
_HOME = {
    "Cancelled": "stillray.errors",
    "Denoiser": "stillray.pipeline.denoiser",
    "Frame": "stillray.frame",
    "InputError": "stillray.errors",
    "ShotOptions": "stillray.batch.api",
    "denoise": "stillray.pipeline.denoiser",
    "denoise_shot": "stillray.batch.api",
    "list_models": "stillray.models.registry",
    "read_exr": "stillray.io.exr.read",
    "write_exr": "stillray.io.exr.write",
}


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'stillray' has no attribute '{name}'")
    value = getattr(import_module(_HOME[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return __all__
