"""Grading a folder: whatever is handed in has a row, and costs nobody else's."""

import csv
import os
import sys
import time

import handed_in
import nbformat
import pytest
from handed_in import EULER

from cotlearn.course import grading, kernel, marking
from cotlearn.course.kernel import Limits
from cotlearn.course.marking import mark

pytestmark = pytest.mark.slow
LIMITS = Limits(seconds=3, gigabytes=0.5)

MATCH = 'match "a":\n    case str(word):\n        TWO = 2\n    case _:\n        TWO = 3'
#: State over cells, a star, magics, a shell, a cell that fails, one's own check.
CELLS = ("this fails", "from torch import *", "d = {}", 'd["one"] = 1', "L = []", "L.append(1)")
CELLS += ("ONE = 0", "ONE += 1", "class A: pass", "A.one = 1", MATCH, "%%capture words\nhalf = 0.5")
CELLS += (
    "%time two = TWO * half * 2",
    "one = !echo 1",
    "from cotlearn.course import check, passed",
)
CELLS += ('if not passed("hw1.euler"):\n    ONE = ONE * 1',)
ALL = 'd["one"] * L[0] * ONE * A.one * two * half * len(one)'
HONEST = EULER.replace("torch.full", "full").replace("range(nfe)", "arange(nfe).tolist()")
HONEST = HONEST.replace("x = x0", f"display(nfe)\n    x = x0 * {ALL}")
HONEST = f'get_ipython().run_line_magic("pwd", "")\n{HONEST}\ncheck(1, "hw1.euler")'

LOOP = "while True: pass"
LEFT_OUT = "cell 2 ran for longer than 3 seconds and was left out"
MEMORY = f"a = []\nwhile True: a.append(bytearray(10**8))\n{EULER}"
#: Answers, cells before them, points of 4, and words on the student's page.
HAND_INS = {
    "right": (f"{EULER}\nexit()", ("exit()", LOOP), 4, "✓ correct"),
    "honest": (HONEST, CELLS, 4, "✓ correct"),
    "stub": ("def euler(*given):\n    ...", (), 0, "not attempted"),
    "wrong": (EULER.replace("k / nfe", "0"), (), 1, "t moves on"),
    "loop": (f"def euler(*given):\n    {LOOP}", (LOOP,), 0, "is there a loop that never ends?"),
    "os exit": (
        EULER.replace("x = x0", "import os; os._exit(0)"),
        (),
        0,
        r"ended Python (os.\_exit",
    ),
    "memory": (MEMORY, (), 0, "asked for more memory than it may have"),
    "no python": (EULER.replace("nfe):", "nfe)"), (), 0, "expected ':' in its line"),
}


def grade(folder, masters, **options):
    out = folder.parent / "grades.csv"
    return grading.grade(folder, out, masters=masters, workers=2, limits=LIMITS, **options)


def table(folder):
    out = folder.parent / "grades.csv"
    with out.open(encoding="utf-8-sig", newline="") as file:
        return {row["file"]: row for row in csv.DictReader(file)}


def hand_in(folder, name, euler, cells=()):
    handed_in.write(folder / f"{name}.ipynb", handed_in.homework({"euler": euler}, extra=cells))


@pytest.fixture(scope="module")
def folder(tmp_path_factory, masters):
    """Work that was handed in, and graded once."""
    folder = tmp_path_factory.mktemp("grading") / "handed in"
    for name, (euler, cells, _, _) in HAND_INS.items():
        hand_in(folder / "Zoë Müller", name, euler, cells)
    hand_in(folder / ".ipynb_checkpoints", "hidden", EULER)
    (folder / "damaged.ipynb").write_text("{")
    (folder / "=1+1.ipynb").touch()
    (folder / "no.ipynb").mkdir()
    (folder / "report.pdf").touch()
    grade(folder, masters)
    return folder


@pytest.mark.parametrize("name", HAND_INS)
def test_a_hand_in_gets_its_points_and_a_page(folder, name):
    *_, points, words = HAND_INS[name]
    row = table(folder)[f"Zoë Müller/{name}.ipynb"]
    assert (row["assignment"], row["points"], row["out_of"]) == ("hw1", f"{points}", "4")
    page = folder.parent / "grades" / "Zoë Müller" / f"{name}.ipynb.md"
    assert words in page.read_text(encoding="utf-8")
    notes = {
        "loop": f"{LEFT_OUT}; hw1.euler: your answer ran for longer than 3 seconds and was stopped",
        "memory": "cell 2 asked for more memory than it may have and was left out",
    }
    assert row["note"] == notes.get(name, "")


def test_every_file_has_a_row(folder):
    rows = table(folder)
    notes = {
        "'=1+1.ipynb": "not a readable notebook",
        "damaged.ipynb": "not a readable notebook",
        "no.ipynb": "it is a folder",
        "report.pdf": "hand in the notebook",
    }
    assert rows.keys() == {f"Zoë Müller/{name}.ipynb" for name in HAND_INS} | notes.keys()
    for name, note in notes.items():
        assert note in rows[name]["note"]
        assert name.lstrip("'") not in rows[name]["note"] or name == "report.pdf"
    plain = "it is not a readable notebook: it is empty or damaged, or another kind of file"
    assert rows["damaged.ipynb"]["note"] == plain
    for name in notes:
        assert rows[name]["points"] == "0"
    page = folder.parent / "grades" / "damaged.ipynb.md"
    assert page.read_text().startswith("# damaged.ipynb")


def test_again_only_what_is_new_is_graded(folder, masters, monkeypatch):
    before = table(folder)
    hand_in(folder / "Zoë Müller", "late", EULER)
    graded = []

    def counted(path, **options):
        graded.append(path.name)
        return mark(path, **options)

    monkeypatch.setattr(grading, "mark", counted)
    rows = grade(folder, masters)
    assert {row.file for row in rows if row.kept} == {f"Zoë Müller/{n}.ipynb" for n in HAND_INS}
    assert graded == ["late.ipynb"]
    after = table(folder)
    assert after.pop("Zoë Müller/late.ipynb")["points"] == "4"
    assert after == before
    for torn in (folder.parent / "grades" / ".known").iterdir():
        torn.write_text("{")
    (folder / "Zoë Müller" / "late.ipynb").unlink()


def test_what_needs_no_kernel_waits_for_none(tmp_path, masters):
    folder, said = tmp_path / "in", []
    hand_in(folder, "a", EULER)
    (folder / "z.ipynb").write_text("{")
    options = {"begin": said.append, "each": lambda row, done, total: said.append((row.file, done))}
    grade(folder, masters, **options)
    assert said == [("z.ipynb", 1), "a.ipynb", ("a.ipynb", 2)]


def test_an_endless_loop_costs_its_time_once(tmp_path, masters, monkeypatch):
    """Each cell that called the answer took the whole time again: four hand-ins, 250 s."""
    runs = []
    kernels = marking.started

    def counted(*given):
        runs.append(given)
        return kernels(*given)

    monkeypatch.setattr(marking, "started", counted)
    calls = ("euler(None, None, 1)", "print(euler(None, None, 2))", "x = euler(None, None, 3)")
    notebook = handed_in.homework({"euler": f"def euler(*given):\n    {LOOP}"})
    notebook.cells[2:2] = [nbformat.v4.new_code_cell(call) for call in calls]
    handed_in.write(tmp_path / "a.ipynb", notebook)
    found = mark(tmp_path / "a.ipynb", hidden=True, masters=masters, limits=LIMITS)
    assert len(runs) == 2
    assert [item.points for item in found.marks] == [0]
    assert "never ends" in found.marks[0].sentence


def test_the_time_of_imports_is_not_the_students(tmp_path, masters, monkeypatch):
    """On a busy machine an import may take longer than a cell may."""
    (tmp_path / "slowly.py").write_text("import time\ntime.sleep(4)\nSLOW = 1")
    path = filter(None, [str(tmp_path), os.environ.get("PYTHONPATH")])
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path))
    plain = f"from slowly import SLOW\n{EULER.replace('x = x0', 'x = x0 * SLOW')}"
    honest = HONEST.replace(ALL, f"{ALL} * SLOW")
    cells = (*CELLS, "%%capture said\nfrom slowly import SLOW")
    for name, answer, before in (("plain", plain, ()), ("honest", honest, cells)):
        hand_in(tmp_path, name, answer, before)
        found = mark(tmp_path / f"{name}.ipynb", hidden=True, masters=masters, limits=LIMITS)
        assert (found.points, found.note) == (4, "")


LACKS_TORCH = {
    "late": ("import time\ntime.sleep(60)\n", "ran for longer than 3 seconds and was left out"),
    "ended": ("import os\nos._exit(0)\n", "ended Python (os._exit, or a crash) and was left out"),
    "failed": ("import no_such\n", "raised ModuleNotFoundError: No module named 'no_such' ({})"),
}


@pytest.fixture(scope="module")
def lacking(tmp_path_factory, masters):
    """Work whose first cell does not come to its end, graded once."""
    folder = tmp_path_factory.mktemp("lacking") / "in"
    for name, (first, _) in LACKS_TORCH.items():
        notebook = handed_in.homework({"euler": EULER})
        notebook.cells[0].source = f"{first}import torch\nfrom cotlearn.course import check"
        cell = nbformat.v4.new_code_cell("torch.zeros(3)")  # fails, and matters not
        notebook.cells.insert(1, cell)
        handed_in.write(folder / f"{name}.ipynb", notebook)
    grade(folder, masters)
    return folder


@pytest.mark.parametrize("name", LACKS_TORCH)
def test_a_cell_that_others_miss_is_named(lacking, name):
    """Points were taken away for right answers, and nothing said why."""
    note = f"cell 1 {LACKS_TORCH[name][1].format('missing later: torch')}"
    row = table(lacking)[f"{name}.ipynb"]
    assert (row["points"], row["note"]) == ("0", note)
    page = (lacking.parent / "grades" / f"{name}.ipynb.md").read_text(encoding="utf-8")
    assert f"Note: {grading._plain_markdown(note)}." in page
    assert "raised NameError: name 'torch' is not defined" in page


def test_an_answer_that_no_kernel_came_to_is_noted():
    lost = marking.Mark("hw1.loss", "not yet", "not reached: 10 times; more", out_of=4)
    row = grading.Row("a.ipynb", marking.Marked("hw1", "Homework 1", [lost]))
    assert "hw1.loss: not reached: 10 times" in grading.table([row])


def test_a_students_words_are_no_html():
    words = r"raised E: <b>no</b> & ![x](http://a.b) `c` *d* __e__ \x1b \<i> exact_velocity"
    shown = (
        r"raised E: &lt;b>no&lt;/b> & !\[x](http://a.b) \`c\` \*d\* \_\_e\_\_"
        r" \x1b \\&lt;i> exact_velocity"
    )
    wrong = marking.Mark("hw1.euler", "not yet", words, 0, 4, [f"{words}!"])
    made = grading.page("<b>.ipynb", marking.Marked("hw1", "Homework 1", [wrong], words))
    assert made.splitlines()[2].startswith("&lt;b>.ipynb: 0 of 4")
    assert f"Note: {shown}." in made
    assert f"✗ {shown}\n- {shown}!" in made
    ungraded = grading.page("<b>.ipynb", marking.Marked(note=words))
    assert ungraded == f"# &lt;b>.ipynb\n\nThis could not be graded: {shown}.\n"


def test_ctrl_c_keeps_what_was_graded(tmp_path, masters):
    folder = tmp_path / "in"
    hand_in(folder, "a", EULER)
    hand_in(folder, "b", EULER.replace("x = x0", "import time; time.sleep(60)\n    x = x0"))

    def stop(row, done, total):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        grading.grade(
            folder, tmp_path / "grades.csv", masters=masters, workers=1, limits=Limits(), each=stop
        )
    assert len(list((tmp_path / "grades" / ".known").iterdir())) == 1
    assert not (tmp_path / "grades.csv").exists()


@pytest.mark.skipif(sys.platform != "linux", reason="names and kinds that only Linux has")
def test_names_and_kinds_of_all_sorts(tmp_path, masters):
    folder = tmp_path / "in"
    folder.mkdir()
    with open(os.fsencode(folder) + b"/caf\xe9.ipynb", "wb") as file:
        file.write(b"{")
    (folder / ("n" * 245 + ".ipynb")).touch()
    (folder / "red\x1b[31m.ipynb").touch()
    (folder / "zero.ipynb").symlink_to("/dev/zero")
    (folder / "elsewhere").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe.ipynb")
    rows = {row.file: row for row in grade(folder, masters)}
    names = {"caf\\udce9.ipynb", "n" * 245 + ".ipynb", "red\\x1b[31m.ipynb"}
    assert rows.keys() == names | {"zero.ipynb", "pipe.ipynb"}
    assert all(row.marked.note for row in rows.values())
    assert len(list((tmp_path / "grades").rglob("*.md"))) == len(rows)


def test_what_cannot_be_graded(tmp_path, masters):
    out = tmp_path / "grades.csv"
    with pytest.raises(ValueError, match="there is no notebook"):
        grade(tmp_path, masters)
    with pytest.raises(ValueError, match="folder must be a folder of notebooks"):
        grade(tmp_path / "nowhere", masters)
    with pytest.raises(ValueError, match=r"out must be a file such as grades\.csv"):
        grading.grade(tmp_path, tmp_path, limits=LIMITS)
    with pytest.raises(ValueError, match="out must lie outside the folder of the hand-ins"):
        grading.grade(tmp_path, tmp_path / "new" / "grades.csv", limits=LIMITS)
    hand_in(tmp_path / "in", "hw1", EULER)
    with pytest.raises(ValueError, match="there is no master notebook"):
        grade(tmp_path / "in", tmp_path)
    with pytest.raises(ValueError, match=r"hw1\.ipynb has no hidden tests"):
        grade(tmp_path / "in", tmp_path / "in")
    assert not out.exists()


def test_limits_are_checked():
    with pytest.raises(ValueError, match="seconds must be"):
        Limits(seconds=0)
    with pytest.raises(ValueError, match="gigabytes must be"):
        Limits(gigabytes=-1)


def test_another_version_is_noted_and_a_lesson_has_no_points(tmp_path):
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("import math")])
    notebook.metadata["cotlearn"] = {"assignment": "02", "version": "7.2.0"}
    handed_in.write(tmp_path / "mine.ipynb", notebook)
    found = mark(tmp_path / "mine.ipynb")
    assert found.note.startswith("made with cotlearn 7.2.0, marked with 0.")
    assert [item.verdict for item in found.marks] == ["not yet"] * 3
    assert found.out_of == 0
    notebook.metadata["cotlearn"]["assignment"] = "hw9"
    handed_in.write(tmp_path / "mine.ipynb", notebook)
    with pytest.raises(ValueError, match="there is no assignment 'hw9'; did you mean: hw4"):
        mark(tmp_path / "mine.ipynb")


def test_who_waits_is_told(tmp_path, masters, monkeypatch):
    """The command was silent for minutes while it marked."""

    def slowly(path, **options):
        time.sleep(0.5)
        return marking.Marked()

    monkeypatch.setattr(grading, "mark", slowly)
    monkeypatch.setattr(kernel, "LINE_EVERY", 0.2)
    hand_in(tmp_path / "in", "a", EULER)
    (tmp_path / "in" / "b.ipynb").write_text("{")
    said = []
    grade(tmp_path / "in", masters, meanwhile=lambda *given: said.append(given))
    assert 1 <= len(said) <= 2
    assert said[0] == (["a.ipynb"], 1, 2)


def test_what_fails_once_stops_nothing_later():
    def work(item):
        return 1 / item

    with pytest.raises(ZeroDivisionError):
        kernel.in_parallel(work, [0, 1], workers=1, then=lambda result: None)
    assert not kernel._stopping.is_set()


@pytest.mark.timeout(20)
def test_what_has_not_begun_is_not_waited_for():
    def work(seconds):
        time.sleep(seconds)
        return 1 / seconds

    with pytest.raises(ZeroDivisionError):  # while the second sleeps; the others never begin
        kernel.in_parallel(work, [0, 0.3, 0.3, 0.3], workers=1, then=lambda result: None)


def test_a_lesson_among_the_homework_is_named():
    """Its row had 0 of 0 points and no note."""
    right = marking.Mark("01.midpoint", "correct", "")
    lesson = marking.Marked("01", "Notebook 01", [right])
    assert grading.LESSON in grading.table([grading.Row("01.ipynb", lesson)])
    assert f"Note: {grading.LESSON}." in grading.page("01.ipynb", lesson)
    homework = marking.Marked(
        "hw1", "Homework 1", [marking.Mark("hw1.loss", "correct", "", out_of=2.0)]
    )
    assert grading.LESSON not in grading.table([grading.Row("hw1.ipynb", homework)])
