"""How time and memory grow with pixels, kernels, their size and threads; exponents are fitted."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import prod

import numpy as np

from stillray.arrays.strips import Strips
from stillray.errors import InputError
from stillray.families.fused_kernels import FusedKernelsModel
from stillray.model_spec.loader import ModelSpec
from stillray.models.registry import find_model
from stillray.profiling.clip import DEFAULT_SIZE, open_clip
from stillray.profiling.machine import available_memory
from stillray.profiling.measure import TOTAL, Memory, Setting, measure, measure_alone
from stillray.stages.prepare import prepare
from stillray.stages.state import filterable

SIZES = (
    (270, 480),
    (540, 960),
    (720, 1280),
    (1080, 1920),
    (1440, 2560),
    (2160, 3840),
    (4320, 7680),
)
KERNELS = tuple(range(1, 13))  # of 3, 5, 7, ... pixels
KERNEL_SIZES = (3, 5, 7, 9, 13, 17, 21, 25, 31)  # pixels, one kernel each
_MEMORY_SHARE = 0.7  # of what is available may be asked for
_ROUNDS = 5


@dataclass(frozen=True, kw_only=True)
class Curve:
    """What one quantity costs.

    Attributes
    ----------
    name
        What grows: ``"pixels"``, ``"kernels"``, ``"kernel size"`` or ``"threads"``.
    subject
        What is measured.
    values
        Of what grows.
    labels
        The same, for people.
    milliseconds
        Median.
    memory
        Net MiB; empty where it was not measured.
    left_out
        Why there are no larger values, or nothing.
    """

    name: str
    subject: str
    values: list[float]
    labels: list[str]
    milliseconds: list[float]
    memory: list[float] = field(default_factory=list)
    left_out: str = ""

    @property
    def exponent(self) -> float | None:
        """``p`` of ``milliseconds ~ value^p``, least squares of the logarithms."""
        return fitted_exponent(self.values, self.milliseconds)

    @property
    def memory_exponent(self) -> float | None:
        """The same of memory."""
        return fitted_exponent(self.values, self.memory) if self.memory else None


def fitted_exponent(values: Sequence[float], costs: Sequence[float]) -> float | None:
    """``p`` of ``cost ~ value^p``; None for fewer than two points or a cost of nothing."""
    if len(set(values)) < 2 or min(costs) <= 0:
        return None
    return float(np.polyfit(np.log(values), np.log(costs), 1)[0])


def scaling_curves(
    model: str,
    *,
    threads: int,
    sizes: Sequence[tuple[int, int]] = SIZES,
    progress: Callable[[str], None] = lambda line: None,
) -> list[Curve]:
    """All curves.

    Parameters
    ----------
    model
        Of the curves against pixels and threads, as `Denoiser` takes it.
    threads
        The most.
    sizes
        Height and width in pixels, growing; those that memory does not allow are left out.
    progress
        Called with a line that says what is being done.
    """
    return [
        against_pixels(model, sizes, threads=threads, progress=progress),
        against_kernels(threads=threads, progress=progress),
        against_kernel_size(threads=threads, progress=progress),
        against_threads(model, threads, progress=progress),
    ]


def against_pixels(
    model: str,
    sizes: Sequence[tuple[int, int]],
    *,
    threads: int,
    progress: Callable[[str], None] = lambda line: None,
) -> Curve:
    """A whole warm frame, and its memory, at several sizes, each in a process of its own."""
    done: list[tuple[int, int]] = []
    milliseconds: list[float] = []
    memories: list[Memory] = []
    left_out = ""
    for height, width in sizes:
        pixels, free = height * width, available_memory()
        # memory grows at most like the pixels: the process of the last size tells
        if done and memories[-1].peak * pixels / prod(done[-1]) > _MEMORY_SHARE * free:
            left_out = f"{width} x {height} would not fit into {free / 1024:.0f} GiB"
            break
        progress(f"{width} x {height}")
        setting = Setting(model=model, height=height, width=width, threads=threads)
        taken, memory = measure_alone(setting, seconds=1.5)
        done.append((height, width))
        milliseconds.append(taken)
        memories.append(memory)
    return Curve(
        name="pixels",
        subject=f"a warm frame, {find_model(model).name}",
        values=[float(height * width) for height, width in done],
        labels=[f"{width} x {height}" for height, width in done],
        milliseconds=milliseconds,
        memory=[memory.net for memory in memories],
        left_out=left_out,
    )


def against_kernels(*, threads: int, progress: Callable[[str], None] = lambda line: None) -> Curve:
    """The reconstruction with 1 to 12 fused kernels of 3, 5, 7, ... pixels."""
    progress("kernels")
    choices = [tuple(range(3, 3 + 2 * count, 2)) for count in KERNELS]
    return Curve(
        name="kernels",
        subject=f"reconstruction, {_size_label()}",
        values=[float(count) for count in KERNELS],
        labels=[str(count) for count in KERNELS],
        milliseconds=time_reconstruction(choices, threads=threads),
    )


def against_kernel_size(
    *, threads: int, progress: Callable[[str], None] = lambda line: None
) -> Curve:
    """The reconstruction with a single kernel of 3 to 31 pixels."""
    progress("kernel sizes")
    return Curve(
        name="kernel size",
        subject=f"reconstruction with one kernel, {_size_label()}",
        values=[float(size) for size in KERNEL_SIZES],
        labels=[str(size) for size in KERNEL_SIZES],
        milliseconds=time_reconstruction([(size,) for size in KERNEL_SIZES], threads=threads),
    )


def against_threads(
    model: str, most: int, progress: Callable[[str], None] = lambda line: None
) -> Curve:
    """A whole warm frame with 1, 2, 4, ... threads, in turn."""
    progress("threads")
    counts = [1 << power for power in range(most.bit_length())]
    if counts[-1] < most:
        counts.append(most)
    height, width = DEFAULT_SIZE
    settings = [Setting(model=model, height=height, width=width, threads=count) for count in counts]
    runs = measure(settings, open_clip(size=DEFAULT_SIZE), 2.0 * len(counts), files=False)
    return Curve(
        name="threads",
        subject=f"a warm frame, {runs[0].info.name}, {_size_label()}",
        values=[float(count) for count in counts],
        labels=[str(count) for count in counts],
        milliseconds=[run.stages()[TOTAL].median for run in runs],
    )


def time_reconstruction(
    choices: Sequence[tuple[int, ...]],
    *,
    threads: int,
    size: tuple[int, int] = DEFAULT_SIZE,
    rounds: int = _ROUNDS,
) -> list[float]:
    """Median milliseconds of the weight-sharing reconstruction, the choices in turn.

    Models come with fixed kernels, and what a logit holds does not change what it costs: these are
    random.

    Parameters
    ----------
    choices
        Kernel sizes to fuse, pixels.
    threads
        Where it runs.
    size
        Height and width, pixels.
    rounds
        How often each is run.
    """
    base = find_model("wskp-6").spec  # whose logits come by pixels
    strips = Strips(threads)
    frame = open_clip(size=size).frames[0]
    prepared = prepare(frame, base, None, strips)
    light = filterable(prepared, None)
    most = 2 * max(len(sizes) for sizes in choices)
    logits = np.random.default_rng(0).normal(size=(most, *size)).astype(np.float32)
    times: list[list[float]] = [[] for _ in choices]
    for turn in range(rounds + 1):
        for sizes, found in zip(choices, times, strict=True):
            model = FusedKernelsModel(with_kernels(base, sizes))
            maps = logits[: 2 * len(sizes)]
            start = time.perf_counter()
            model.reconstruct(light, [maps], strips, {})
            if turn:  # the first round allocates
                found.append(1e3 * (time.perf_counter() - start))
    strips.close()
    return [float(np.median(found)) for found in times]


def with_kernels(spec: ModelSpec, sizes: tuple[int, ...]) -> ModelSpec:
    """A specification whose decoder fuses kernels of other sizes, pixels.

    Raises
    ------
    InputError
        The model has no fused kernels.
    """
    if spec.family != "weight-sharing-kernels":
        raise InputError(f"model must be of the weight-sharing kernels, got {spec.name}")
    return replace(spec, decoder=spec.decoder.with_kernels(sizes))


def _size_label() -> str:
    height, width = DEFAULT_SIZE
    return f"{width} x {height}"


def in_words(curve: Curve) -> str:
    """The curve in a line: its exponent, and what the first and the last value cost."""
    first, last = curve.milliseconds[0], curve.milliseconds[-1]
    exponent = curve.exponent
    fitted = "one value" if exponent is None else f"time ~ {curve.name}^{exponent:.2f}"
    if curve.memory_exponent is not None:
        fitted += f", memory ~ {curve.name}^{curve.memory_exponent:.2f}"
    ends = f"{curve.labels[0]} {first:.1f} ms, {curve.labels[-1]} {last:.1f} ms"
    line = f"{curve.subject}: {fitted}; {ends} ({last / first:.2f} times)"
    return f"{line}; {curve.left_out}" if curve.left_out else line
