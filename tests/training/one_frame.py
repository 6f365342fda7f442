"""The smallest sequence that training reads: one frame and its reference."""

from __future__ import annotations

import json

from stillray_training.simulate.sequence import write
from tests.conftest import clean_color, make_frame


def write_one_frame(folder, size):
    """A frame of one sample a pixel, of the given height and width."""
    frame = make_frame(*size, 1)
    layers = ("color", "albedo", "normal", "depth")
    write(folder / "frame_0000.exr", {layer: getattr(frame, layer) for layer in layers})
    write(folder / "ref_0000.exr", {"color": clean_color(*size)})
    (folder / "sequence.json").write_text(json.dumps({"options": {"spp": 1}}))
