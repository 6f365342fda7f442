"""What the papers found, beside what we find, and whether that agrees."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from stillray_training.ablation.results import Results, Value
from stillray_training.ablation.variants import (
    BASE,
    KERNEL_COUNTS,
    MULTI_RESOLUTION,
    ONE_LAYER,
    PAPER_INPUT,
    SIZES,
    at_many,
    fused,
    single,
)

HOLDS = "holds"
# decibels between models that the paper calls as good as each other
_ALIKE = 0.2
# a ratio of times may differ from the paper's graphics processor by this factor
_TIMES_ALIKE = 1.25
#: Quantiles of Student's t for 95 % on both sides, by the number of seeds from two on.
_STUDENT = (12.71, 4.30, 3.18, 2.78, 2.57, 2.45, 2.36, 2.31, 2.26)
#: Seeds that a study has at most.
MOST_SEEDS = len(_STUDENT) + 1
_UNKNOWN = "one seed alone"
_SEEDS_DIFFER = "seeds differ as much"


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A difference in PSNR, or a ratio of times, of two variants.

    Attributes
    ----------
    text
        What is claimed.
    of, to
        The variants: PSNR of the first less that of the second, or time of the first over it.
    paper
        The same in the paper's averages, dB or a ratio; None where it gives a plot alone.
    times
        Whether it is about time.
    alike
        Whether both are said to be about as good, where the paper gives a plot alone.
    why
        What explains it where ours differs.
    """

    text: str
    of: str
    to: str
    paper: float | None
    times: bool = False
    alike: bool = False
    why: str = ""


CLAIMS = (
    Claim(text="wskp-6 is as good as KP (table 1)", of=BASE, to="KP", paper=30.323 - 30.332),
    Claim(
        text="wskp-6 takes half of KP's time (table 3)", of=BASE, to="KP", paper=12.89 / 27.86,
        times=True,
    ),
    Claim(
        text="wskp-3 is below wskp-6 (table 1)", of="wskp-3", to=BASE, paper=29.637 - 30.323,
        why="The training is short: on the same patches the two still have about the same loss, "
        "so the deeper one has not yet made use of its depth.",
    ),
    Claim(
        text="wskp-3 takes half of wskp-6's (table 3)", of="wskp-3", to=BASE, paper=6.58 / 12.89,
        times=True,
    ),
    Claim(text="KP-1 is below wskp-6 (table 6)", of="KP-1", to=BASE, paper=29.517 - 30.323),
    Claim(
        text="KP-1 is slower than wskp-6 (table 6)", of="KP-1", to=BASE, paper=19.70 / 12.89,
        times=True,
        why="Its last convolution and its 169 weights a pixel stay, and on a processor those "
        "weights pass through memory twice.",
    ),
    Claim(text="KP-2 is below wskp-6 (table 6)", of="KP-2", to=BASE, paper=29.809 - 30.323),
    Claim(
        text="KP-2 is as fast as wskp-6 (table 6)", of="KP-2", to=BASE, paper=12.99 / 12.89,
        times=True,
        why="Its last convolution to 49 outputs takes more operations than the block that it "
        "saves, and its 49 weights a pixel pass through memory twice.",
    ),
    Claim(
        text="MR-KP is as good as wskp-6 (table 1)", of="MR-KP", to=BASE, paper=30.322 - 30.323
    ),
    Claim(
        text="MR-KP takes twice wskp-6's time (table 3)", of="MR-KP", to=BASE,
        paper=24.73 / 12.89, times=True,
        why="Our U-Net takes less time beside wskp-6 than the paper's, whose own multi-resolution "
        "model takes 1.76 of wskp-6's, too.",
    ),
    Claim(
        text="wskp-mr is as good as MR-KP, 1 sample (the paper at 64: table 4)",
        of=MULTI_RESOLUTION, to="MR-KP",
        # kitchen, dining room; bedroom, classroom, living room
        paper=(35.88 + 38.03 + 36.34 + 32.82 + 38.53) / 5
        - (36.31 + 37.87 + 36.32 + 32.99 + 38.02) / 5,
    ),
    Claim(
        text="wskp-mr takes nine tenths of MR-KP's time (table 3)", of=MULTI_RESOLUTION,
        to="MR-KP", paper=22.70 / 24.73, times=True,
    ),
    *(
        Claim(text=f"six fused kernels are above one of {size}x{size} (figure 9)", of=BASE,
              to=single(size), paper=None)
        for size in (3, 5, 7, 9, 11, 13)
    ),
    *(
        Claim(text=f"{count} fused kernels are above {before} (figure 10)", of=fused(count),
              to=fused(before), paper=None)
        for before, count in pairwise(KERNEL_COUNTS)
        if count <= len(SIZES)
    ),
    *(
        Claim(text=f"{count} fused kernels are hardly above {len(SIZES)} (figure 10)",
              of=fused(count), to=BASE, paper=None, alike=True)
        for count in KERNEL_COUNTS
        if count > len(SIZES)
    ),
    Claim(
        text="six of one size are below six sizes (supplement, table 5)", of="6 kernels of 13x13",
        # without the scene whose figure is misprinted, ten above the other methods'
        to=BASE, paper=(32.572 + 33.548 + 23.946 + 34.319 + 30.385) / 5
        - (32.827 + 34.063 + 24.269 + 34.600 + 30.805) / 5,
    ),
    Claim(
        text="without the extra branches it is worse (table 5)", of="wskp-6, no branches", to=BASE,
        paper=(33.470 + 33.925) / 2 - (34.063 + 34.600) / 2,
    ),
    Claim(
        text="our twelve planes are above the paper's ten (section 5.1)", of=BASE, to=PAPER_INPUT,
        paper=None,
    ),
    Claim(
        text="without the extra branches KP is hardly worse (table 5)", of="KP, no branches",
        to="KP", paper=(33.962 + 34.541) / 2 - (34.090 + 34.595) / 2,
    ),
    Claim(
        text="fusion makes KP better (supplement, table 5)", of="KP-fusion", to="KP",
        paper=(33.308 + 34.506 + 24.348 + 35.068 + 30.739 + 25.424) / 6
        - (33.047 + 34.090 + 24.215 + 34.595 + 30.719 + 25.324) / 6,
    ),
    Claim(
        text="wskp-mr is as good as MR-KP, 64 samples (table 4; supplement, table 7)",
        of=at_many(MULTI_RESOLUTION), to=at_many("MR-KP"),
        # kitchen, dining room; bedroom, classroom, living room
        paper=(35.88 + 38.03 + 36.34 + 32.82 + 38.53) / 5
        - (36.31 + 37.87 + 36.32 + 32.99 + 38.02) / 5,
    ),
    Claim(
        text="wskp-mr is as good as KP, 64 samples (table 4; supplement, table 7)",
        of=at_many(MULTI_RESOLUTION), to=at_many("KP"),
        paper=(35.88 + 38.03 + 36.34 + 32.82 + 38.53) / 5
        - (36.03 + 38.11 + 36.36 + 32.89 + 38.46) / 5,
    ),
    Claim(
        text="MR-KP of one layer is below MR-KP (Meng et al., table 1)", of=ONE_LAYER, to="MR-KP",
        paper=(31.392 + 30.311 + 22.482 + 29.912 + 27.303 + 23.637) / 6
        - (32.177 + 31.995 + 22.950 + 29.476 + 26.447 + 25.090) / 6,
    ),
    Claim(
        text="MR-KP of one layer takes two thirds of MR-KP's time (Meng et al., table 3)",
        of=ONE_LAYER, to="MR-KP", paper=25.321 / 39.527, times=True,
    ),
)  # fmt: skip


def measured(claim: Claim, results: Results) -> Value | None:
    """Our figure for a claim; None where a variant was not trained or timed."""
    if not claim.times:
        return results.difference(claim.of, claim.to)
    if not all(name in results.ratios for name in (claim.of, claim.to)):
        return None
    ratio = results.ratios[claim.of]["both"] / results.ratios[claim.to]["both"]
    return Value(mean=ratio, deviation=None, seeds=1)


def rises_in(claim: Claim, results: Results) -> str:
    """In how many scenes the first is above the second over all seeds, as in "2 of 3"."""
    scenes = list(next(iter(results.scores[claim.to].values())))
    above = [
        results.of_scene(claim.of, scene)["psnr"].mean
        > results.of_scene(claim.to, scene)["psnr"].mean
        for scene in scenes
    ]
    return f"{sum(above)} of {len(above)}"


def uncertainty(found: Value) -> float | None:
    """Half of the interval in which the mean over all seeds lies, 95 %; None of one seed."""
    if found.deviation is None:
        return None
    quantile = _STUDENT[found.seeds - 2]
    return float(quantile * found.deviation / found.seeds**0.5)


def verdict(claim: Claim, found: Value) -> str:
    """Whether what was found agrees, in a few words.

    Of one seed nothing is concluded. "As good" holds where the mean is within a fifth of a decibel
    and seeds tell it well enough for that; "above" and "below" where the interval of the mean is on
    that side.

    Parameters
    ----------
    claim, found
        The claim and our figure for it.
    """
    if claim.times:
        assert claim.paper is not None
        off = found.mean / claim.paper
        if 1 / _TIMES_ALIKE <= off <= _TIMES_ALIKE:
            return HOLDS
        return "less than that" if off < 1 else "more than that"
    unsure = uncertainty(found)
    if unsure is None:
        return _UNKNOWN
    if claim.alike or (claim.paper is not None and abs(claim.paper) < _ALIKE / 2):
        return _alike(abs(found.mean), unsure)
    if abs(found.mean) <= unsure:
        return _SEEDS_DIFFER
    return HOLDS if (found.mean > 0) == _rises(claim) else "does not hold"


def _alike(apart: float, unsure: float) -> str:
    if apart + unsure <= _ALIKE:
        return HOLDS
    return "does not hold" if apart - unsure > _ALIKE else _SEEDS_DIFFER


def _rises(claim: Claim) -> bool:
    """Whether the first is claimed to be above the second."""
    return claim.paper is None or claim.paper > 0
