"""``stillray doctor``: what is wrong with an installation, and what to do."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import Annotated

import typer

from stillray.cli.program import FAILED


def doctor(
    model: Annotated[
        str, typer.Option("--model", "-m", help="Quality, model name or .onnx file to try.")
    ] = "high",
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Look at this installation, and say what to do where something is wrong.

    Exit code 1 where there is a problem.
    """
    from stillray.profiling.install import PROBLEM, examine

    findings = []
    for finding in examine(model=model):
        findings.append(finding)
        if not as_json:
            print(f"{finding.kind:8}{finding.text}", flush=True)
    if as_json:
        print(json.dumps([asdict(finding) for finding in findings], indent=2))
    if any(finding.kind == PROBLEM for finding in findings):
        raise typer.Exit(FAILED)
