"""Accidents in an answer cost that question only, and read as a sentence."""

import contextlib
import sys
import time
from pathlib import Path

import pytest
from waiting import until

from cotlearn.homework import isolation
from cotlearn.homework.assignments import HiddenTest, Question
from cotlearn.homework.isolation import Job, Limits
from cotlearn.homework.submissions import Cell

LIMITS = Limits(seconds=0.5, gigabytes=1)  # the system rounds up to 1 of computing
RIGHT = "def interpolate(x0, x1, t):\n    t = t[:, None]\n    return (1 - t) * x0 + t * x1, x1 - x0"
CELL = "your cell (number 3 of the notebook)"


def run(source, *, tests=(), limits=LIMITS):
    """What was found, and the problem."""
    question = Question("01.interpolate", "interpolate", tests)
    setup = "import torch\nimport numpy as np"
    return isolation.run(Job(question, setup, [Cell(3, source)], 3), limits)


def test_a_right_answer():
    assert run(RIGHT) == ([["correct", "correct"]], None)


LOOP = "longer than 0.5 seconds and was stopped; is there a loop that never ends?"
EXIT = "ended Python (exit or quit)"
ACCIDENTS = {
    "endless loop": ("while True: pass", LOOP),
    "endless loop in the answer": ("def interpolate(*a):\n    while True: pass", LOOP),
    "sleep": ("import time\ntime.sleep(1000)", LOOP),
    "exit": ("exit()", EXIT),
    "sys.exit in the answer": ("import sys\ndef interpolate(*a):\n    sys.exit()", EXIT),
    "os._exit": ("import os\nos._exit(0)", "ended Python (os._exit, or a crash)"),
    "print flood": ("while True: print('x' * 1000)", "printed more than 1,000,000 characters"),
    "print flood past print": ("import os\nwhile True: os.write(1, b'x' * 1000)", LOOP),
    "an error": ("x = 1\n1 / 0", f"{CELL}, line 2, raised ZeroDivisionError: division by zero"),
    "input": ("input()", "waited for input, and nobody is there to type"),
    "keyboard interrupt": ("raise KeyboardInterrupt", "was interrupted"),
    "recursion": ("def f(): return f()\nf()", "called itself without end"),
}
MEMORY = {
    "100 GB in numpy": "interpolate = np.ones(int(12.5e9))",
    "100 GB in torch": "interpolate = torch.ones(int(25e9))",
    "a list that grows": "a = []\nwhile True: a.append(bytearray(10**7))",
}


@pytest.mark.skipif(sys.platform == "win32", reason="no fork")
@pytest.mark.parametrize("name", ACCIDENTS)
def test_an_accident_is_a_sentence(name, capfd):
    source, sentence = ACCIDENTS[name]
    assert sentence in run(source)[1]
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not isolation.has_memory_limit(), reason="no memory limit on this system")
@pytest.mark.parametrize("name", MEMORY)
def test_too_much_memory_is_a_sentence(name):
    _, problem = run(MEMORY[name], limits=Limits(seconds=5, gigabytes=0.5))
    assert "asked for more memory than it may have" in problem


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
def test_a_crash_is_a_sentence():
    assert "made Python crash (SIGSEGV" in run("import ctypes\nctypes.string_at(0)")[1]


def test_deleted_files_are_not_those_of_the_notebook(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / "hw1.ipynb"
    kept.write_text("precious")
    source = "import glob, os\n[os.remove(f) for f in glob.glob('*')]\nos.remove('hw1.ipynb')"
    assert "raised FileNotFoundError" in run(source)[1]
    assert kept.read_text() == "precious"


def test_what_was_found_before_the_accident_is_kept():
    first = HiddenTest("def test_one(interpolate):\n    assert interpolate", 1, "")
    second = HiddenTest("def test_two(interpolate):\n    import os\n    os._exit(1)", 1, "")
    found, problem = run(RIGHT, tests=(first, second))
    assert found == [["correct", "correct"], ""]
    assert "ended Python" in problem


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_nothing_stays_behind():
    mark = f"cotlearn-left-{time.time_ns()}"
    source = f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', '#{mark}\\n' + "
    source += "'import time; time.sleep(60)'])\ntime_is_up = True\nwhile True: pass"
    run(source)  # to be killed takes a moment
    until(lambda: not any(mark in command for command in commands()), patience=20)


def commands():
    """The command lines of all processes."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            yield path.read_text(errors="replace")


def test_limits_are_checked():
    with pytest.raises(ValueError, match="seconds must be above 0, got 0"):
        Limits(seconds=0)
    with pytest.raises(ValueError, match="gigabytes must be at least 0"):
        Limits(gigabytes=-1)
