"""Ctrl-C ends a command at once, and nothing that it started outlives it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import handed_in
import numpy as np
import pytest
from handed_in import EULER
from support import soon, until

pytestmark = [pytest.mark.slow, pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")]
CODES = {130, -signal.SIGINT}  # the same for a shell
NUMBERS = [signal.SIGINT, signal.SIGKILL]
# Before this file is there, Ctrl-C meets Python's own start and not the command.
BEGIN = """import runpy, signal
signal.signal(signal.SIGINT, signal.default_int_handler)  # a `make test &` ignores Ctrl-C
open("up", "w").close()
runpy.run_module("cotlearn", run_name="__main__", alter_sys=True)"""

# An import that takes long, and loses the exception of Ctrl-C as torch's can.
SLOWLY = """import builtins, os, time
original = builtins.__import__
def slow(name, *more, **named):
    if name == os.environ["SLOWLY"] and not os.path.exists("loading"):
        open("loading", "w").close()
        try:
            time.sleep(20)
        except KeyboardInterrupt:
            raise ImportError("numpy._core failed to import") from None
    return original(name, *more, **named)
builtins.__import__ = slow"""


def alive(mark):
    """The processes whose command or folder has this word in it."""
    found = []
    for path in Path("/proc").glob("[0-9]*"):
        try:
            words = (path / "cmdline").read_text(errors="replace") + str((path / "cwd").readlink())
        except OSError:
            continue
        if mark in words and int(path.name) != os.getpid():
            found.append(int(path.name))
    return found


def check_end(tmp_path, code, begun, codes=CODES):
    """A process ended soon after `begun`, said no traceback, and left nobody behind."""
    assert time.monotonic() - begun < soon()
    text = (tmp_path / "said").read_text()
    assert code in codes, text
    assert "Traceback" not in text
    until(lambda: not alive(str(tmp_path)))


@pytest.fixture
def environment(tmp_path):
    return {**os.environ, "TMPDIR": str(tmp_path)}


@pytest.fixture
def started(tmp_path, environment):
    """Starts a command from the beginning, with Python and all that it imports."""
    processes = []

    def start(words):
        command = [sys.executable, "-c", BEGIN, *words]
        with (tmp_path / "said").open("w") as said:
            options = {"stdout": said, "stderr": said, "start_new_session": True}
            processes.append(subprocess.Popen(command, env=environment, cwd=tmp_path, **options))
        until((tmp_path / "up").exists)
        return processes[-1]

    yield start
    for process in processes:
        process.kill()
        process.wait()


@pytest.fixture
def running(begun, tmp_path, environment):
    """Starts a command that has imported everything, and waits until it is in an answer."""

    def start(words):
        process = begun(words, environment)
        begins = (tmp_path / "begun").exists
        until(lambda: begins() or not process.is_alive())
        assert begins(), (tmp_path / "said").read_text()
        return process

    return start


def sleeper(tmp_path, *, child=True):
    """A notebook whose answer starts a process, and waits."""
    start = f"import subprocess, sys\nsubprocess.Popen([sys.executable, '-c', '''#{tmp_path}\n"
    start += "import time; time.sleep(600)'''])\n"
    wait = f"open({str(tmp_path / 'begun')!r}, 'w').close()\nimport time\ntime.sleep(600)\n"
    path = tmp_path / "in" / "hw1.ipynb"
    answers = handed_in.answers(loss=(start if child else "") + wait + EULER)
    handed_in.write(path, handed_in.homework(answers))
    return path


@pytest.mark.parametrize(
    ("command", "number"),
    [("grade", signal.SIGINT), ("check", signal.SIGINT), ("grade", signal.SIGKILL)],
)
def test_an_end_in_an_answer(tmp_path, running, command, number):
    path = sleeper(tmp_path, child=number == signal.SIGINT)
    process = running([command, str(path.parent if command == "grade" else path)])
    begun = time.monotonic()
    os.kill(process.pid, number)
    process.join(60)
    if number == signal.SIGINT:
        check_end(tmp_path, process.exitcode, begun)
        assert not list(tmp_path.glob("cotlearn-*"))
    until(lambda: not alive(str(tmp_path)))
    assert time.monotonic() - begun < 3 * soon()


@pytest.mark.parametrize("number", NUMBERS)
@pytest.mark.parametrize("words", ["run a.ipynb --inplace", "homework"])
def test_an_end_of_what_has_children(tmp_path, running, words, number):
    """A kernel that waits, and otter that waits; what was there before stays as it is."""
    wait = f"open({str(tmp_path / 'begun')!r}, 'w').close()\nimport time\ntime.sleep(600)"
    handed_in.write(tmp_path / "a.ipynb", handed_in.homework({}, extra=(wait,)))
    before = (tmp_path / "a.ipynb").read_bytes()
    (tmp_path / "otter").mkdir()
    enough = f"pathlib.Path({str(tmp_path / 'enough')!r})"
    slowly = f"import pathlib\nwhile not {enough}.exists():\n    time.sleep(0.05)"
    (tmp_path / "otter" / "__init__.py").touch()  # before the real one, if that is installed
    (tmp_path / "otter" / "__main__.py").write_text(wait.replace("time.sleep(600)", slowly))
    process = running(words.split())
    begun = time.monotonic()
    os.kill(process.pid, number)
    process.join(60)
    if number == signal.SIGKILL:
        (tmp_path / "enough").touch()  # nothing ends otter then but its own last line
    codes = CODES if number == signal.SIGINT else {-number}
    check_end(tmp_path, process.exitcode, begun, codes)
    assert (tmp_path / "a.ipynb").read_bytes() == before


MOMENTS = [("grade in", 1), ("grade in", 3.5), ("progress", 0.3), ("run 01", 2.5)]


@pytest.mark.parametrize(("words", "seconds"), MOMENTS)
def test_an_end_at_any_moment(tmp_path, started, words, seconds):
    """While it loads the command or torch, and while a kernel starts."""
    sleeper(tmp_path)
    process = started(words.split())
    time.sleep(seconds)
    if process.poll() is not None:
        pytest.skip("it was over")
    begun = time.monotonic()
    process.send_signal(signal.SIGINT)
    process.wait(60)
    check_end(tmp_path, process.returncode, begun)


LOADING = [("report", "torch"), ("report", "cotlearn.report"), ("lab", "jupyterlab.labapp")]


@pytest.mark.parametrize(("word", "module"), [("report", "typer"), ("lab", "typer"), *LOADING])
def test_an_end_while_it_loads(tmp_path, environment, word, module):
    """Ctrl-C of a terminal reaches all processes; it comes in the middle of an import."""
    (tmp_path / "sitecustomize.py").write_text(SLOWLY)
    np.savez(tmp_path / "mine.npz", x1=np.ones((4, 2)), c=np.ones((4, 1)))
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment |= {"PYTHONPATH": os.pathsep.join(paths), "SLOWLY": module}
    words = {"report": ["mine.npz"], "lab": ["--no-browser", "--port", "9871"]}[word]
    command = [sys.executable, "-c", BEGIN, word, *words]
    with (tmp_path / "said").open("w") as said:
        options = {"stdout": said, "stderr": said, "start_new_session": True}
        process = subprocess.Popen(command, env=environment, cwd=tmp_path, **options)
    until(lambda: (tmp_path / "loading").exists() or process.poll() is not None)
    begun = time.monotonic()
    os.killpg(process.pid, signal.SIGINT)
    process.wait(60)
    check_end(tmp_path, process.returncode, begun, {130})
    assert (tmp_path / "said").read_text().splitlines()[-1] == "stopped"
