"""Accidents in an answer cost that question only, and read as a sentence."""

import contextlib
import sys
import time
from pathlib import Path

import pytest

from cotlearn.homework import isolation
from cotlearn.homework.assignments import HiddenTest
from cotlearn.homework.isolation import Limits
from cotlearn.homework.submissions import Cell
from cotlearn.homework.worker import Job

LIMITS = Limits(seconds=1, gigabytes=1)
RIGHT = "def interpolate(x0, x1, t):\n    t = t[:, None]\n    return (1 - t) * x0 + t * x1, x1 - x0"
CELL = "your cell (number 3 of the notebook)"


def run(source, *, tests=(), limits=LIMITS):
    cells = (Cell(3, source),)
    setup = "import torch\nimport numpy as np"
    return isolation.run(Job(setup, cells, 3, "interpolate", "01.interpolate", tests), limits)


def test_a_right_answer():
    outcome = run(RIGHT)
    assert outcome.problem is None
    assert outcome.messages == ({"verdict": "correct", "sentence": "correct"},)


LOOP = "longer than 1 seconds and was stopped; is there a loop that never ends?"
ACCIDENTS = {
    "endless loop": ("while True: pass", LOOP),
    "endless loop in the answer": ("def interpolate(*a):\n    while True: pass", LOOP),
    "sleep": ("import time\ntime.sleep(1000)", LOOP),
    "exit": ("exit()", "ended Python (exit or quit)"),
    "sys.exit in the answer": (
        "import sys\ndef interpolate(*a):\n    sys.exit()",
        "ended Python (exit or quit)",
    ),
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
    assert sentence in run(source).problem
    assert capfd.readouterr() == ("", "")


@pytest.mark.skipif(not isolation.has_memory_limit(), reason="no memory limit on this system")
@pytest.mark.parametrize("name", MEMORY)
def test_too_much_memory_is_a_sentence(name):
    found = run(MEMORY[name], limits=Limits(seconds=5, gigabytes=0.5))
    assert "asked for more memory than it may have" in found.problem


@pytest.mark.skipif(sys.platform == "win32", reason="no signals")
def test_a_crash_is_a_sentence():
    assert "made Python crash (SIGSEGV" in run("import ctypes\nctypes.string_at(0)").problem


def test_deleted_files_are_not_those_of_the_notebook(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    kept = tmp_path / "hw1.ipynb"
    kept.write_text("precious")
    source = "import glob, os\n[os.remove(f) for f in glob.glob('*')]\nos.remove('hw1.ipynb')"
    assert "raised FileNotFoundError" in run(source).problem
    assert kept.read_text() == "precious"


def test_what_was_found_before_the_accident_is_kept():
    first = HiddenTest("def test_one(interpolate):\n    assert interpolate", 1, "")
    second = HiddenTest("def test_two(interpolate):\n    import os\n    os._exit(1)", 1, "")
    outcome = run(RIGHT, tests=(first, second))
    assert [m.get("passed") for m in outcome.messages] == [None, True]
    assert "ended Python" in outcome.problem


@pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
def test_nothing_stays_behind():
    mark = f"cotlearn-left-{time.time_ns()}"
    source = f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', '#{mark}\\n' + "
    source += "'import time; time.sleep(60)'])\ntime_is_up = True\nwhile True: pass"
    run(source)
    deadline = time.monotonic() + 20  # to be killed takes a moment
    while any(mark in command for command in commands()):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def commands():
    """The command lines of all processes."""
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        with contextlib.suppress(OSError):
            yield path.read_text(errors="replace")


def test_limits_are_checked():
    with pytest.raises(ValueError, match="seconds must be positive, got 0"):
        Limits(seconds=0)
    with pytest.raises(ValueError, match="gigabytes must be positive"):
        Limits(gigabytes=-1)
