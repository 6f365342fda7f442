"""``python -m tests.hard_cases --report docs/hard-cases.md``: measure, and write the tables.

With ``--seconds`` the search for the worst errors of the operators runs longer.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import stillray
from stillray.io.atomic import atomic_path
from tests import worst_errors
from tests.conftest import NotAccumulatedError
from tests.hard_cases.case import Case
from tests.hard_cases.catalogue import BY_NAME, CASES, OfFrameSize, models_and_providers
from tests.hard_cases.features import ON_DEMAND

_HEAD = """# Hard cases

Written by `python -m tests.hard_cases --report docs/hard-cases.md`. The suite runs the
same cases over every packaged model and every ONNX Runtime provider that is installed, and fails
where a figure is above its limit: a new model is not done until it passes. Figures in bold
are above it; they are known, and listed with their reason below the table. Models that
are found by their name alone, those for frames without a past and those on trial, come last and are
not held to the limits; pictures of those that double are brought to the frame's size first. Where
frames have no past, how soon a picture follows its light says how noisy one frame is.

Frames are 24x33 pixels unless a case says otherwise. "The surroundings" of a firefly are a wall and
a box of radiance 0.1 to 0.7, without noise, so that all that differs is what the firefly did.

"""

_LIGHT = """
## What bounds a bright sample

A sample of luminance L that is accumulated into a pixel with n samples weighs
1 / (1 + x²/(1 + x)), x = L / u, where u = 16 (1 + n) times the light around it (13x13 pixels,
tone-mapped mean; 64/4 = `outlier_ratio`/4). Ordinary noise weighs 1, so its energy is kept; weight
times luminance stays below u for any L; and u grows with n, so what a bright sample is denied in a
new pixel it is given in an old one, where it moves the mean no further. Weights end at 0.1, and a
sample that would weigh less is made darker: **a pixel more than 160 times brighter than its
surroundings is darkened to 160 times in its first frame, 2,700 times from the 17th on.** That also
holds for a lamp or a glint that is really there and a pixel or two large. In the pyramids a sample
that weighs less than one also counts as much less for its own pixel, whatever the network says: a
first frame's firefly lifted a pixel of the kpyr-5s of then 2.2 times, for 7.4 without it.

| 3 validation scenes | PSNR dB, before | now | SMAPE, before | now |
|---|---|---|---|---|
| kpyr-5 with the weights of then | 27.25 | 27.39 | 0.0600 | 0.0584 |
| wskp-6 | 25.91 | 25.96 | 0.0678 | 0.0668 |

Before, weights were 1 / (1 + L / (64 s)) with a least weight of 1e-6. Over 120 still frames that
took 3.2 % of the light of exponential noise (now 0.02 % over 1,000); a firefly of 3e38 lifted a
pixel of kpyr-5 to 1e28 times itself (now 5), and four frames later to 1e21 times (now 1.8).

## What it costs

Processor time of one thread at 1280x720, old and new in turn in one process, on a loaded machine
(difference of the shortest of 60 runs; 16 for normals): weights and accumulation 19.5 ms before,
+1.3 ms; +4.7 ms if every strip of the frame has a firefly to darken and there is no albedo. Normals
of any length: 8.8 ms before, +1.4 ms; +6.8 ms where they are not unit.

## What lets go of a past whose light has changed

The past of a pixel, as it was brought there, is compared with this frame's sample
(`history_rejection`). A pixel's difference d counts with a = w n / (n + 1), where w is what the
sample weighs and n the samples of the past: the past is a mean by the same weights, so that the
mean of w d is 0 if nothing changed, however long the tail of the noise. Over windows of 2x2
pixels and of 3x3 blocks of 2, 4, 8, 16 and 32, D = sum(a d) / sum(a) has the standard error s² =
v (1 / sum(a) + 1 / 1500), where v, the variance of a sample, is the larger of the window's, by
the covariance of d and x within 2x2 pixels, and of a mean over 8 frames and 48 pixels, in which
rare bright samples show. The bias b of the past is found from coarse to fine: b <- b + r (1 - (k
s / r)²)+, r = D - b, with k of 4.0 to 6.0; 1 % of the light counts as no change. The
past keeps 1 / (1 + 100 n b² / v) of its samples, and its picture, for models that look at their
last output, as much of its validity, and none below a half.

"""


def main() -> None:
    """Measure every case for every model and write or print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tests.hard_cases", description=__doc__)
    parser.add_argument("--report", type=Path, help="Markdown file to write.")
    parser.add_argument("--seconds", type=float, default=5, help="Search time of each operator.")
    given = parser.parse_args()
    text = _HEAD + cases_table() + _LIGHT + worst_errors.markdown(given.seconds)
    if given.report is None:
        print(text)
        return
    with atomic_path(given.report) as temporary:
        temporary.write_text(text)


def cases_table() -> str:
    """A row a case, a column a model and provider."""
    columns = [
        *models_and_providers(),
        *((model, "CPUExecutionProvider") for model in BY_NAME),
    ]
    heads = [
        f"{model}, {provider.removesuffix('ExecutionProvider')}" for model, provider in columns
    ]
    lines = ["| input | what must hold | limit | " + " | ".join(heads) + " |"]
    lines.append("|---" * (3 + len(columns)) + "|")
    denoisers = [OfFrameSize(model, threads=1, providers=[provider]) for model, provider in columns]
    why = []
    for case in CASES:
        if case.name == "eight_k" and not os.environ.get(ON_DEMAND):
            figures = ["on demand"] * len(columns)
        else:
            figures = [_figure(case, denoiser) for denoiser in denoisers]
        lines.append(f"| {case.what} | {case.holds} | {case.limit:g} | {' | '.join(figures)} |")
        reasons: dict[str, list[str]] = {}
        for model, reason in case.falls_short.items():
            reasons.setdefault(reason, []).append(model)
        why += [
            f"- {case.what}; {case.holds}: {', '.join(models)}: {reason}"
            for reason, models in reasons.items()
        ]
    for denoiser in denoisers:
        denoiser.close()
    return "\n".join([*lines, "", "Above their limit, and why:", "", *why, ""])


def _figure(case: Case, denoiser: stillray.Denoiser) -> str:
    """A case's figure, bold above its limit; none where it is of what other models accumulate."""
    try:
        figure = case.worst(denoiser)
    except NotAccumulatedError:
        return "-"
    return f"{figure:.3g}" if case.passes(figure) else f"**{figure:.3g}**"


if __name__ == "__main__":
    main()
