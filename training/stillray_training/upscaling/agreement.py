"""What a past loses where light has changed, in training: by the runtime's rule.

See `stillray.families.past_agreement`. To gradients it is a constant. A patch is compared as if it
were a frame, over windows no larger than itself: changes that only larger ones tell are not
noticed here.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from stillray.arrays.strips import Strips
from stillray.arrays.workspace import Workspace
from stillray.families.past_agreement import LEAST_SHARE, Shown, agreement
from stillray.stages.recall import Compared, Recall
from stillray_training.decoders.feature_filters import Remembered

_LINES = ("rows", "columns")


def reject_history(past: Remembered, frame: Mapping[str, Tensor], scale: int) -> Remembered:
    """Take from pasts what disagrees with frames.

    Parameters
    ----------
    past
        At the pixels of the pictures, with the noise that the last frame left.
    frame
        Of `stillray_training.upscaling.clips.ClipSampler`.
    scale
        Pixels of the picture for one of the frame, along each axis.

    Returns
    -------
    Remembered
        What is left of it, with the noise for the next frame.
    """
    strips = Strips(1)
    held = past.light.detach().cpu().numpy()
    shares, after = [], []
    for patch in range(len(held)):
        # batches are of floats alone
        rows, columns = (frame[name][patch].cpu().numpy().astype(np.intp) for name in _LINES)
        share, noise = agreement(
            np.ascontiguousarray(held[patch].transpose(1, 2, 0)),
            _shown(frame, patch, (rows, columns), scale),
            scale,
            _pixels(frame["moved"][patch]),
            past.noises[patch] if past.noises else None,
            strips,
        )
        after.append(noise)
        whole = np.ones((len(rows), len(columns)), np.float32)
        shares.append(whole if share is None else share[np.ix_(rows, columns)])
    kept = torch.from_numpy(np.stack(shares)[:, None]).to(past.light)
    left = kept >= float(LEAST_SHARE)
    light, albedo, specular, output = (
        image * left for image in (past.light, past.albedo, past.specular, past.output)
    )
    light = torch.cat([light[:, :3], light[:, 3:] * kept], 1)
    return Remembered(light, albedo, specular, output, noises=tuple(after))


def recalling(past: Remembered, frame: Mapping[str, Tensor], limit: float) -> Remembered:
    """Pasts that say what they weigh beside frames, see `stillray.stages.recall`.

    Parameters
    ----------
    past
        At the pixels of the pictures.
    frame
        Of `stillray_training.upscaling.clips.ClipSampler`.
    limit
        ``recall_noise`` of `stillray.model_spec.decoders.FeatureFilters`.
    """
    strips, rule, shares = Strips(1), Recall(limit=limit), []
    for output, light, color, exposure in zip(
        past.output, past.light, frame["color"], frame["exposure"], strict=True
    ):
        last, known, own = (_pixels(planes) for planes in (output, light, color))
        seen = Compared(last, known, own, float(exposure.item()))
        shares.append(rule.share(seen, strips, Workspace()).agreed)
    recalled = torch.from_numpy(np.stack(shares)[:, None]).to(past.light)
    return replace(past, recalled=recalled)


def _pixels(planes: Tensor) -> np.ndarray:
    """``(h, w, c)`` of ``(c, h, w)``."""
    return np.ascontiguousarray(planes.detach().cpu().numpy().transpose(1, 2, 0))


def _shown(
    frame: Mapping[str, Tensor], patch: int, lines: tuple[np.ndarray, np.ndarray], scale: int
) -> Shown:
    """What a patch of a frame shows; features that are left out are zeros, which have no outline.

    ``lines`` are the rows and columns of the frame that those of the picture take.
    """
    color = _pixels(frame["shown"][patch])
    # of each row and column of the frame the first one of the picture that takes it
    size = color.shape[:2]
    first = [np.searchsorted(taken, np.arange(n)) for taken, n in zip(lines, size, strict=True)]
    offsets = frame["offset"][patch].cpu().numpy()[:, first[0][0], first[1][0]]
    down, right = (
        float((off + line[0] + 0.5) / scale - 0.5)
        for off, line in zip(offsets[::-1], first, strict=True)
    )
    at = np.ix_(*first)
    depth, normal, albedo = (
        np.ascontiguousarray(_pixels(frame[name][patch])[at])
        for name in ("depth", "normal", "albedo")
    )
    exposure = float(frame["exposure"][patch].item())
    return Shown(color, None, exposure, (depth[..., 0], normal, albedo), (right, down))
