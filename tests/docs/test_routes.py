"""The map is of the course as it is, and a route holds what each of its notebooks needs."""

import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs" / "figures"
sys.path.insert(0, str(FIGURES))

import course_map  # noqa: E402

STOP = re.compile(r"(?<![\d:-])([01]\d)(?!\d)(?:, (sections? \d(?:(?:, | to | and )\d\b)*))?")
NEED = re.compile(r"\[\d\d\]\((?P<file>\d\d)_\w+\.ipynb\)(?: \((?P<words>[^)]*)\))?")
STRESSED = re.compile(r"^##+ .*|\*+[^*]+\*+", re.MULTILINE)  #: where a word is explained


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


def prose(number):
    """The texts of a notebook, joined."""
    [path] = (ROOT / "notebooks").glob(f"{number}_*.ipynb")
    cells = json.loads(path.read_text("utf-8"))["cells"]
    return "\n\n".join("".join(c["source"]) for c in cells if c["cell_type"] == "markdown")


def sections(part):
    """The numbers in "sections 1 to 3 and 5"; nothing stands for all."""
    found = set()
    for first, last in re.findall(r"(\d)(?: to (\d))?", part or ""):
        found |= set(range(int(first), int(last or first) + 1))
    return found


def read(number, part):
    """What somebody has read who read these sections of a notebook."""
    _, *rest = re.split(r"^(?=## )", prose(number), flags=re.MULTILINE)
    numbered = {int(text[3]): text for text in rest if text[3].isdigit()}
    wanted = sections(part) or set(numbered)
    assert wanted <= set(numbered), f"{number} has no sections {wanted - set(numbered)}"
    return "\n".join([numbered[n] for n in wanted] if part else rest)


def missing(route):
    """What notebooks of a route need and those before them do not give."""
    done, lost = {}, []
    for number, part in route:
        [line] = re.findall(r"^\*\*Needs\*\*.*", prose(number), re.MULTILINE)
        for need in NEED.finditer(line):
            if need["file"] not in done:
                lost.append(f"{number} needs {need['file']}")
                continue
            for words in (need["words"] or "").split(", "):
                taught = " ".join(STRESSED.findall(" ".join(done.values()))).lower()
                if " " not in words and words.lower()[:5] not in taught:
                    lost.append(f"{number} needs {words} of {need['file']}")
        done[number] = done.get(number, "") + read(number, part)
    return lost


def table(head):
    """The stops of a table of the instructor's guide, in the order in which they are read."""
    guide = (ROOT / "docs/teaching/instructors_guide.md").read_text("utf-8")
    rows = guide.split(f"\n## {head}\n")[1].split("\n## ")[0].split("|---|\n")[1].splitlines()
    cells = [[cell.strip() for cell in row.split("|")[2:-1]] for row in rows if "|" in row]
    taught = [column if head == "Four weeks" else column[:1] for column in cells]
    return [stop for row in taught for cell in row for stop in STOP.findall(cell)]


ROUTES = {
    "evening": list(course_map.EVENING.items()),
    "path": [(n, "") for n in course_map.titles() if n.isdigit() and n not in course_map.BESIDE],
    "one day": table("One day"),
    "four weeks": table("Four weeks"),
}


@pytest.mark.parametrize("name", ROUTES)
def test_what_a_notebook_needs_comes_before_it(name):
    assert len(ROUTES[name]) > 6
    assert missing(ROUTES[name]) == []


def test_a_route_with_a_hole_is_found():
    """The evening's route as it was."""
    parts = {"00": "", "02": "", "03": "", "04": "sections 1 to 3", "08": ""}
    expected = ["02 needs 01", "03 needs 01", "08 needs strata of 04", "08 needs 07"]
    assert missing(parts.items()) == expected


def minutes(number, part=""):
    """Minutes to read (these sections of) a notebook, and with all exercises, as its head says."""
    [read_it, with_exercises] = re.search(
        r"^\*\*Time\*\* (\d+) minutes to read, (\d+) with", prose(number), re.MULTILINE
    ).groups()
    share = len(read(number, part)) / len(read(number, ""))
    return int(read_it) * share, int(with_exercises)


def test_the_evening_takes_four_hours():
    """As the first pages say."""
    assert 210 <= sum(minutes(*stop)[0] for stop in course_map.EVENING.items()) <= 270


@pytest.mark.parametrize("week", course_map.WEEKS)
def test_a_week_takes_about_three_hours(week):
    """The fourth took more than four."""
    first, last = course_map.WEEKS[week]
    inside = [number for number, _ in ROUTES["path"] if first <= number <= last]
    assert 150 <= sum(minutes(number)[1] for number in inside) <= 210


@pytest.mark.parametrize("page", ["README.md", "docs/index.md", "notebooks/00_start_here.ipynb"])
def test_pages_name_the_route_of_the_map(page):
    assert f"Marked for one evening are {course_map.route()}." in (ROOT / page).read_text("utf-8")


def test_the_first_pages_list_the_route():
    assert f"{course_map.route()};" in (ROOT / "README.md").read_text("utf-8")
    text = (ROOT / "docs/index.md").read_text("utf-8")
    [item] = re.findall(r"^- \*\*In one evening\*\*.*?(?=^- )", text, re.DOTALL | re.MULTILINE)
    found = re.findall(r"(sections [\d to]+\d)?(?: of)?\s+\[(\d\d)\]\(", item)
    assert {number: part for part, number in found} == course_map.EVENING
