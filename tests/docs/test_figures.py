"""The figures of the first page are those of the course as it is."""

import sys
from pathlib import Path

FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"
sys.path.insert(0, str(FIGURES))

import course_map  # noqa: E402


def test_every_notebook_is_on_the_map():
    """After a new notebook or title: python docs/figures/course_map.py."""
    drawn = (FIGURES / "course_map.svg").read_text("utf-8")
    assert f"<dc:description>{course_map.described()}</dc:description>" in drawn


def test_a_room_is_on_the_path_or_beside_it():
    rooms = course_map.titles()
    assert set(course_map.EVENING) <= set(rooms) - set(course_map.BESIDE)
    for beside, _ in course_map.BESIDE.values():
        assert beside in rooms
        assert beside not in course_map.BESIDE
