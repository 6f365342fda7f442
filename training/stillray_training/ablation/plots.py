"""Quality and time against kernels, as figures 9 and 10 of Fan et al. 2021 have them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from stillray.profiling.plot import new_figure, save
from stillray_training.ablation.results import Results
from stillray_training.ablation.variants import (
    COMPARISONS,
    KERNEL_COUNTS,
    SIZES,
    fused,
    single,
    sizes_of,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_PEERS = COMPARISONS[0].variants


def draw_kernels(results: Results, path: Path) -> None:
    """PSNR of single and of fused kernels, the time of fusing them, and the peers in both."""
    figure, (quality, time, peers) = new_figure(15, 4.2, 1, 3)
    places = [size // 2 for size in SIZES]
    _line(quality, places, [single(size) for size in SIZES], results, "one kernel of this size")
    _line(
        quality, list(KERNEL_COUNTS), [fused(count) for count in KERNEL_COUNTS], results,
        "fused, 3x3 to this size",
    )  # fmt: skip
    ticks = [sizes_of(count)[-1] for count in KERNEL_COUNTS]
    quality.set_xticks(list(KERNEL_COUNTS), [f"{size}" for size in ticks])
    quality.set_xlabel("pixels of the only or the largest kernel")
    quality.set_ylabel("PSNR dB, mean of the scenes")
    quality.legend()
    timed = [count for count in KERNEL_COUNTS if fused(count) in results.milliseconds]
    spent = [results.milliseconds[fused(count)]["reconstruct"] for count in timed]
    time.plot(timed, spent, "o-")
    time.set_ylim(bottom=0)
    time.set_xlabel("fused kernels")
    time.set_ylabel(f"milliseconds of reconstruction, {results.size[1]}x{results.size[0]}")
    for name in _PEERS:
        if name in results.scores and name in results.milliseconds:
            at = (results.milliseconds[name]["both"], results.mean(name)["psnr"].mean)
            marker, color = ("s", "C3") if "KP" in name else ("o", "C0")
            peers.plot(*at, marker, color=color)
            peers.annotate(name, at, xytext=(6, 4), textcoords="offset points")
    peers.set_xlim(left=0)
    peers.margins(x=0.15, y=0.15)
    peers.set_xlabel("milliseconds of network and reconstruction")
    peers.set_ylabel("PSNR dB")
    for axes in (quality, time, peers):
        axes.grid(True, alpha=0.3)
    save(figure, path)


def _line(
    axes: Axes, places: Sequence[int], names: Sequence[str], results: Results, label: str
) -> None:
    found = [
        (place, results.mean(name)["psnr"])
        for place, name in zip(places, names, strict=True)
        if name in results.scores
    ]
    axes.errorbar(
        [place for place, _ in found],
        [psnr.mean for _, psnr in found],
        yerr=[psnr.deviation or 0.0 for _, psnr in found],
        fmt="o-",
        capsize=3,
        label=label,
    )
