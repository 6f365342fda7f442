"""Slow loop oracles in float64: the definitions, written as the papers write them."""

from __future__ import annotations

import numpy as np

from stillray.models_spec.loader import FusedKernels, Temporal


def fused_kernels(
    irradiance: np.ndarray, samples: np.ndarray, logits: np.ndarray, options: FusedKernels
) -> np.ndarray:
    """Fan et al. 2021, eq. 3 to 5, window by window with the maximum subtracted."""
    height, width = samples.shape
    count = len(options.kernel_sizes)
    bounded = np.clip(logits.astype(np.float64), -options.logit_bound, options.logit_bound)
    result = np.zeros((height, width, 3))
    for y in range(height):
        for x in range(width):
            alpha = np.exp(bounded[count:, y, x] - bounded[count:, y, x].max())
            alpha /= alpha.sum()
            for index, size in enumerate(options.kernel_sizes):
                half = size // 2
                rows = slice(max(y - half, 0), y + half + 1)
                columns = slice(max(x - half, 0), x + half + 1)
                logit = bounded[index, rows, columns]
                weight = np.exp(logit - logit.max())
                if options.weigh_samples:
                    weight = weight * samples[rows, columns].astype(np.float64)
                weight /= weight.sum()
                window = irradiance[rows, columns].astype(np.float64)
                result[y, x] += alpha[index] * (weight[..., None] * window).sum((0, 1))
    return result


def reproject(
    history: np.ndarray,
    normal_before: np.ndarray,
    depth_before: np.ndarray,
    normal: np.ndarray,
    depth: np.ndarray,
    motion: np.ndarray,
    options: Temporal,
) -> np.ndarray:
    """Bilinear taps accepted one by one, a pixel at a time."""
    height, width = depth.shape
    result = np.zeros((height, width, 4))
    for y in range(height):
        for x in range(width):
            at_x, at_y = x + float(motion[y, x, 0]), y + float(motion[y, x, 1])
            if not (np.isfinite(at_x) and np.isfinite(at_y)):
                continue
            left, top = int(np.floor(at_x)), int(np.floor(at_y))
            total, weights = np.zeros(4), 0.0
            for ty in (top, top + 1):
                for tx in (left, left + 1):
                    weight = (1 - abs(at_x - tx)) * (1 - abs(at_y - ty))
                    if not (0 <= tx < width and 0 <= ty < height):
                        continue
                    hit, was_hit = normal[y, x].any(), normal_before[ty, tx].any()
                    if hit != was_hit:
                        continue
                    cosine = float(np.dot(normal[y, x], normal_before[ty, tx]))
                    if hit and cosine < options.normal_cosine:
                        continue
                    near, far = sorted([float(depth[y, x]), float(depth_before[ty, tx])])
                    if far > (1 + options.depth_ratio) * near:
                        continue
                    total += weight * history[ty, tx].astype(np.float64)
                    weights += weight
            if weights > 0:
                result[y, x, :3] = total[:3] / weights
                result[y, x, 3] = total[3]
    return result
