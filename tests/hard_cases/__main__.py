"""``python -m tests.hard_cases --report docs/hard-cases.md``: measure, and write the tables.

With ``--seconds`` the search for the worst errors of the operators runs longer.
"""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import stillray
from stillray.io.exr.read_write import atomic_path
from tests import worst_errors
from tests.hard_cases.catalogue import CASES, models_and_providers
from tests.hard_cases.features import ON_DEMAND

_HEAD = """# Hard cases

Written by `python -m tests.hard_cases --report docs/hard-cases.md`. `tests/test_hard_cases.py` runs
the same cases over every packaged model and every ONNX Runtime provider that is installed, and
fails where a figure is above its limit: a new model is not done until it passes. Figures in bold
are above it; they are known, and listed with their reason below the table.

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
first frame's firefly lifts a pixel of kpyr-5s 2.2 times, and did 7.4 times.

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
of any length: 8.8 ms before, +1.4 ms; +6.8 ms where they are not unit. Changes of light: +0.95 ms.

## What lets go of light that changed

The light of a frame's samples is compared with that of the last frames' by blocks of 16x16 pixels
(`stillray.stages.history_rejection`). Where all of 5x5 blocks are darker, or all brighter, and by
0.4 stops or more, the past is worth less, from 0.8 stops on nothing. Before, a light that was
switched on took 33 frames to show, one that was switched off 72 to 80, and the exposure as many.
Changes by less than half a stop still fade in over 20 to 30 frames. Of 1,618 frames, those of
`train.toml` and the validation scenes, 5 lost some past to noise, 1.1 % of the picture at most:
`python -m stillray_training.light_changes FOLDER...` lists them.

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
    columns = models_and_providers()
    heads = [
        f"{model}, {provider.removesuffix('ExecutionProvider')}" for model, provider in columns
    ]
    lines = ["| input | what must hold | limit | " + " | ".join(heads) + " |"]
    lines.append("|---" * (3 + len(columns)) + "|")
    denoisers = [
        stillray.Denoiser(model, threads=1, providers=[provider]) for model, provider in columns
    ]
    why = []
    for case in CASES:
        if case.name == "eight_k" and not os.environ.get(ON_DEMAND):
            figures = ["on demand"] * len(columns)
        else:
            measured = [case.measure(denoiser) for denoiser in denoisers]
            figures = [
                f"{figure:.3g}" if case.passes(figure) else f"**{figure:.3g}**"
                for figure in measured
            ]
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


if __name__ == "__main__":
    main()
