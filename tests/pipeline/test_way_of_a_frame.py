from pathlib import Path

from stillray.models.registry import DEFAULT_MODEL
from tests.pipeline.way_of_a_frame import files_visited

PAGE = Path(__file__).parents[2] / "docs" / "architecture.md"


def test_the_page_names_the_files_of_a_frame_in_order():
    _, _, after = PAGE.read_text(encoding="utf-8").partition("tests.pipeline.way_of_a_frame")
    assert after.split("```")[1].split() == files_visited(DEFAULT_MODEL)
