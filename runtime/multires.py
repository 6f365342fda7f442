"""stub"""
from __future__ import annotations
from stillray.models_spec.loader import FusedKernels
def level_planes(level: int, levels: int, options: FusedKernels) -> int:
    """Planes that the network gives at a level, 0 being the finest."""
    return 2 * len(options.kernel_sizes) + (0 if level == levels - 1 else 1)
