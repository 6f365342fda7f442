"""How the files of a shot are read and written: found out once, the same for every frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from stillray.errors import InputError, printable
from stillray.frame import GUIDES, Frame
from stillray.io.channels.motion_detection import Detection, detect_in_sequence
from stillray.io.channels.roles import JITTER
from stillray.io.exr.jitter import JITTER_ATTRIBUTE
from stillray.io.exr.layers import colors_beside
from stillray.io.exr.read import read_lights
from stillray.io.exr.views import VIEW
from stillray.io.exr.write import CleanView, expected_changes, write_color, write_exr, write_views
from stillray.io.frame_file import read_frame, roles_of, views_to_denoise
from stillray.io.image_file import is_float_map, kind_of_map, write_image


class ViewFrame(NamedTuple):
    """One view of a frame: its buffers, and its layers of light by name."""

    frame: Frame
    lights: dict[str, np.ndarray]


class CleanPicture(NamedTuple):
    """One view's clean picture ``(h, w, 3)``, and its filtered layers by name."""

    image: np.ndarray
    lights: dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Told:
    """What a user says of every frame; None where its file is to say it.

    Attributes
    ----------
    samples, filter_spread
        As in `stillray.Frame`, numbers.
    clean_features
        As in `stillray.Frame`.
    """

    samples: float | None = None
    filter_spread: float | None = None
    clean_features: bool = False


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
    told
        What a user says of the frames, whatever the files say.
    views
        Names of the views, all of which are denoised; empty for one picture, or where ``layers``
        choose a view.
    knows_jitter
        Whether the model looks at the frames' jitter, see `stillray.model_spec.ModelSpec`.
        What a model does not look at stands in the files as it stood, whatever it is.
    roles
        Of the buffers that the first frame's files have, that with the color and all others.
    """

    layers: Mapping[str, str] = field(default_factory=dict)
    aovs: tuple[str, ...] | None = None
    only_color: bool = False
    detection: Detection | None = None
    told: Told = Told()
    views: tuple[str, ...] = ()
    knows_jitter: bool = True
    roles: frozenset[str] = frozenset()

    @classmethod
    def of(
        cls,
        paths: Sequence[Path],
        *,
        layers: Mapping[str, str] | None = None,
        aovs: tuple[str, ...] | None = None,
        only_color: bool = False,
        temporal: bool = True,
        told: Told = Told(),
    ) -> Layout:
        """The layout of consecutive frames; without ``temporal`` no motion is looked at.

        Raises
        ------
        InputError
            A file that is looked at cannot be read; or what was asked for needs one view alone.
        """
        layers = layers or {}
        views = views_to_denoise(paths[0], layers)
        if views and only_color:
            raise InputError(
                f"only-color must be given with --view of files with views, {paths[0]} has "
                f"{', '.join(views)}"
            )
        # a renderer's motion means the same for all of its views
        looked_at = {**layers, VIEW: views[0]} if views else layers
        temporal = temporal and not is_float_map(paths[0])
        return cls(
            layers=layers,
            aovs=aovs,
            only_color=only_color,
            detection=detect_in_sequence(paths, layers=looked_at) if temporal else None,
            told=told,
            views=views,
            roles=roles_of(paths[0], looked_at),
        )

    @property
    def has_motion(self) -> bool:
        """Whether frames have motion whose meaning is known, and so can have a past."""
        proven = self.detection is not None and self.detection.convention is not None
        return proven or "motion" in self.roles

    @property
    def guided(self) -> bool:
        """As `stillray.Frame` has it, of all frames."""
        return not self.roles.isdisjoint(GUIDES)

    @property
    def of_views(self) -> tuple[Mapping[str, str], ...]:
        """The layers of each view; of the one picture, where there are no views."""
        return tuple({**self.layers, VIEW: view} for view in self.views) or (self.layers,)

    def options(self) -> dict[str, str | float | bool | None]:
        """What of it changes the files that are written, by name."""
        convention = None if self.detection is None else self.detection.convention
        return {
            "layers": ",".join(f"{role}={name}" for role, name in sorted(self.layers.items())),
            "aovs": None if self.aovs is None else ",".join(self.aovs),
            "only_color": self.only_color,
            "motion": None if self.detection is None else str(convention),
            "samples": self.told.samples,
            "filter_spread": self.told.filter_spread,
            **({"clean_features": True} if self.told.clean_features else {}),
            **({"views": ",".join(self.views)} if self.views else {}),
        }

    def read(
        self, path: Path, companions: Mapping[str, Any], before: Path | None
    ) -> tuple[ViewFrame, ...]:
        """A frame in each of its views.

        Parameters
        ----------
        path, companions
            As `stillray.io.frame_file.read_frame` takes them.
        before
            File of the frame before it, if that was denoised.

        Raises
        ------
        InputError
            A file cannot be read, lacks its buffer or a view, or has other layers than were named.
        """
        convention = self.detection.convention if self.detection else None
        found = []
        for layers in self.of_views:
            frame = read_frame(
                path,
                companions,
                layers=layers if self.knows_jitter else {**layers, JITTER: "none"},
                convention=convention,
                before=before,
                samples=self.told.samples,
            )
            if self.told.filter_spread is not None:
                frame = replace(frame, filter_spread=self.told.filter_spread)
            frame = replace(frame, clean_features=self.told.clean_features)
            lights = {}
            if self.aovs is not None and not is_float_map(path):
                lights = read_lights(path, self.aovs, layers=layers)
            found.append(ViewFrame(frame, lights))
        return tuple(found)

    def changes(self, source: Path, output: Path, scale: int = 1) -> list[str]:
        """What of a source's structure its output cannot keep, each in a line.

        Parameters
        ----------
        source, output
            Of one frame.
        scale
            Pixels of the picture for one of the frame, along each axis.
        """
        if scale > 1:
            return [
                f"pictures are {scale} times as wide and high: files hold the color alone, with "
                "their windows enlarged; other layers stay in the sources"
            ]
        if self.only_color or is_float_map(source):
            return []
        if is_float_map(output):
            return [f"{output.suffix} files hold the color alone"]
        lines = [line for layers in self.of_views for line in expected_changes(source, layers)]
        return list(dict.fromkeys(lines))

    def rewritten(self, source: Path, output: Path) -> list[str]:
        """What else than the picture and the layers that were named is not the source's, in a line.

        Parameters
        ----------
        source, output
            Of one frame.
        """
        if self.aovs is None or is_float_map(source) or is_float_map(output):
            return []
        views = (colors_beside(source, self.aovs, layers=layers) for layers in self.of_views)
        names = dict.fromkeys(name for view in views for name in view)
        if not names:
            return []
        line = (
            f"written anew as well: {', '.join(names)}, filtered as the light that they are to be "
            "multiplied by, so that it still adds up to the picture; as rendered they stay in the "
            "sources"
        )
        return [printable(line)]

    def write(
        self,
        path: Path,
        pictures: Sequence[CleanPicture],
        *,
        like: Path,
        attributes: Mapping[str, str] | None = None,
    ) -> int:
        """Write a clean frame in the structure of its source; how many values were clamped.

        Parameters
        ----------
        path
            An EXR file, or a float map, which holds the picture alone.
        pictures
            One a view, in the order of ``views``.
        like
            The source.
        attributes
            What is told of it in an EXR file.
        """
        told: dict[str, str | None] = dict(attributes or {})
        if self.knows_jitter:
            told[JITTER_ATTRIBUTE] = None  # of the source's samples, not of this picture's
        if self.views:
            clean = [
                CleanView(layers=layers, image=image, lights=lights)
                for layers, (image, lights) in zip(self.of_views, pictures, strict=True)
            ]
            return write_views(path, clean, like=like, attributes=told)
        (picture,) = pictures
        if is_float_map(path):
            write_image(path, picture.image)
            return 0
        if is_float_map(like):
            return write_color(path, picture.image, kind=kind_of_map(like), attributes=told)
        if self.only_color:
            return write_color(path, picture.image, like=like, layers=self.layers, attributes=told)
        return write_exr(
            path,
            picture.image,
            like=like,
            layers=self.layers,
            lights=picture.lights,
            attributes=told,
        )
