"""The pages about the papers say what the specifications say, and name what there is."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from stillray.model_spec import load

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
NAMES = sorted(path.stem for path in (ROOT / "models_spec").glob("*.toml"))
COLUMNS = ["the paper", "here", "why", "worth", "models"]


def tables():
    """Rows of docs/differences.md by family, each a list of cells."""
    found = {}
    for section in (DOCS / "differences.md").read_text(encoding="utf-8").split("\n## ")[1:]:
        rows = [
            [cell.strip() for cell in line.strip("|").split("|")]
            for line in section.splitlines()
            if line.startswith("|")
        ]
        assert rows[0] == COLUMNS
        found[section.splitlines()[0]] = rows[2:]
    return found


@pytest.mark.parametrize("name", NAMES)
def test_the_page_of_differences_has_those_of_a_specification_and_no_others(name):
    spec = load(name)
    told = [row for row in tables()[spec.family] if name in row[-1].split(", ")]
    assert told
    assert [f"{paper}; here {here}" for paper, here, *_ in told] == list(spec.differs)


def test_every_difference_says_why_and_what_it_is_worth_of_models_that_there_are():
    named = set()
    for family, rows in tables().items():
        for row in rows:
            assert len(row) == len(COLUMNS), row
            assert all(row), row
            models = row[-1].split(", ")
            assert all(load(model).family == family for model in models), row
            named.update(models)
    assert named == set(NAMES)


@pytest.mark.parametrize("page", ["papers.md", "differences.md"])
def test_files_and_modules_that_the_pages_name_are_there(page):
    text = (DOCS / page).read_text(encoding="utf-8")
    links = [link for link in re.findall(r"\]\(([^)#]+)", text) if "://" not in link]
    assert links
    assert [link for link in links if not (DOCS / link).exists()] == []
    files = re.findall(r"`(tests/[\w/]+\.py)", text)
    assert [file for file in files if not (ROOT / file).is_file()] == []
    for module in re.findall(r"python -m ([\w.]+)", text):
        path = ROOT / "training" / module.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), module
