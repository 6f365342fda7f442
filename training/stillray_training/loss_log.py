"""A training's log: a row of steps, mean loss and seconds every so many steps, as CSV."""

from __future__ import annotations

import csv
from pathlib import Path

from stillray.io.atomic import atomic_path

LOG = "log.csv"
LOG_EVERY = 20  # steps


def log_loss(path: Path, step: int, loss: float, seconds: float) -> None:
    """Append a row to a log; makes it if it is missing."""
    new = not path.exists()
    with path.open("a", newline="") as file:
        writer = csv.writer(file)
        if new:
            writer.writerow(["step", "loss", "seconds"])
        writer.writerow([step, f"{loss:.6f}", f"{seconds:.1f}"])


def forget_after(path: Path, step: int) -> None:
    """Drop the rows of steps that a resumed run takes again."""
    if path.is_file():
        with path.open(newline="") as file:
            header, *rows = list(csv.reader(file))
        with atomic_path(path) as temporary, temporary.open("w", newline="") as file:
            csv.writer(file).writerows([header, *(row for row in rows if int(row[0]) <= step)])


def last_step(path: Path) -> int:
    """The step of the last row."""
    with path.open(newline="") as file:
        return int(list(csv.DictReader(file))[-1]["step"])
