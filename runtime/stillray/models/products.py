"""Products of many small matrices, by ONNX Runtime.

NumPy asks BLAS for each of them, which takes longer to begin than to multiply: for 183 products of
10x289 and 289x13 two to three times as long.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from stillray.models.session import CPU, session_options

#: Comes with stillray; `stillray_export.products` writes it.
FILE = Path(__file__).with_name("steps") / "products.onnx"


def products(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Sums over the last axis, in this thread.

    Parameters
    ----------
    first : (n, i, p) float32
    second : (n, j, p) float32

    Returns
    -------
    (n, i, j) float32
        ``first @ second.transpose(0, 2, 1)``.
    """
    found: np.ndarray = _session().run(None, {"first": first, "second": second})[0]
    return found


@cache
def _session() -> Any:
    import onnxruntime as ort

    # one thread: callers run side by side
    return ort.InferenceSession(str(FILE), session_options(1), providers=[CPU])
