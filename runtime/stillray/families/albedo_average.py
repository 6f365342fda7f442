"""The albedo that a picture is multiplied by, averaged where the resolve is wide open.

What a lens does not show sharp has the albedo of whatever a sample met, and glass that of what
lies behind it: of few samples that is noise, and light that was filtered well is multiplied by it.
Where the network lets the resolve mix a pixel with its neighbours, which shows that nothing there
is sharp, the albedo of neighbours further away counts as well.

differs: Fan et al. 2021 multiply by the albedo as it was rendered (section 4.1).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from stillray.arrays.strips import Strips, planes_of
from stillray.families.logit_maps import LogitMaps
from stillray.families.pyramid_level import add_neighbours, with_margin


def averaged(
    albedo: np.ndarray, logits: LogitMaps, places: slice, distances: Sequence[int], strips: Strips
) -> np.ndarray:
    """An albedo averaged with its neighbours, one distance after the other.

    Parameters
    ----------
    albedo : (h, w, 3) float32
        Not changed.
    logits, places
        Of the neighbours in the resolve, in the order of `NEIGHBOURS`. Their weights count squared.
    distances
        Of the neighbours, pixels; beyond the frame the border goes on.
    strips
        Where the work runs.

    Returns
    -------
    (3, h, w) float32
        For every pixel a convex combination. It lies in the workspace of this thread.
    """
    height, width = albedo.shape[:2]
    found = strips.workspace.array("albedo", (3, height, width))

    def take(rows: slice) -> None:
        planes_of(albedo[rows], out=found[:, rows])

    strips.run(take, height, width)
    for index, distance in enumerate(distances):
        out = strips.workspace.array(f"averaged albedo {index % 2}", found.shape)
        _average(found, logits, places, distance, strips, out)
        found = out
    return found


def _average(
    albedo: np.ndarray,
    logits: LogitMaps,
    places: slice,
    distance: int,
    strips: Strips,
    out: np.ndarray,
) -> None:
    def work(rows: slice) -> None:
        workspace, target = strips.workspace, out[:, rows]
        shape = target.shape[1:]
        weights = workspace.array("weights", (places.stop - places.start, *shape))
        logits.weights(places, rows, weights)
        weights *= weights
        total = np.sum(weights, axis=0, out=workspace.array("total", shape))
        total += 1
        sums = workspace.array("sums", target.shape)
        np.copyto(sums, albedo[:, rows])
        add_neighbours(with_margin(albedo, rows, distance, workspace), weights, sums, distance)
        for plane, averaged_plane in zip(sums, target, strict=True):
            cv2.divide(plane, total, dst=averaged_plane)

    strips.run(work, *albedo.shape[1:])
