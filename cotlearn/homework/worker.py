"""What happens in the process of one question: run the cells, check the answer, run the tests."""

from __future__ import annotations

import contextlib
import inspect
import io
import json
import linecache
import math
import os
import random
import sys
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotlearn.homework import registry

if TYPE_CHECKING:
    from cotlearn.homework.assignments import HiddenTest
    from cotlearn.homework.submissions import Cell

#: Characters that an answer may print; more than any person reads.
PRINT_LIMIT = 1_000_000


class _Stop(BaseException):
    """The answer cannot go on, and why; no Exception, so that no `except` in it swallows this."""


@dataclass(frozen=True)
class Job:
    """What the process of one question is given.

    Attributes:
        setup: source that is run before the cells.
        cells: to run, in order.
        own: the number of the cell with the answer.
        answer: an expression, most often the name of a function.
        name: of its check.
        tests: the hidden ones.
    """

    setup: str
    cells: tuple[Cell, ...]
    own: int
    answer: str
    name: str
    tests: tuple[HiddenTest, ...] = ()


def run(job: Job, folder: str, seconds: float, gigabytes: float, channel: Connection) -> None:
    """Does a job and sends what it finds, one JSON message after the other.

    {"begun": true} when the learner's code starts; {"verdict", "sentence"} of the check; for each
    hidden test {"test", "passed", "sentence"}; {"end": true, "problem"} when all is done.

    Args:
        job: What to do.
        folder: to work in.
        seconds: of computing.
        gigabytes: of memory, beyond those in use when the answer begins.
        channel: to send to.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.setsid()  # so that all it starts can be ended together
    _prepare(folder)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.suppress(Exception):
        exec(compile(job.setup, "<setup>", "exec"), namespace)
    _limit(seconds, gigabytes)  # from here on it is the learner's code that runs
    _send(channel, {"begun": True})
    problem: str | None = None
    try:
        _question(job, namespace, channel)
    except _Stop as reason:
        problem = str(reason)
    except BaseException as error:
        problem = f"your answer {registry.said(error)}"
    _send(channel, {"end": True, "problem": problem})
    channel.close()
    os._exit(0)  # whatever the answer left behind must not run now


def _question(job: Job, namespace: dict[str, Any], channel: Connection) -> None:
    registry.TIME_LIMIT = math.inf  # this process has its own
    for cell in job.cells:
        _run_cell(cell, namespace, own=cell.number == job.own)
    try:
        answer = eval(job.answer, namespace)
    except Exception as error:
        raise _Stop(f"{job.answer} {registry.said(error)}") from error
    verdict, sentence = registry.judge(answer, job.name)
    _send(channel, {"verdict": verdict, "sentence": sentence})
    for index, test in enumerate(job.tests):
        if verdict is registry.Verdict.NOT_ATTEMPTED:
            sentence = "not attempted"
        else:
            sentence = _complaint(test, namespace)
        _send(channel, {"test": index, "passed": not sentence, "sentence": sentence})


def _run_cell(cell: Cell, namespace: dict[str, Any], *, own: bool) -> None:
    name = f"<cell {cell.number}>"
    lines = cell.source.splitlines(keepends=True)
    linecache.cache[name] = (len(cell.source), None, lines, name)  # for inspect.getsource
    try:
        exec(compile(cell.source, name, "exec"), namespace)
    except NotImplementedError:
        pass
    except Exception as error:
        frames = traceback.extract_tb(error.__traceback__)
        at = [frame.lineno for frame in frames if frame.filename == name]
        which = f"cell {cell.number} of the notebook, which this answer uses"
        if own:
            which = f"your cell (number {cell.number} of the notebook)"
        where = f", line {at[-1]}," if at else ""
        raise _Stop(f"{which}{where} {registry.said(error)}") from error


def _complaint(test: HiddenTest, namespace: dict[str, Any]) -> str:
    """What a hidden test has to say; "" if it passes."""
    scope: dict[str, Any] = {}
    exec(compile(test.source, "<hidden test>", "exec"), scope)
    function = next(value for value in reversed(scope.values()) if inspect.isfunction(value))
    names = inspect.signature(function).parameters
    values = {name: namespace if name == "env" else namespace.get(name) for name in names}
    try:
        function(**values)
    except AssertionError as error:
        return test.hint or str(error) or "a hidden test failed"
    except Exception as error:
        return f"your answer {registry.said(error)}" + (f" ({test.hint})" if test.hint else "")
    return ""


def _prepare(folder: str) -> None:
    """An empty folder, no input, an output that nobody reads, the same random numbers each time."""
    import numpy as np
    import torch

    import cotlearn.homework.preload  # noqa: F401

    os.chdir(folder)
    os.environ["HOME"] = folder  # a file that is deleted "at home" is none of the user's
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nowhere, descriptor)
    sys.stdin = io.StringIO()
    sys.stdout = sys.stderr = _Counted()
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002, the learner may use it
    torch.manual_seed(0)


class _Counted(io.TextIOBase):
    """Counts what is printed, and keeps none of it."""

    def __init__(self) -> None:
        self.rest = PRINT_LIMIT

    def write(self, text: str) -> int:
        self.rest -= len(text)
        if self.rest < 0:
            self.rest = PRINT_LIMIT  # so that the last words can be said
            raise _Stop(
                f"your answer printed more than {PRINT_LIMIT:,} characters; remove the print"
            )
        return len(text)

    def writable(self) -> bool:
        return True


def _limit(seconds: float, gigabytes: float) -> None:
    try:
        import resource
        import signal
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    whole = math.ceil(used.ru_utime + used.ru_stime + seconds)
    limits = {resource.RLIMIT_CPU: (whole, whole + 5), resource.RLIMIT_CORE: (0, 0)}
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        space = pages * resource.getpagesize() + int(gigabytes * 1e9)
        limits[resource.RLIMIT_AS] = (space, space)
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    # When the process that listens is killed, a sleeper would stay for ever.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(math.ceil(30 * seconds) + 10)
    for kind, limit in limits.items():
        with contextlib.suppress(ValueError, OSError):  # a stricter limit may be there already
            resource.setrlimit(kind, limit)


def _send(channel: Connection, message: dict[str, Any]) -> None:
    channel.send_bytes(json.dumps(message).encode())
