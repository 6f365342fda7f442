"""Milliseconds of every stage, for several models and settings in turn; memory of each alone."""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from stillray.families.frame_graph import FRAME
from stillray.io.exr.read import read_exr
from stillray.io.exr.write import write_exr
from stillray.models.registry import ModelInfo
from stillray.pipeline.denoiser import Denoiser
from stillray.profiling.clip import Clip, open_clip, write_frame
from stillray.profiling.machine import output_of, peak_resident

#: All of `Denoiser.denoise`, and its part that no stage accounts for.
TOTAL, REST = "total", "rest"
#: The stages in the order of a frame's way, files included.
ORDER = (
    "read", "prefilter", "inspect", "repair", "remove_outliers", "find_filter", "demodulate",
    "expose", "specular_motion", "surface_guides", "enlarge", "warp", "reproject", "reject_history",
    "accumulate", "accumulate_albedo", "resample_output", "regress", "encode", "network",
    "filter", "reconstruct", "remodulate", "relief", "texture", "lamps", "rare_light", "layers",
    "learn", "keep_output", "remember",
    FRAME, REST, "write",
)  # fmt: skip
_SETTLING = 2  # frames that still allocate: two histories change places
_LEAST_FRAMES = 3
_FILE_TURNS = 3


@dataclass(frozen=True, kw_only=True)
class Setting:
    """What is measured: a model, as `Denoiser` takes it, on frames of a size."""

    model: str
    height: int
    width: int
    threads: int
    provider: str | None = None
    temporal: bool = True
    ensemble: int = 1


@dataclass(frozen=True, kw_only=True)
class Summary:
    """Of a number of milliseconds: percentiles are values that were measured."""

    median: float
    p95: float
    p99: float
    worst: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Summary:
        """Summarise one value or more."""
        p95, p99 = np.percentile(values, [95, 99], method="higher")
        return cls(
            median=float(np.median(values)), p95=float(p95), p99=float(p99), worst=max(values)
        )


@dataclass(frozen=True, kw_only=True)
class Run:
    """What was measured of a setting.

    Attributes
    ----------
    setting, info
        What was run.
    buffers
        Names of the buffers that the frames held.
    load, load_busy
        Milliseconds to open the model, and of processor time.
    first
        Stage to milliseconds of the very first frame: without a past, with all allocations.
    warm
        The same of every later frame that had a past, the first few left out.
    files
        Milliseconds of reading and writing, a list each; they do not depend on the model.
    precision
        Of the network, see `stillray.Denoiser.precision`.
    """

    setting: Setting
    info: ModelInfo
    buffers: tuple[str, ...]
    load: float
    load_busy: float
    first: dict[str, float]
    warm: list[dict[str, float]] = field(default_factory=list)
    files: dict[str, list[float]] = field(default_factory=dict)
    precision: str = "float32"

    @property
    def label(self) -> str:
        """The model's name, and the size of its ensemble if that is more than one."""
        ensemble = self.setting.ensemble
        return self.info.name if ensemble == 1 else f"{self.info.name}, ensemble of {ensemble}"

    def stages(self) -> dict[str, Summary]:
        """Stage to its warm milliseconds, in order, files and `TOTAL` included.

        A stage that did not run in a frame took 0 there.
        """
        seen = {name for row in self.warm for name in row} | set(self.files)
        return {
            name: Summary.of(self.files.get(name) or [row.get(name, 0.0) for row in self.warm])
            for name in (*ORDER, TOTAL)
            if name in seen
        }


def measure(
    settings: Sequence[Setting],
    clip: Clip,
    seconds: float,
    *,
    files: bool = True,
    progress: Callable[[int], object] = lambda frames: None,
) -> list[Run]:
    """Run settings of one size in turn, frame by frame, so that a drifting machine slows all.

    Parameters
    ----------
    settings
        What to run, all of the clip's size.
    clip
        The frames.
    seconds
        For how long, after the first frames; at least a few frames are run.
    files
        Whether reading and writing are timed too.
    progress
        Called with the number of frames that every setting has run.
    """
    with ExitStack() as stack:
        streams, runs = [], []
        for setting in settings:
            start, busy = time.perf_counter(), time.process_time()
            denoiser = stack.enter_context(open_denoiser(setting))
            load = 1e3 * (time.perf_counter() - start)
            load_busy = 1e3 * (time.process_time() - busy)
            stream = Stream(denoiser, clip)
            first = stream.next_frame()
            runs.append(
                Run(
                    setting=setting,
                    info=denoiser.model,
                    precision=denoiser.precision,
                    buffers=tuple(sorted(stream.clip.frames[0].given)),
                    load=load,
                    load_busy=load_busy,
                    first=first,
                )
            )
            streams.append(stream)
        file_times = _time_files(clip, streams[0].image) if files else {}
        for stream, run in zip(streams, runs, strict=True):
            run.files.update(file_times)
            for _ in range(_SETTLING):
                stream.next_frame()
        deadline = time.perf_counter() + seconds
        count = 0
        while count < _LEAST_FRAMES or time.perf_counter() < deadline:
            for stream, run in zip(streams, runs, strict=True):
                run.warm.append(stream.next_warm_frame())
            count += 1
            progress(count)
    return runs


def open_denoiser(setting: Setting) -> Denoiser:
    """The denoiser of a setting."""
    return Denoiser(
        setting.model,
        threads=setting.threads,
        providers=[setting.provider] if setting.provider else None,
        temporal=setting.temporal,
        ensemble=setting.ensemble,
    )


class Stream:
    """A clip through a denoiser, frame after frame without end."""

    def __init__(self, denoiser: Denoiser, clip: Clip) -> None:
        self._denoiser, self.clip = denoiser, clip.for_model(denoiser.model.spec)
        self._turn = 0
        self.image = np.zeros(0)  # the last result

    def next_frame(self) -> dict[str, float]:
        """Denoise a frame: milliseconds of its stages."""
        frame, cut = self.clip.frame(self._turn)
        self._turn += 1
        if cut:
            self._denoiser.reset()
        start = time.perf_counter()
        self.image = self._denoiser.denoise(frame)
        total = 1e3 * (time.perf_counter() - start)
        row = dict(self._denoiser.last_timings)
        return {**row, REST: max(total - sum(row.values()), 0.0), TOTAL: total}

    def next_warm_frame(self) -> dict[str, float]:
        """The next one that has a past."""
        if self._denoiser.temporal and self.clip.frame(self._turn)[1]:
            self.next_frame()
        return self.next_frame()


def _time_files(clip: Clip, image: np.ndarray) -> dict[str, list[float]]:
    times: dict[str, list[float]] = {"read": [], "write": []}
    with tempfile.TemporaryDirectory() as folder:
        source, target = clip.path, Path(folder) / "clean.exr"
        if source is None:
            source = Path(folder) / "noisy.exr"
            write_frame(source, clip.frames[0])
        for _ in range(_FILE_TURNS):
            start = time.perf_counter()
            read_exr(source)
            times["read"].append(1e3 * (time.perf_counter() - start))
            start = time.perf_counter()
            write_exr(target, image, like=source)
            times["write"].append(1e3 * (time.perf_counter() - start))
    return times


@dataclass(frozen=True, kw_only=True)
class Memory:
    """MiB of a process that denoises and does nothing else.

    Attributes
    ----------
    peak
        The most that was resident.
    net
        Over a process that holds the frames and the libraries only.
    """

    peak: float
    net: float


def measure_memory(settings: Sequence[Setting], source: str | None) -> list[Memory]:
    """Peak memory of every setting, each in a process of its own, on a clip of its size."""
    sizes = list(dict.fromkeys((setting.height, setting.width) for setting in settings))
    # nothing is timed here, so that two at once are well
    with ThreadPoolExecutor(2) as pool:
        bare = pool.map(lambda size: _alone(None, size, source).peak, sizes)
        full = pool.map(lambda s: _alone(s, (s.height, s.width), source).peak, settings)
        base = dict(zip(sizes, bare, strict=True))
        return [
            Memory(peak=peak, net=peak - base[setting.height, setting.width])
            for setting, peak in zip(settings, full, strict=True)
        ]


def measure_alone(setting: Setting, seconds: float = 0.0) -> tuple[float, Memory]:
    """Median milliseconds of a warm frame that is made up, and memory, of one process alone."""
    size = setting.height, setting.width
    bare, full = _alone(None, size, None), _alone(setting, size, None, seconds)
    return full.milliseconds, Memory(peak=full.peak, net=full.peak - bare.peak)


@dataclass(frozen=True, kw_only=True)
class _Alone:
    peak: float  # MiB
    milliseconds: float  # of a warm frame; 0 where nothing was denoised


def _alone(
    setting: Setting | None, size: tuple[int, int], source: str | None, seconds: float = 0.0
) -> _Alone:
    task = {
        "setting": None if setting is None else asdict(setting),
        "size": size,
        "source": source,
        "seconds": seconds,
    }
    return _Alone(**json.loads(output_of([sys.executable, "-m", __name__, json.dumps(task)])))


def _run_alone(task: dict[str, Any]) -> _Alone:
    clip = open_clip(task["source"], tuple(task["size"]))
    milliseconds: list[float] = []
    if task["setting"] is not None:
        with open_denoiser(Setting(**task["setting"])) as denoiser:
            stream = Stream(denoiser, clip)
            for _ in range(_SETTLING):
                stream.next_frame()
            deadline = time.perf_counter() + task["seconds"]
            while not milliseconds or time.perf_counter() < deadline:
                milliseconds.append(stream.next_warm_frame()[TOTAL])
    median = float(np.median(milliseconds)) if milliseconds else 0.0
    return _Alone(peak=peak_resident(), milliseconds=median)


if __name__ == "__main__":
    print(json.dumps(asdict(_run_alone(json.loads(sys.argv[1])))))
