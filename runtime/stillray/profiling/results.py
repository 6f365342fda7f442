"""A profile: times, memory, work and the machine's peaks of several settings, put together."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import groupby

from stillray.profiling.clip import open_clip
from stillray.profiling.cost import Cost, stage_costs
from stillray.profiling.machine import PeakRates, measure_peak_rates
from stillray.profiling.measure import TOTAL, Memory, Run, Setting, measure, measure_memory


@dataclass(frozen=True, kw_only=True)
class Result:
    """All there is to know of one setting.

    Attributes
    ----------
    run
        Its times.
    work
        Stage to what it has to do; files and what no stage accounts for are absent.
    peaks
        The machine's, with the setting's threads.
    memory
        None where it was not asked for.
    """

    run: Run
    work: dict[str, Cost]
    peaks: PeakRates
    memory: Memory | None

    def roofline(self, stage: str) -> float | None:
        """Milliseconds that a stage, or `TOTAL`, takes at least; None where nothing is known."""
        if stage == TOTAL:
            return sum(self.roofline(name) or 0.0 for name in self.run.stages() if name != TOTAL)
        return self.work[stage].roofline(self.peaks) if stage in self.work else None


def profile_settings(
    settings: Sequence[Setting],
    *,
    source: str | None,
    seconds: float,
    memory: bool,
    progress: Callable[[str], None] = lambda line: None,
) -> list[Result]:
    """Measure settings on a clip; those of one size in turn, frame by frame.

    Parameters
    ----------
    settings
        What to run; those of one size follow each other.
    source
        As `stillray.profiling.clip.open_clip` takes it.
    seconds
        For how long, shared among the sizes.
    memory
        Whether peak memory is measured too.
    progress
        Called with a line that says what is being done.

    Raises
    ------
    InputError
        A model, a provider or the source cannot be used.
    """
    sizes = [
        (size, list(group)) for size, group in groupby(settings, lambda s: (s.height, s.width))
    ]
    peaks: dict[int, PeakRates] = {}
    for count in dict.fromkeys(setting.threads for setting in settings):
        progress(f"the machine's peaks, {count} threads")
        peaks[count] = measure_peak_rates(count)
    runs: list[Run] = []
    work: list[dict[str, Cost]] = []
    for size, group in sizes:
        height, width = size
        clip = open_clip(source, size)

        def of_frame(count: int, height: int = height, width: int = width) -> None:
            progress(f"{width} x {height}: frame {count}")

        progress(f"{width} x {height}: first frames")
        found = measure(group, clip, seconds / len(sizes), progress=of_frame)
        runs += found
        work += [stage_costs(run.info, clip.frames[0], run.precision) for run in found]
    progress("memory")
    memories = measure_memory(settings, source) if memory else [None] * len(runs)
    return [
        Result(run=run, work=needed, peaks=peaks[run.setting.threads], memory=taken)
        for run, needed, taken in zip(runs, work, memories, strict=True)
    ]
