# SPDX-License-Identifier: GPL-3.0-or-later
"""A rendered sequence from files to files, in a thread: which files, how far, how it ended."""

import os
import threading
from typing import NamedTuple

import bpy

FOLDER = "denoised"  # beside the renders, where no output is named


class Files(NamedTuple):
    """What is read, and where it goes: as `stillray.denoise_shot` takes both."""

    sources: list[str]
    output: str


def files_of(scene, input_path: str, output_path: str) -> Files:
    """The files that `cycles.denoise_animation` would take for the same properties.

    Parameters
    ----------
    scene : bpy.types.Scene
        Its frame range and output path name the sequence where there is no input path.
    input_path
        One file; or empty.
    output_path
        A file for one file, a path as Blender's output path for a sequence; empty for the folder
        ``denoised`` beside the input. Nothing is ever overwritten by its own result.

    Raises
    ------
    FileNotFoundError
        A frame is not there.
    """
    if input_path:
        sources = [bpy.path.abspath(input_path)]
    else:
        frames = range(scene.frame_start, scene.frame_end + 1, scene.frame_step)
        sources = [bpy.path.abspath(scene.render.frame_path(frame=frame)) for frame in frames]
    for source in sources:
        if not os.path.isfile(source):
            raise FileNotFoundError(f"no rendered frame at {source}: render the animation first")
    if not output_path:
        return Files(sources, os.path.join(os.path.dirname(sources[0]), FOLDER, ""))
    output = bpy.path.abspath(output_path)
    if not input_path and not output.endswith(("/", os.sep)):
        output = _pattern(output)
    return Files(sources, output)


def _pattern(path: str) -> str:
    """Blender's output path as a pattern: the number stands at its end, unless # say where."""
    stem, extension = (path[:-4], path[-4:]) if path.lower().endswith(".exr") else (path, ".exr")
    return (stem if "#" in os.path.basename(stem) else f"{stem}####") + extension


class SequenceJob:
    """`stillray.denoise_shot` in a thread.

    Parameters
    ----------
    files
        From `files_of`.
    quality, ensemble, temporal
        As the settings have them.
    motion
        Whether the files' motion vectors can be used.
    filter_spread
        Of the scene's pixel filter, see `stillray.Frame`.
    """

    def __init__(
        self,
        files: Files,
        *,
        quality: str,
        temporal: bool,
        ensemble: int = 1,
        motion: bool = True,
        filter_spread: float | None = None,
    ) -> None:
        self.done, self.count = 0, len(files.sources)
        self.error, self.cancelled = "", False
        self._files, self._quality = files, quality
        self._temporal, self._ensemble, self._motion = temporal, ensemble, motion
        self._filter_spread = filter_spread
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="stillray-sequence")

    def start(self) -> None:
        """Begin."""
        self._thread.start()

    def cancel(self) -> None:
        """Stop after the frames in work; what is written stays."""
        self._stop.set()

    @property
    def running(self) -> bool:
        """Whether it is not done yet."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Until it is done."""
        self._thread.join()

    def _run(self) -> None:
        from stillray import InputError, ShotOptions, denoise_shot

        try:
            options = ShotOptions(
                temporal=self._temporal,
                ensemble=self._ensemble,
                filter_spread=self._filter_spread,
                layers={} if self._motion else {"motion": "none"},
            )
            ran = denoise_shot(
                self._files.sources,
                self._files.output,
                model=self._quality,
                options=options,
                progress=self._count,
                cancel=self._stop.is_set,
            )
            self.cancelled = ran.cancelled
        except InputError as error:
            self.error = str(error)
        except Exception as error:  # told, not lost with the thread
            self.error = f"{type(error).__name__}: {error}"

    def _count(self, _frame) -> None:
        self.done += 1
