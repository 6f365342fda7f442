"""What is installed is what there is: every package and every data file that code reads."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_every_package_of_the_three_roots_is_installed():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    there = {
        ".".join(path.parent.relative_to(ROOT / root).parts)
        for root in ("runtime", "training", "export")
        for path in (ROOT / root).rglob("__init__.py")
    }
    # data alone, which has no code
    assert set(project["tool"]["setuptools"]["packages"]) == there | {"stillray.model_spec.specs"}
