"""Whatever is handed in has a row, and costs nobody else's."""

import ast
import json
import os
import re
import signal
import socket
import sys
import tempfile
import threading
import time

import handed_in
import pytest
from handed_in import EULER

from cotlearn.homework import answering, grading, isolation, submissions
from cotlearn.homework.isolation import Limits
from cotlearn.homework.registry import printable

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("key")]
LIMITS = Limits(seconds=2, gigabytes=1)
POINTS = [4]  #: of `only`


@pytest.fixture
def grade(masters):
    """Grades a folder, in which only the answer `euler` is asked for."""

    def grade(folder, limits=LIMITS, **options):
        out, options = folder.parent / "grades.csv", {"masters": masters, **options}
        return {row.file: row for row in grading.grade(folder, out, limits=limits, **options)}

    return grade


def only(euler):
    """A notebook with one answer."""
    return handed_in.homework({"euler": euler})


def hand_in(tmp_path, euler, name="a"):
    """Hands in one answer, in the folder `in`, and returns the folder."""
    handed_in.write(tmp_path / "in" / f"{name}.ipynb", only(euler))
    return tmp_path / "in"


def points(row):
    return [mark.points for mark in row.marked.marks]


@pytest.mark.skipif(sys.platform != "linux", reason="names and kinds that only Linux has")
def test_every_file_has_a_row(grade, tmp_path, monkeypatch):
    folder = hand_in(tmp_path, EULER, "anna")
    good = folder / "anna.ipynb"
    handed_in.write(folder / "upper.IPYNB", only(EULER))
    handed_in.write(folder / "anna.md" / "hw1.ipynb", only(EULER))
    content = good.read_bytes()
    strange = os.fsencode(folder) + b"/caf\xe9.ipynb"
    with open(strange, "wb") as file:
        file.write(content)
    (folder / ("n" * 245 + ".ipynb")).write_bytes(content)
    (folder / "red\x1b[31m.ipynb").write_text("{")
    (folder / "zero.ipynb").symlink_to("/dev/zero")
    (folder / "neighbour.ipynb").symlink_to(good)
    (folder / "elsewhere").symlink_to(tmp_path)
    os.mkfifo(folder / "pipe.ipynb")
    with (folder / "large.ipynb").open("wb") as file:
        file.truncate(10**10)
    for name in ("a.py", "a.zip", "a.html", "a.ipynb.txt", "a.docx"):
        (folder / name).touch()
    with socket.socket(socket.AF_UNIX) as server:
        monkeypatch.chdir(folder)
        server.bind("socket.ipynb")
        rows = grade(folder)
    notes = dict.fromkeys(["zero.ipynb", "neighbour.ipynb", "elsewhere"], "it is a link") | {
        "pipe.ipynb": "it is a named pipe",
        "socket.ipynb": "it is a socket",
        "large.ipynb": "too large: 10,000 MB",
        "red\\x1b[31m.ipynb": "not a readable notebook",
        "a.py": "a Python file",
        "a.zip": "unpack it",
        "a.html": "a web page",
        "a.ipynb.txt": ".txt at the end",
        "a.docx": "another kind of file",
    }
    right = {"anna.ipynb", "upper.IPYNB", "anna.md/hw1.ipynb", "caf\\udce9.ipynb"}
    right.add("n" * 245 + ".ipynb")
    assert set(rows) == right | set(notes)
    for name in right:
        assert points(rows[name]) == POINTS
    for name, note in notes.items():
        assert note in rows[name].marked.note
    assert len(list((tmp_path / "grades").rglob("*.md"))) == len(rows) + 1  # and a folder
    assert {name for name, row in grade(folder).items() if row.kept} >= right


@pytest.mark.parametrize(
    "metadata", [{"kernelspec": 3}, {"cotlearn": [1]}, {"cotlearn": {"assignment": {"\ud800": 1}}}]
)
def test_fields_that_are_not_what_they_were(grade, tmp_path, metadata):
    folder = hand_in(tmp_path, EULER)
    (folder / "b.ipynb").write_text(json.dumps({**only(EULER), "metadata": metadata}))
    rows = grade(folder)
    assert points(rows["a.ipynb"]) == POINTS
    assert rows["b.ipynb"].marked.note


def test_texts_of_answers_can_be_printed(grade, tmp_path):
    answer = 'def euler(*a):\n    raise ValueError("\\ud800 \\x1b[2J" + "x" * 10**5)'
    sentence = grade(hand_in(tmp_path, answer))["a.ipynb"].marked.marks[0].sentence
    assert r"raised ValueError: \ud800 \x1b[2J" in sentence
    assert len(sentence) < 600
    assert printable("é ✓ \r\x07") == r"é ✓ \r\x07"


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGKILL")
def test_a_killed_process_is_tried_again(grade, tmp_path):
    """Each answer says its number and waits to be killed: the first once, the second always."""
    numbers, done = tmp_path / "numbers", tmp_path / "done"
    numbers.mkdir()
    wait = "import os, pathlib, time\n"  # in a namespace, only /proc knows the number outside
    wait += "own = os.readlink('/proc/self') if os.path.exists('/proc/self') else os.getpid()\n"
    wait += f"pathlib.Path({str(numbers)!r}, str(own)).touch()\ntime.sleep(60)"
    once = f"import pathlib\nf = pathlib.Path({str(done)!r})\n"
    once += f"if not f.exists():\n    f.touch()\n    exec({wait!r})\n{EULER}"
    hand_in(tmp_path, once)
    folder = hand_in(tmp_path, f"{wait}\n{EULER}", "b")
    graded, patient = threading.Event(), Limits(seconds=40, gigabytes=1)

    def kill():
        while not graded.wait(0.05):
            for number in numbers.iterdir():  # a file each: both may wait at the same time
                number.unlink()
                os.kill(int(number.name), signal.SIGKILL)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        rows = grade(folder, limits=patient)
        again = grade(folder, limits=patient).values()
    finally:
        graded.set()
        killer.join()
    assert points(rows["a.ipynb"]) == POINTS
    assert points(rows["b.ipynb"]) == [0]
    assert "killed from outside" in rows["b.ipynb"].marked.marks[0].sentence
    assert [row.kept for row in again] == [True, False]


@pytest.mark.skipif(sys.platform == "win32", reason="no SIGXCPU")
def test_an_answer_that_ignores_its_time_is_not_tried_again(grade, tmp_path):
    endless = "import signal\nsignal.signal(signal.SIGXCPU, signal.SIG_IGN)\nwhile True: pass"
    folder = hand_in(tmp_path, f"{endless}\n{EULER}")
    rows = grade(folder, limits=Limits(seconds=0.5, gigabytes=1))
    mark = rows["a.ipynb"].marked.marks[0]
    assert "longer than 0.5 seconds" in mark.sentence
    assert mark.sure


MESSAGE = """import json, os, struct, time
def send(text, size=None):
    data = struct.pack("!i", len(text) if size is None else size) + text.encode()
    for file in range(3, 64):
        try: os.write(file, data)
        except OSError: pass
"""
HARMFUL = {
    "half a message": f"{MESSAGE}send('abc', 100)\ntime.sleep(600)",
    "another beginning": f"{MESSAGE}while True: send('[\"begun\", 1]'); time.sleep(0.5)",
    "other findings": f'{MESSAGE}while True: send(\'["found", ["correct", ""]]\')',
    "files of others": f"{MESSAGE}send('x' * 1000)",
    "deep folders": "import os\nfor _ in range(1500): os.mkdir('a'); os.chdir('a')",
    "parents": """import os
def parent(number):
    with open(f"/proc/{number}/stat") as f:
        return int(f.read().rpartition(")")[2].split()[1])
number = os.readlink("/proc/self")
keeper = parent(number)
for number in (parent(keeper), keeper):
    os.kill(number, 9)""",
}


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_a_harmful_answer_costs_its_own_points(grade, tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "_MESSAGE_SECONDS", 0.5)
    for name, code in HARMFUL.items():
        hand_in(tmp_path, f"{code}\n{EULER}", name)
        folder = hand_in(tmp_path, EULER, f"{name}, honest")
    rows = grade(folder, limits=Limits(seconds=1, gigabytes=1), workers=2)
    assert len(rows) == 2 * len(HARMFUL)
    assert all(points(row) == POINTS for name, row in rows.items() if "honest" in name)
    assert all(row.marked.marks for row in rows.values())


@pytest.mark.skipif(sys.platform == "win32", reason="open folders cannot be deleted")
def test_an_answer_that_deletes_the_folders_of_others(grade, tmp_path, monkeypatch, capfd):
    isolation.start_server()  # whose own folder is elsewhere
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    delete = f"""import os, shutil, time
own = os.getcwd()
place = os.path.dirname(own)
assert place == {str(tmp_path / "temporary")!r}
for _ in range(30):
    for name in set(os.listdir(place)) - {{os.path.basename(own)}}:
        shutil.rmtree(os.path.join(place, name), ignore_errors=True)
    time.sleep(0.05)
"""
    keep = "torch.save(1, 'one')\n    import time\n    time.sleep(0.5)\n"
    keep += "    x = x0 * torch.load('one')"
    hand_in(tmp_path, f"{delete}\n{EULER}", "delete")
    folder = hand_in(tmp_path, EULER.replace("x = x0", keep), "honest")
    rows = grade(folder, limits=Limits(seconds=5, gigabytes=1), workers=2)
    assert points(rows["honest.ipynb"]) == points(rows["delete.ipynb"]) == POINTS
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    "cells", [["#" + "check(" * 10**6], ["x = 1\n" * 10**6], ["pass"] * 10**4], ids=len
)
def test_notebooks_that_take_long_to_read(grade, tmp_path, cells):
    begun = time.monotonic()
    notebook = handed_in.homework({}, extra=(cells[0],))
    last = notebook.cells[-1]
    notebook.cells += [{**last, "id": f"more-{k}"} for k in range(len(cells) - 1)]
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.ipynb").write_text(json.dumps(notebook))
    assert "a.ipynb is too large" in grade(tmp_path / "in")["a.ipynb"].marked.note
    assert time.monotonic() - begun < 60


def test_a_long_line_is_searched_once(tmp_path):
    handed_in.write(tmp_path / "a.ipynb", only("#" + "check(" * 150_000))
    assert len(submissions.read(tmp_path / "a.ipynb").until("hw1.euler", {"euler"})) == 3


def test_forged_results_are_not_believed(grade, tmp_path):
    folder = hand_in(tmp_path, "def euler(*a):\n    return 1")
    assert points(grade(folder)["a.ipynb"]) == [0]
    (stored,) = (tmp_path / "grades" / ".known").iterdir()
    stored.write_text(stored.read_text().replace('"points": 0', '"points": 4'))
    row = grade(folder)["a.ipynb"]
    assert (points(row), row.kept) == ([0], False)
    assert grade(folder)["a.ipynb"].kept


def test_masters_that_are_none(grade, tmp_path):
    folder = hand_in(tmp_path, EULER)
    with pytest.raises(ValueError, match="there is no master notebook"):
        grade(folder, masters=tmp_path)
    handed_in.write(tmp_path / "hw1.ipynb", only(EULER))
    with pytest.raises(ValueError, match=r"hw1\.ipynb has no hidden tests"):
        grade(folder, masters=tmp_path)
    assert not (tmp_path / "grades.csv").exists()


def test_asserts_of_hidden_tests_stay(monkeypatch):
    """As in `python -O`, where `compile` drops asserts unless it is told not to."""

    def optimised(source, name, mode, optimize=-1):
        return compile(source, name, mode, optimize=2 if optimize == -1 else optimize)

    monkeypatch.setattr(answering, "compile", optimised, raising=False)
    source = "def test(interpolate):\n    assert False"
    exec(optimised(f"{source}\ntest(1)", "a cell", "exec"), {})
    assert answering._complaint(source, "wrong", {}) == "wrong"


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_an_answer_gets_no_environment_no_tests_and_no_large_files(grade, tmp_path):
    answer = f"""import os
known = set(os.environ)
with open("/proc/self/environ") as f:
    known |= {{word.split("=")[0] for word in f.read().split(chr(0)) if word}}
seen, frame = 0, __import__("sys")._getframe()
while frame := frame.f_back:
    seen += "test_euler_" + "again" in repr(frame.f_locals)
try:
    with open("large", "wb") as f:
        f.truncate({answering.FILE_BYTES + 1})
except OSError as error:
    large = error.strerror
def euler(*a):
    raise ValueError(f"{{sorted(known)}} {{seen}} {{large}}")"""
    sentence = grade(hand_in(tmp_path, answer))["a.ipynb"].marked.marks[0].sentence
    known = re.search(r"\[.*?\]", sentence)[0]
    assert not {"COTLEARN_GRADING_KEY", "PYTEST_CURRENT_TEST"} & set(ast.literal_eval(known)), known
    assert sentence.endswith("] 0 File too large")
