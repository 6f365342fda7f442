# SPDX-License-Identifier: GPL-3.0-or-later
"""A denoiser with a history of its own for each scene, view layer and eye.

Frames without motion vectors have no history: one denoiser serves all of them.
"""

from dataclasses import dataclass
from typing import NamedTuple


class Shown(NamedTuple):
    """What a frame is a picture of: frames are accumulated where all but the number stays.

    Attributes
    ----------
    scene, layer, view, camera
        Names; the view's is empty where there is one eye.
    """

    scene: str
    layer: str
    view: str
    camera: str


@dataclass
class _Stream:
    denoiser: object
    cuts: object
    camera: str
    last: int | None = None  # number of the frame that its history ends with


class Streams:
    """All that is remembered between frames; one network serves all that have a past."""

    def __init__(self) -> None:
        self._streams: dict[tuple, _Stream] = {}
        self._still = None
        self._kind: tuple = ()

    def denoise(self, frame, shown: Shown, number: int, settings, progress):
        """The clean picture, ``(height, width, 3)`` float32.

        Parameters
        ----------
        frame : stillray.Frame
            The buffers.
        shown
            What it shows.
        number
            On Blender's time line: history goes on from the frame before it alone, since that is
            where motion points to.
        settings : StillraySettings
            Quality, size of the ensemble, and whether history is used.
        progress
            As `stillray.Denoiser.denoise` takes it.
        """
        kind = settings.quality, settings.ensemble
        if self._kind != kind:
            self.close()
            self._kind = kind
        if not settings.temporal or frame.motion is None:
            return self._alone().denoise(frame, progress=progress)
        stream = self._stream(shown)
        cut = stream.cuts.compare(frame)
        if number - 1 != stream.last or shown.camera != stream.camera or (cut and cut.is_cut):
            stream.denoiser.reset()
        picture = stream.denoiser.denoise(frame, progress=progress)
        stream.last, stream.camera = number, shown.camera
        return picture

    def forget(self) -> None:
        """Drop all history."""
        for stream in self._streams.values():
            stream.denoiser.reset()
            stream.last = None

    def close(self) -> None:
        """Free everything."""
        while self._streams:  # from the last: the first owns the network
            _, stream = self._streams.popitem()
            stream.denoiser.close()
        if self._still is not None:
            self._still.close()
            self._still = None

    def _alone(self):
        """The denoiser of frames without history."""
        if self._still is None:
            from stillray import Denoiser

            quality, ensemble = self._kind
            self._still = Denoiser(quality, temporal=False, ensemble=ensemble)
        return self._still

    def _stream(self, shown: Shown) -> _Stream:
        key = shown.scene, shown.layer, shown.view
        if key not in self._streams:
            from stillray import Denoiser
            from stillray.batch.scene_cuts import CutDetector

            first = next(iter(self._streams.values()), None)
            engine = first.denoiser.engine if first else None
            quality, ensemble = self._kind
            denoiser = Denoiser(quality, ensemble=ensemble, engine=engine)
            self._streams[key] = _Stream(denoiser, CutDetector(denoiser.model.spec), shown.camera)
        return self._streams[key]
