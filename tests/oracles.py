"""Slow loop oracles in float64: the definitions, written as the papers write them."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np

from stillray.families.feature_reconstruction import Rules
from stillray.families.filter_layout import GaussianPlanes, level_layout, target_layout
from stillray.model_spec.decoders import BilateralGrids, FusedKernels, PyramidKernels
from stillray.model_spec.stages import Temporal
from stillray.stages import block_sums, lamps
from stillray.stages import relief as stage


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
            if options.most_blur:
                variances = [share * (1 - share) for share in (at_x - left, at_y - top)]
                blur = max(sum(variances), 1e-6)
                result[y, x, 3] = min(result[y, x, 3], options.most_blur / blur)
    return result


def cubic_weight(distance: float) -> float:
    """Cubic convolution (Keys 1981, eq. 4, with OpenCV's a = -0.75)."""
    d, a = abs(distance), -0.75
    if d <= 1:
        return (a + 2) * d**3 - (a + 3) * d**2 + 1
    return a * (d**3 - 5 * d**2 + 8 * d - 4) if d < 2 else 0.0


def accumulated_albedo(
    albedo: np.ndarray, past: np.ndarray, samples: float, positions: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What `albedo_history.accumulate` remembers and multiplies by, pixel by pixel."""
    height, width = albedo.shape[:2]
    result, remodulation_albedo = np.ones((height, width, 4)), np.zeros((height, width, 3))
    for y, x in np.ndindex(height, width):
        at_x, at_y = map(float, positions[y, x])
        left, top = int(np.floor(at_x)), int(np.floor(at_y))
        brought, inside = np.zeros(3), 0.0
        for ty, tx in itertools.product((top, top + 1), (left, left + 1)):
            if 0 <= ty < height and 0 <= tx < width:
                weight = (1 - abs(at_y - ty)) * (1 - abs(at_x - tx))
                brought += weight * past[ty, tx, :3].astype(np.float64)
                inside += weight
        around = albedo[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].reshape(-1, 3)
        red, green, blue = brought
        tints = np.array([(red - blue) / 2, green / 2 - (red + blue) / 4])
        near = around.astype(np.float64) @ np.array([[0.5, -0.25], [0, 0.5], [-0.5, -0.25]])
        orange, green = np.clip(tints, near.min(0), near.max(0)) - tints
        brought += (orange - green, green, -orange - green)
        mean = np.clip(brought, around.min(0), around.max(0))
        no_albedo = (around >= 1).all(1)
        held = samples if inside >= 1 - 1e-3 else 0
        result[y, x, :3] = remodulation_albedo[y, x] = (held * mean + albedo[y, x]) / (held + 1)
        if no_albedo.any() and not no_albedo.all():
            remodulation_albedo[y, x] = np.minimum(remodulation_albedo[y, x], albedo[y, x])
    return result, remodulation_albedo


def sharp_resample(output: np.ndarray, positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`stillray.stages.previous_output.resample`, sharp, pixel by pixel; and the brightest of the
    pixels it meets.

    The mean of the four pixels around, with the luminance of cubic convolution, limited to the
    range of the four; the mean alone of those in the frame where they are not all.
    """
    (height, width), values = output.shape[:2], output.astype(np.float64)
    light = values[..., :3] @ (0.2126, 0.7152, 0.0722)
    result, brightest = np.zeros(values.shape), np.zeros((height, width))

    def nearest(y: int, x: int) -> tuple[int, int]:
        return min(max(y, 0), height - 1), min(max(x, 0), width - 1)

    for y, x in np.ndindex(height, width):
        at_x, at_y = map(float, positions[y, x])
        left, top = int(np.floor(at_x)), int(np.floor(at_y))
        taps = [(top + a, left + b) for a in (0, 1) for b in (0, 1)]
        for p in taps:
            if 0 <= p[0] < height and 0 <= p[1] < width:
                share = (1 - abs(at_y - p[0])) * (1 - abs(at_x - p[1]))
                result[y, x] += share * values[p]
                brightest[y, x] = max(brightest[y, x], values[p][:3].max())
        if result[y, x, 3] < 1 - 1e-3:
            result[y, x, :3] /= max(result[y, x, 3], 1e-3)  # below, light fades
            continue
        cubic, around = 0.0, [light[nearest(*p)] for p in taps]
        for ty, tx in itertools.product(range(top - 1, top + 3), range(left - 1, left + 3)):
            near = nearest(ty, tx)
            cubic += cubic_weight(at_y - ty) * cubic_weight(at_x - tx) * light[near]
            brightest[y, x] = max(brightest[y, x], values[near][:3].max())
        linear = result[y, x, :3] @ (0.2126, 0.7152, 0.0722)
        if linear > 0:
            result[y, x, :3] *= np.clip(cubic, min(around), max(around)) / linear
    return result, brightest


def kernel_pyramid(
    mean: np.ndarray,
    sample: np.ndarray,
    albedo: np.ndarray,
    previous: np.ndarray,
    logits: list[np.ndarray],
    options: PyramidKernels,
    exposure: float = 1.0,
) -> np.ndarray:
    """`kernel_pyramid.filter_pyramid`, pixel by pixel; arrays as it takes them."""
    bound, levels = options.logit_bound, len(logits)
    weights = [np.exp(np.clip(level.astype(np.float64), -bound, bound)) for level in logits]
    height, width = mean.shape[:2]
    full = weights[0].shape[1:]
    padding = [(0, full[axis] - mean.shape[axis]) for axis in (0, 1)]
    padded, new = (
        np.pad(image.astype(np.float64), [*padding, (0, 0)], mode="symmetric")
        for image in (mean, np.moveaxis(sample, 0, -1))
    )
    light, held = np.zeros_like(padded[..., :3]), np.zeros(full)
    # of the finest level what its filters compare and weigh by comes last, weights of neighbours
    # before
    filters = options.filter_features + 2 * len(options.finest_filters)
    compared = weights[0][len(weights[0]) - filters :]
    weights[0] = weights[0][: len(weights[0]) - filters]
    finest, extra = weights[0], 8 * len(options.finest_neighbours)
    weights[0] = finest[: len(finest) - extra]
    for y, x in np.ndindex(*full):
        parts = [padded[y, x, 3], weights[0][-1, y, x] * new[y, x, 3]]
        light[y, x] = np.average([padded[y, x, :3], new[y, x, :3]], axis=0, weights=parts)
        held[y, x] = sum(parts) / (1 + weights[0][-1, y, x])
    pyramid = [(light, held)]
    sizes = [options.kernel_sizes] * levels
    if not options.finest_kernels:
        sizes[0] = ()
    for level in range(levels - 1):
        light, held = pyramid[-1]
        count = len(sizes[level])
        half = (held.shape[0] // 2, held.shape[1] // 2)
        coarse, samples = np.zeros((*half, 3)), np.zeros(half)
        for y, x in np.ndindex(half):
            block = [(2 * y + a, 2 * x + b) for a in (0, 1) for b in (0, 1)]
            pool = [weights[level][count][p] for p in block]
            weight = [w * held[p] for w, p in zip(pool, block, strict=True)]
            samples[y, x] = sum(weight) / sum(pool)
            if sum(weight) > 0:
                coarse[y, x] = sum(w * light[p] for w, p in zip(weight, block, strict=True)) / sum(
                    weight
                )
        pyramid.append((coarse, samples))
    result = np.zeros(0)
    around = [(a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]
    for level in reversed(range(levels)):
        light, held = pyramid[level]
        coarsest, count = level == levels - 1, len(sizes[level])
        blended = np.zeros_like(light)
        for y, x in np.ndindex(held.shape):
            choices = [light[y, x]] + [
                _window(light, weights[level][index] * held, y, x, size // 2)
                for index, size in enumerate(sizes[level])
            ]
            first = count if coarsest else count + 1
            shares = list(weights[level][first : first + len(choices) - coarsest, y, x])
            if coarsest:
                shares = [1.0, *shares]
            else:
                shares[0] *= min(held[y, x], 1)
                after = -16 if options.predicted else -8
                choices.append(_doubled(result, weights[level + 1][after:][:8], y, x))
                shares.append(1.0)
            own, distances = weights[level], (1,) * options.predicted
            if level == 0:
                own, distances = finest, options.finest_neighbours
            for place, distance in enumerate(distances):
                for index, (down, right) in enumerate(around):
                    at = (
                        min(max(y + distance * down, 0), held.shape[0] - 1),
                        min(max(x + distance * right, 0), held.shape[1] - 1),
                    )
                    choices.append(light[at])
                    shares.append(own[8 * (place - len(distances)) + index, y, x])
            blended[y, x] = np.average(choices, axis=0, weights=shares)
        result = blended
    shown = exposure * result @ [0.2126, 0.7152, 0.0722]
    less = 1 / np.minimum(1 + options.filter_tone * np.maximum(shown - 1, 0), 1e6)
    for index, distance in enumerate(options.finest_filters):
        features = np.log(compared[: options.filter_features])
        pair = compared[options.filter_features + 2 * index :][:2] * less
        result = _by_likeness(result, features, pair[0], pair[1], distance)
    albedo = albedo.astype(np.float64)
    for distance in options.albedo_filters:
        before = albedo.copy()
        for y, x in np.ndindex(height, width):
            choices, shares = [before[y, x]], [1.0]
            for index, (down, right) in enumerate(around):
                at = (
                    min(max(y + distance * down, 0), height - 1),
                    min(max(x + distance * right, 0), width - 1),
                )
                choices.append(before[at])
                shares.append(weights[0][-10 + index, y, x] ** 2)
            albedo[y, x] = np.average(choices, axis=0, weights=shares)
    radiance = result[:height, :width] * albedo
    resolved, tone = np.zeros_like(radiance), options.resolve_tone * exposure
    for y, x in np.ndindex(height, width):
        choices = [radiance[y, x], previous[y, x, :3].astype(np.float64)]
        shares = [1.0, weights[0][-2, y, x] * previous[y, x, 3]]
        for index, (down, right) in enumerate(around):
            at = min(max(y + down, 0), height - 1), min(max(x + right, 0), width - 1)
            choices.append(radiance[at])
            own, other = (1 + tone * (radiance[p] @ [0.2126, 0.7152, 0.0722]) for p in ((y, x), at))
            shares.append(weights[0][-10 + index, y, x] * min(1, own / other))
        resolved[y, x] = np.average(choices, axis=0, weights=shares)
    return resolved


def _by_likeness(
    light: np.ndarray, features: np.ndarray, weight: np.ndarray, own: np.ndarray, distance: int
) -> np.ndarray:
    """`gaussian.gaussian`, pixel by pixel: light ``(h, w, 3)``, features ``(k, h, w)``."""
    result = np.zeros_like(light)
    for y, x in np.ndindex(*weight.shape):
        choices, shares = [light[y, x]], [own[y, x]]
        for down, right in np.ndindex(3, 3):
            there = (y + distance * (down - 1), x + distance * (right - 1))
            inside = all(0 <= a < size for a, size in zip(there, weight.shape, strict=True))
            if inside and there != (y, x):
                apart = ((features[:, y, x] - features[:, there[0], there[1]]) ** 2).sum()
                choices.append(light[there])
                shares.append(weight[there] * np.exp(-min(apart, 60)))
        result[y, x] = np.average(choices, axis=0, weights=shares)
    return result


def multi_resolution_kernels(
    mean: np.ndarray,
    logits: list[np.ndarray],
    options: FusedKernels,
    filtered: Callable[..., np.ndarray] = fused_kernels,
) -> np.ndarray:
    """Fan et al. 2021, eq. 7, pixel by pixel and limited; arrays as the runtime's."""
    height, width = mean.shape[:2]
    full = logits[0].shape[1:]
    padding = [(0, full[axis] - mean.shape[axis]) for axis in (0, 1)]
    padded = np.pad(mean.astype(np.float64), [*padding, (0, 0)], mode="symmetric")
    pyramid = [(padded[..., :3], padded[..., 3])]
    for _ in logits[1:]:
        light, held = pyramid[-1]
        half = (held.shape[0] // 2, held.shape[1] // 2)
        coarse, samples = np.zeros((*half, 3)), np.zeros(half)
        for y, x in np.ndindex(half):
            block = [(2 * y + a, 2 * x + b) for a in (0, 1) for b in (0, 1)]
            weights = [held[p] if options.weigh_samples else 1.0 for p in block]
            coarse[y, x] = np.average([light[p] for p in block], axis=0, weights=weights)
            samples[y, x] = np.mean([held[p] for p in block])
        pyramid.append((coarse, samples))
    result = filtered(*pyramid[-1], logits[-1], options)
    for level in reversed(range(len(logits) - 1)):
        fine = filtered(*pyramid[level], logits[level][:-1], options)
        blended = np.zeros_like(fine)
        for y, x in np.ndindex(fine.shape[:2]):
            coarser = result[y // 2, x // 2]
            block = fine[y // 2 * 2 : y // 2 * 2 + 2, x // 2 * 2 : x // 2 * 2 + 2]
            logit = np.clip(logits[level][-1, y, x], -options.logit_bound, options.logit_bound)
            alpha = 1 / (1 + np.exp(-np.float64(logit)))
            moved = fine[y, x] - alpha * block.mean((0, 1)) + alpha * coarser
            least = np.minimum(block.min((0, 1)), coarser)
            blended[y, x] = np.clip(moved, least, np.maximum(block.max((0, 1)), coarser))
        result = blended
    return result[:height, :width]


def bilateral_grids(mean: np.ndarray, maps: np.ndarray, options: BilateralGrids) -> np.ndarray:
    """Meng et al. 2020, eq. 9 to 15, a pixel and a cell at a time; arrays as the runtime's."""
    height, width = mean.shape[:2]
    maps = np.clip(maps.astype(np.float64), 0, 1)
    light = mean[..., :3].astype(np.float64)
    samples = mean[..., 3].astype(np.float64) if options.weigh_samples else np.ones((height, width))
    result, rest = np.zeros((height, width, 3)), np.ones((height, width))
    for scale in range(options.grids):
        rate = 2**scale
        spacing = np.array([options.spacing, options.spacing, options.depth_spacing]) * rate
        sums: dict[tuple[int, ...], np.ndarray] = {}
        weights: dict[tuple[int, ...], float] = {}
        for y, x in np.ndindex(height, width):
            for cell, weight in _tent(np.array([y, x, 255 * maps[scale, y, x]]) / spacing):
                weight *= samples[y, x]
                sums[cell] = sums.get(cell, np.zeros(3)) + weight * light[y, x]
                weights[cell] = weights.get(cell, 0.0) + weight
        share = rest * (maps[options.grids + scale] if scale < options.grids - 1 else 1)
        rest = rest - share
        for y, x in np.ndindex(height, width):
            total, found = np.zeros(3), 0.0
            for cell, weight in _tent(np.array([y, x, 255 * maps[scale, y, x]]) / spacing):
                if weights[cell] > 0:
                    total += weight * sums[cell] / weights[cell]
                    found += weight
            if found > 0:
                result[y, x] += share[y, x] * total / found
    return result


def _tent(place: np.ndarray) -> list[tuple[tuple[int, ...], float]]:
    """The eight cells around a place, and their weights."""
    first = np.floor(place).astype(int)
    cells = [tuple(first + step) for step in np.ndindex(2, 2, 2)]
    return [(c, float(np.maximum(1 - np.abs(place - np.array(c)), 0).prod())) for c in cells]


def _window(light: np.ndarray, weight: np.ndarray, y: int, x: int, half: int) -> np.ndarray:
    rows = slice(max(y - half, 0), y + half + 1)
    columns = slice(max(x - half, 0), x + half + 1)
    total = weight[rows, columns].sum()
    return np.einsum("yx,yxc->c", weight[rows, columns], light[rows, columns]) / total


def _doubled(image: np.ndarray, weights: np.ndarray, y: int, x: int) -> np.ndarray:
    """A pixel of an image of twice the size: its own coarser pixel, one beside, one above or below.

    The border is repeated.
    """
    row, column, corner = y // 2, x // 2, 2 * (y % 2) + x % 2
    beside = row, min(max(column + (1 if x % 2 else -1), 0), image.shape[1] - 1)
    above = min(max(row + (1 if y % 2 else -1), 0), image.shape[0] - 1), column
    shares = [2.0, weights[corner, row, column], weights[4 + corner, row, column]]
    choices = [image[row, column], image[beside], image[above]]
    mean: np.ndarray = np.average(choices, axis=0, weights=shares)
    return mean


def feature_filters(
    frame: dict[str, np.ndarray],
    past: dict[str, np.ndarray],
    outputs: list[np.ndarray],
    rules: Rules,
    exposure: float = 1.0,
) -> dict[str, np.ndarray]:
    """Kazmierczyk et al. 2025, section 3.4, pixel by pixel, as `stillray.families` does it.

    ``frame`` has color, albedo and specular ``(h, w, 3)``; ``past`` light, albedo, specular and
    output ``(h, w, 4)``; ``outputs`` are maps ``(planes, h, w)``, those of the picture no longer in
    blocks. Gives image, light, albedo and specular.
    """
    levels, filters = len(outputs), rules.filters
    maps = [
        np.clip(m.astype(np.float64), -filters.logit_bound, filters.logit_bound) for m in outputs
    ]
    layout = target_layout(levels, filters)
    frame = {name: value.astype(np.float64) for name, value in frame.items()}
    past = {name: value.astype(np.float64) for name, value in past.items()}
    height, width = frame["color"].shape[:2]
    new = {
        "light": _gaussian(frame["color"], maps[0], layout.light),
        "albedo": _gaussian(frame["albedo"], maps[0], layout.guides),
        "specular": _gaussian(frame["specular"], maps[0], layout.guides),
    }
    kept: dict[str, np.ndarray] = {}
    for index, name in enumerate(("light", "albedo", "specular")):
        kept[name] = np.zeros((height, width, 4))
        for y, x in np.ndindex(height, width):
            weight = np.exp(maps[0][layout.keep.start + index, y, x]) * past[name][y, x, 3]
            shares = np.array([weight, 1]) / (weight + 1)
            kept[name][y, x, :3] = shares @ [past[name][y, x, :3], new[name][y, x]]
            each = shares[0] ** 2 / past[name][y, x, 3] if past[name][y, x, 3] > 0 else 0.0
            kept[name][y, x, 3] = min(1 / (each + shares[1] ** 2), rules.max_samples)
    by = {}
    for name in ("albedo", "specular"):
        albedo = kept[name][..., :3]
        black = (albedo <= rules.demodulate.black).all(-1, keepdims=True)
        by[name] = np.where(black, 1.0, np.clip(albedo, rules.demodulate.floor, 1))
        by[name] = by[name] + rules.demodulate.specular
    light = kept["light"][..., :3]
    planes = np.concatenate([light / by["albedo"], light / by["specular"], light], -1)
    shares = _softmax(maps[0][layout.partition])

    def less(values: np.ndarray) -> np.ndarray:
        above = np.maximum(exposure * values[..., 6:] @ [0.2126, 0.7152, 0.0722] - 1, 0)
        return 1 / np.minimum(1 + filters.filter_tone * above, 1e6)

    result = None
    for level in reversed(range(1, levels)):
        own, side = level_layout(level, levels, filters), 1 << level
        pool = np.zeros((height // side, width // side, 9))
        for y, x in np.ndindex(*pool.shape[:2]):
            block = (slice(y * side, (y + 1) * side), slice(x * side, (x + 1) * side))
            weight = shares[level][block] * kept["light"][block][..., 3]
            pool[y, x] = (planes[block] * weight[..., None]).sum((0, 1)) / weight.sum()
        if result is not None:
            pool = _mixed(pool, result, maps[level][own.coarser])
        for distance in filters.coarsest_filters if level == levels - 1 else (1,):
            pool = _gaussian(pool, maps[level], own.denoise, distance, less(pool))
        result = pool
    if result is not None:
        planes = _mixed(planes, result, maps[0][layout.coarser])
    planes = _gaussian(planes, maps[0], layout.denoise, 1, less(planes))
    plain, diffuse, glossy, alone = (
        share[..., None] for share in _softmax(maps[0][layout.compose])
    )
    image = diffuse * planes[..., :3] * by["albedo"] + glossy * planes[..., 3:6] * by["specular"]
    image = image + plain * planes[..., 6:] + alone * new["light"]
    held = (past["light"][..., 3] > 0) / (1 + np.exp(-maps[0][layout.output]))
    image = image * (1 - held[..., None]) + past["output"][..., :3] * held[..., None]
    return {"image": image, **kept}


def _gaussian(
    values: np.ndarray,
    maps: np.ndarray,
    planes: GaussianPlanes,
    distance: int = 1,
    less: np.ndarray | None = None,
) -> np.ndarray:
    height, width = values.shape[:2]
    features, importance = maps[planes.features], maps[planes.importance]
    result = np.zeros_like(values)
    for y, x in np.ndindex(height, width):
        total = 0.0
        rows, columns = (range(at - distance, at + 2 * distance, distance) for at in (y, x))
        for v, u in itertools.product(rows, columns):
            if 0 <= v < height and 0 <= u < width:
                apart = min(((features[:, y, x] - features[:, v, u]) ** 2).sum(), 60.0)
                weight = np.exp(importance[v, u] - apart) * (1 if less is None else less[v, u])
                total += weight
                result[y, x] += weight * values[v, u]
        result[y, x] /= total
    return result


def _mixed(values: np.ndarray, coarser: np.ndarray, logits: np.ndarray) -> np.ndarray:
    result = np.zeros_like(values)
    for y, x in np.ndindex(*values.shape[:2]):
        share = 1 / (1 + np.exp(-logits[y, x]))
        result[y, x] = (1 - share) * values[y, x] + share * coarser[y // 2, x // 2]
    return result


def _softmax(logits: np.ndarray) -> np.ndarray:
    """Of logits and of one more before them, which is 0."""
    weights = np.exp(np.concatenate([np.zeros_like(logits[:1]), logits]))
    return np.asarray(weights / weights.sum(0))


def restored_lamps(image, prepared) -> np.ndarray:
    """`stages.lamps`: the picture, pixel by pixel; arguments as it takes them."""
    height, width = image.shape[:2]
    rec709 = np.array([0.2126, 0.7152, 0.0722])
    radiance = prepared.history.mean[..., :3].astype(np.float64)
    if prepared.remodulation_albedo is not None:
        radiance = radiance * prepared.remodulation_albedo
    samples = radiance @ rec709
    exposure = prepared.history.exposure
    picture = image.astype(np.float64) @ rec709 + lamps.DARKEST / exposure
    result = image.astype(np.float64)
    opened = [_opened(samples, picture, block) for block in lamps.BLOCKS]
    for y, x in np.ndindex(height, width):
        best, share = 0.0, 0.0
        most = lamps.MOST * _around(picture[..., None], y, x, lamps.AROUND // 2).mean()
        for block, found in zip(lamps.BLOCKS, opened, strict=True):
            level = min(found[y, x], most)
            above = level / picture[y, x] - block.brighter
            own = min(max(above / (lamps.FADE * block.brighter), 0), 1)
            if own > 0 and block.strewn < 1:
                around = _strewn(samples, picture, found > 0, block, (y, x))
                own *= min(max(2 - 2 * around / block.strewn, 0), 1)
            if own * (level - picture[y, x]) > share * (best - picture[y, x]):
                best, share = level, own
        if share > 0:
            result[y, x] *= 1 - share
            result[y, x] += share * radiance[y, x] * best / samples[y, x]
    return result


def _opened(samples: np.ndarray, picture: np.ndarray, block: lamps.Block) -> np.ndarray:
    height, width = samples.shape
    result = np.zeros_like(samples)
    for y, x in np.ndindex(max(height - block.height + 1, 0), max(width - block.width + 1, 0)):
        place = slice(y, y + block.height), slice(x, x + block.width)
        least = samples[place].min()
        alike = samples[place].max() <= block.alike * least
        if alike and least > block.brighter * picture[place].max():
            result[place] = np.maximum(result[place], least)
    return result


def _strewn(samples, picture, in_blocks, block: lamps.Block, at: tuple[int, int]) -> float:
    """Share of pixels around that are bright and not beside a block; none beyond the frame."""
    height, width = samples.shape
    reach, found = lamps.AROUND // 2, 0
    for y in range(max(at[0] - reach, 0), min(at[0] + reach + 1, height)):
        for x in range(max(at[1] - reach, 0), min(at[1] + reach + 1, width)):
            beside = in_blocks[max(y - 1, 0) : y + 2, max(x - 1, 0) : x + 2].any()
            found += not beside and samples[y, x] > block.brighter * picture[y, x]
    return found / lamps.AROUND**2


def relief(image, prepared, window: float) -> np.ndarray:
    """`stages.relief`: the gain, block by block and pixel by pixel; arguments as it takes them."""
    height, width = image.shape[:2]
    size, reach = block_sums.BLOCK, stage.FINE // 2
    normal = prepared.normal.astype(np.float64)
    fine, weight = np.zeros_like(normal), np.zeros((height, width))
    taken = np.zeros_like(weight)
    shares = np.array([0.2126, 0.7152, 0.0722])
    for y, x in np.ndindex(height, width):
        fine[y, x] = normal[y, x] - _around(normal, y, x, reach).mean(axis=0)
        exponent = (fine[y, x] ** 2).sum() / stage.BENT**2
        weight[y, x] = np.exp(-exponent)
        if prepared.depth is not None:
            depth = prepared.depth.astype(np.float64)
            if depth[y, x] == 0:
                weight[y, x] = 0
            else:
                inverse = [1 / d if d else 0 for d in _around(depth[..., None], y, x, 1)[:, 0]]
                apart = (np.mean(inverse) * depth[y, x] - 1) / stage.APART
                weight[y, x] *= np.exp(-(apart**2))
        left = image[y, x] @ shares
        now = prepared.luminance[y, x] * (prepared.remodulation_albedo[y, x] @ shares)
        relative = (now - left) / (left + stage.DARKEST / prepared.history.exposure)
        taken[y, x] = min(max(relative, -stage.MOST_TAKEN), stage.MOST_TAKEN)
    blocks = (-(-height // size), -(-width // size))
    slopes = np.zeros((*blocks, 3))
    for row, column in np.ndindex(*blocks):
        slopes[row, column] = _slope(fine, weight, taken, (row, column), window)
    gain = np.zeros((height, width))
    for y, x in np.ndindex(height, width):
        total = np.zeros(3)
        (top, down), (left, right) = (
            divmod(min(max((at + 0.5) / size - 0.5, 0), count - 1), 1)
            for at, count in zip((y, x), blocks, strict=True)
        )
        for a, b in np.ndindex(2, 2):
            share = (down if a else 1 - down) * (right if b else 1 - right)
            at = min(int(top) + a, blocks[0] - 1), min(int(left) + b, blocks[1] - 1)
            total += share * slopes[at]
        gain[y, x] = 1 + weight[y, x] * (total @ fine[y, x])
    return np.clip(gain, stage.LEAST_GAIN, stage.MOST_GAIN)


def _around(image: np.ndarray, y: int, x: int, reach: int) -> np.ndarray:
    """The pixels of a window, the border repeated: ``(n, channels)``."""
    height, width = image.shape[:2]
    return np.array(
        [
            image[min(max(y + a, 0), height - 1), min(max(x + b, 0), width - 1)]
            for a in range(-reach, reach + 1)
            for b in range(-reach, reach + 1)
        ]
    )


def _slope(fine, weight, taken, block, window: float) -> np.ndarray:
    """Of one block: pixels weighed by how far their block is, a Gaussian of block to block."""
    height, width = weight.shape
    size, sigma = block_sums.BLOCK, window / block_sums.BLOCK
    reach = int(np.ceil(3 * sigma))
    line = np.exp(-(np.arange(-reach, reach + 1) ** 2) / (2 * sigma**2))
    line /= line.sum()
    rows, columns = np.arange(height) // size - block[0], np.arange(width) // size - block[1]
    near = [np.where(abs(far) <= reach, line[np.clip(far + reach, 0, 2 * reach)], 0)
            for far in (rows, columns)]  # fmt: skip
    pixels = weight * near[0][:, None] * near[1] / size**2
    total = pixels.sum() + block_sums.LEAST_WEIGHT
    share = pixels / total
    mean, normals = (share * taken).sum(), (share[..., None] * fine).sum(axis=(0, 1))
    noise = max((share * taken**2).sum() - mean**2, 0)
    squares = np.einsum("yx,yxi,yxj->ij", share, fine, fine) - np.outer(normals, normals)
    products = np.einsum("yx,yxi,yx->i", share, fine, taken) - normals * mean
    count = 4 * np.pi * window**2 * total
    ridge = noise / (count * stage.PRIOR**2) + stage.RIDGE
    found = np.linalg.solve(squares + ridge * np.eye(3), products)
    explained = found @ products + stage.LEAST_EXPLAINED
    alike = 0.0
    whole = weight[..., None] * fine
    for y, x in np.ndindex(height, width):
        near_by = [(y, x + 1)] + ([(y + 1, x)] if y % size != size - 1 else [])
        for other in near_by:
            if other[0] < height and other[1] < width:
                far = near[0][y] * near[1][x] / size**2 / total
                alike += far * (whole[y, x] @ whole[other])
    trace = (share[..., None] * fine**2).sum() + stage.LEAST_EXPLAINED
    least, most = stage.RESOLVED
    resolved = (alike / (2 - 1 / size) / trace - least) / (most - least)
    by_chance = stage.DOUBT * 3 * noise / count / explained
    return found * np.clip(1 - by_chance, 0, 1) * np.clip(resolved, 0, 1)
