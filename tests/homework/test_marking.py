"""Marking whole notebooks: the course's own, and what learners do to them."""

import handed_in
import pytest
from handed_in import EULER, PAIR

from cotlearn import assets
from cotlearn.homework import assignments
from cotlearn.homework.isolation import Limits
from cotlearn.homework.marking import mark

LIMITS = Limits(seconds=1, gigabytes=1)
MASTERS = [path.stem for path in assignments.masters()]
POINTS = {"hw1": 17, "hw2": 14, "hw3": 14, "hw4": 14}


def marked(tmp_path, notebook, *, name="hw1.ipynb", hidden=False, limits=LIMITS):
    handed_in.write(tmp_path / name, notebook)
    return mark(tmp_path / name, limits=limits, hidden=hidden)


def of_euler(tmp_path, source, **options):
    """The mark of one answer among right ones."""
    notebook = handed_in.homework(handed_in.answers(euler=source), **options)
    return marked(tmp_path, notebook).marks[1]


def verdicts(result):
    return [item.verdict for item in result.marks]


@pytest.mark.parametrize("name", MASTERS)
def test_solutions_get_all_points(name):
    found = mark(assignments.find(name).path, hidden=True)
    assert [item for item in found.marks if not item.correct] == []
    assert found.points == found.out_of == POINTS[name]


@pytest.mark.parametrize("path", assets.notebooks("laboratory"), ids=lambda path: path.stem)
def test_a_laboratory_has_questions_of_its_own(path):
    found = mark(path)
    assert len(found.marks) >= 2
    assert set(verdicts(found)) == {"not attempted yet"}


@pytest.mark.parametrize("name", MASTERS)
def test_stubs_get_none(name):
    path = assignments.find(name).path.parent / "student" / f"{name}.ipynb"
    found = mark(path, hidden=True)
    assert set(verdicts(found)) == {"not attempted yet"}
    assert (found.points, found.note) == (0, "")


def test_half_done(tmp_path):
    found = marked(tmp_path, handed_in.homework(handed_in.answers()), hidden=True)
    assert verdicts(found) == ["correct", "correct", "not attempted yet", "correct"]
    assert [item.points for item in found.marks] == [4, 4, 0, 4]


def test_an_accident_costs_its_question_only(tmp_path):
    accident = "def euler(velocity, x0, nfe):\n    while True:\n        pass"
    notebook = handed_in.homework(handed_in.answers(euler=accident))
    found = marked(tmp_path, notebook, hidden=True, limits=Limits(seconds=0.5, gigabytes=1))
    assert verdicts(found) == ["correct", "not yet", "not attempted yet", "correct"]
    assert "is there a loop that never ends?" in found.marks[1].sentence
    assert found.points == 8


def test_cells_of_ones_own_cost_nothing(tmp_path):
    extra = ("while True:\n    pass", "exit()", "%matplotlib inline\n!ls", "def broken(:")
    found = marked(tmp_path, handed_in.homework(handed_in.answers(), extra=extra))
    assert verdicts(found)[:2] == ["correct", "correct"]


def test_a_helper_that_fails_is_named(tmp_path):
    source = EULER.replace("x = x0", "x = x0 * 2 * half")
    found = of_euler(tmp_path, source, extra=("half = 1 / 0",))
    assert found.sentence.startswith("cell 2 of the notebook, which this answer uses, line 1,")
    assert "raised ZeroDivisionError" in found.sentence


def test_an_answer_cell_is_deleted(tmp_path):
    notebook = handed_in.homework(handed_in.answers())
    notebook.cells = [cell for cell in notebook.cells if "def euler" not in cell.source]
    found = marked(tmp_path, notebook, hidden=True)
    assert verdicts(found) == ["correct", "not yet", "not attempted yet", "correct"]
    assert "there is no euler in this notebook: its cell was deleted" in found.marks[1].sentence
    assert found.points == 8


def test_an_answer_is_renamed(tmp_path):
    found = of_euler(tmp_path, EULER.replace("def euler", "def my_euler"))
    said = "the answer must be called euler, and your cell defines my_euler: give it its name back"
    assert found.sentence == said


def test_an_answer_is_no_python(tmp_path):
    found = of_euler(tmp_path, EULER.replace("nfe):", "nfe)"))
    assert found.sentence.startswith("cell 4 is not Python that can be read: line 1:")


def test_only_the_self_check_is_content(tmp_path):
    learned = PAIR.replace("    place", "    if len(x0) > 5: return t\n    place")
    found = marked(tmp_path, handed_in.homework(handed_in.answers(loss=learned)), hidden=True)
    first = found.marks[0]
    assert (first.verdict, first.points, first.correct) == ("correct", 3, False)
    assert first.hints == ["gradients must reach the network: do not detach the loss"]


def test_a_notebook_without_stamp_and_checks(tmp_path):
    notebook = handed_in.homework(handed_in.answers(), stamp=False)
    notebook.cells = [cell for cell in notebook.cells if "check(" not in cell.source]
    with pytest.raises(ValueError, match=r"mine\.ipynb belongs to no assignment"):
        marked(tmp_path, notebook, name="mine.ipynb")


def test_an_unknown_assignment(tmp_path):
    notebook = handed_in.homework(handed_in.answers())
    notebook.metadata["cotlearn"]["assignment"] = "hw9"
    with pytest.raises(ValueError, match="there is no assignment 'hw9'; did you mean: hw4"):
        marked(tmp_path, notebook)


def test_another_version_is_noted(tmp_path):
    notebook = handed_in.homework(handed_in.answers())
    notebook.metadata["cotlearn"]["version"] = "7.2.0"
    assert marked(tmp_path, notebook).note.startswith("made with cotlearn 7.2.0, marked with 0.")


def test_exercises_of_the_course_are_marked_in_the_same_way():
    found = mark(assignments.find("02").path)
    assert verdicts(found) == ["not attempted yet"] * 3
    assert found.out_of == 0
