"""stillray: clean frames from Monte Carlo renders of one to a few samples per pixel."""

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
