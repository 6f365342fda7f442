"""How the files of a shot are read and written: found out once, the same for every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillray.frame import Frame
from stillray.io.channels.motion_detection import Detection, detect_in_sequence
from stillray.io.exr.read_write import read_exr, read_lights, write_exr


@dataclass(frozen=True, kw_only=True)
class Layout:
    """What is taken from a shot's files, and what is put back.

    Attributes
    ----------
    layers
        Role to the layer that a user names, see `stillray.io.channels.roles.parse_overrides`.
    aovs
        Layers of light to filter as the beauty; None for none, empty for all that are known.
    only_color
        Whether nothing but the picture is written.
    detection
        What the motion was proven to mean; None where that is known.
    samples
        Samples a pixel, whatever the files say; None for what they say.
    """

    layers: Mapping[str, str] = field(default_factory=dict)
    aovs: tuple[str, ...] | None = None
    only_color: bool = False
    detection: Detection | None = None
    samples: float | None = None

    @classmethod
    def of(
        cls,
        paths: Sequence[Path],
        *,
        layers: Mapping[str, str] | None = None,
        aovs: tuple[str, ...] | None = None,
        only_color: bool = False,
        temporal: bool = True,
        samples: float | None = None,
    ) -> Layout:
        """The layout of consecutive frames; without ``temporal`` no motion is looked at.

        Raises
        ------
        InputError
            A file that is looked at cannot be read.
        """
        detection = detect_in_sequence(paths, layers=layers) if temporal else None
        return cls(
            layers=layers or {},
            aovs=aovs,
            only_color=only_color,
            detection=detection,
            samples=samples,
        )

    def options(self) -> dict[str, str | float | bool | None]:
        """What of it changes the files that are written, by name."""
        convention = None if self.detection is None else self.detection.convention
        return {
            "layers": ",".join(f"{role}={name}" for role, name in sorted(self.layers.items())),
            "aovs": None if self.aovs is None else ",".join(self.aovs),
            "only_color": self.only_color,
            "motion": None if self.detection is None else str(convention),
            "samples": self.samples,
        }

    def read(
        self, path: Path, companions: Mapping[str, Any], before: Path | None
    ) -> tuple[Frame, dict[str, np.ndarray]]:
        """A frame, and its layers of light by name.

        Parameters
        ----------
        path, companions
            As `read_exr` takes them, companions by role.
        before
            File of the frame before it, if that was denoised.
        """
        convention = self.detection.convention if self.detection else None
        frame = read_exr(
            path,
            **companions,
            layers=self.layers,
            convention=convention,
            before=before,
            samples=self.samples,
        )
        lights = {} if self.aovs is None else read_lights(path, self.aovs, layers=self.layers)
        return frame, lights

    def write(
        self,
        path: Path,
        image: np.ndarray,
        lights: Mapping[str, np.ndarray],
        *,
        like: Path,
        attributes: Mapping[str, str] | None = None,
    ) -> int:
        """Write a clean frame in the structure of its source; how many values were clamped."""
        return write_exr(
            path,
            image,
            like=like,
            layers=self.layers,
            only_color=self.only_color,
            lights=lights,
            attributes=attributes,
        )
