"""What a past loses where light has changed, in training: by the runtime's rule.

See `stillray.families.past_agreement`. To gradients it is a constant. A patch is compared as if it
were a frame, over windows no larger than itself: changes that only larger ones tell are not
noticed here.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from stillray.arrays.strips import Strips
from stillray.families.past_agreement import LEAST_SHARE, Shown, agreement
from stillray_training.decoders.feature_filters import Remembered


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
    names = ("shown", "moved", "exposure", "rows", "columns")
    given = [frame[name].cpu().numpy() for name in names]
    shares, after = [], []
    for patch, (color, motion, exposure, rows, columns) in enumerate(zip(*given, strict=True)):
        share, noise = agreement(
            np.ascontiguousarray(held[patch].transpose(1, 2, 0)),
            Shown(np.ascontiguousarray(color.transpose(1, 2, 0)), None, float(exposure.item())),
            scale,
            motion.transpose(1, 2, 0),
            past.noises[patch] if past.noises else None,
            strips,
        )
        after.append(noise)
        whole = np.ones((len(rows), len(columns)), np.float32)
        # batches are of floats alone
        at = np.ix_(rows.astype(np.intp), columns.astype(np.intp))
        shares.append(whole if share is None else share[at])
    kept = torch.from_numpy(np.stack(shares)[:, None]).to(past.light)
    left = kept >= float(LEAST_SHARE)
    light, albedo, specular, output = (
        image * left for image in (past.light, past.albedo, past.specular, past.output)
    )
    light = torch.cat([light[:, :3], light[:, 3:] * kept], 1)
    return Remembered(light, albedo, specular, output, noises=tuple(after))
