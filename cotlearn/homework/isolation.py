"""Runs one question in a separate process, with limits on time, memory and output.

This isolates accidents: an endless loop, an `exit()`, a flood of prints or an array that fills the
memory affects only its own question. It is no security sandbox: malicious code has all rights of
the user who runs it (see docs/teaching/grading.md).

The first half of this file is the parent, which starts the process and listens; the second half
runs in the process: it runs the cells, checks the answer and runs the hidden tests.
"""

import contextlib
import functools
import inspect
import io
import json
import linecache
import math
import multiprocessing
import multiprocessing.connection
import os
import random
import signal
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

from cotlearn.homework import registry
from cotlearn.homework.assignments import HiddenTest, Question
from cotlearn.homework.submissions import Cell

START = 300.0  #: seconds that a process may take to begin, on a very busy machine
PRINT_LIMIT = 1_000_000  #: characters that an answer may print; more than any person reads
_MESSAGE_BYTES = 1_000_000


@dataclass(frozen=True)
class Limits:
    """The time and memory limits of a question.

    Attributes:
        seconds: of computing. An answer that sleeps is stopped after three times as long; one that
            only waits for a core of a busy machine is not (on Linux).
        gigabytes: of memory, on top of what Python and torch take; only where the system can
            (`has_memory_limit`).
    """

    seconds: float = 60.0
    gigabytes: float = 4.0

    def __post_init__(self) -> None:
        for name in ("seconds", "gigabytes"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name} must be positive, got {getattr(self, name)}")


@dataclass(frozen=True)
class Job:
    """The input of the process of one question.

    Attributes:
        question: the question with its hidden tests.
        setup: source to run before the cells.
        cells: cells to run, in order.
        own: number of the cell with the answer.
    """

    question: Question
    setup: str
    cells: list[Cell]
    own: int


def has_memory_limit() -> bool:
    """Tells whether this system can limit the memory of a process; of ours, only Linux can."""
    return sys.platform == "linux"


def run(job: Job, limits: Limits) -> tuple[list[Any], str | None]:
    """Runs a job in a separate process and an empty folder.

    Args:
        job: A question and the cells that it needs.
        limits: Limits on time and memory.

    Returns:
        The findings (the verdict and sentence of the check, then the failure message of each hidden
        test, "" if it passes); and the reason why the process did not finish, or None if it did.

    Raises:
        RuntimeError: The process did not start, for reasons other than the answer.
    """
    context = _context()
    ours, theirs = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="cotlearn-", ignore_cleanup_errors=True) as folder:
        process = context.Process(  # type: ignore[attr-defined]
            target=_work, args=(job, folder, limits, theirs)
        )
        process.start()
        theirs.close()
        try:
            return _listen(ours, process, limits)
        finally:
            _end(process)
            ours.close()


def _listen(channel: Connection, process: Any, limits: Limits) -> tuple[list[Any], str | None]:
    found: list[Any] = []
    begun = False
    deadline = time.monotonic() + START
    while True:
        rest = deadline - time.monotonic()
        ready = multiprocessing.connection.wait([channel, process.sentinel], max(rest, 0))
        if channel in ready:
            try:
                kind, value = json.loads(channel.recv_bytes(_MESSAGE_BYTES))
            except (EOFError, OSError, ValueError):
                return found, _why(process, limits, begun=begun)
            if kind == "end":
                return found, value
            if kind == "begun":  # loading is not the learner's time
                begun = True
                deadline = time.monotonic() + 3 * limits.seconds
            else:
                found.append(value)
        elif ready:  # it is gone, and left nothing in the channel
            return found, _why(process, limits, begun=begun)
        elif rest <= 0:
            if not begun:
                raise RuntimeError("the process for an answer took too long to start")
            if not _waits_for_a_core(process.pid):
                return found, registry.too_long(limits.seconds)
            deadline += limits.seconds  # its computing time is limited by the system


def _waits_for_a_core(pid: int) -> bool:
    """Tells a process that a busy machine holds up from one that sleeps; False if unknown."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False
    return stat.rpartition(")")[2].split()[0] in {"R", "D"}


def _why(process: Any, limits: Limits, *, begun: bool) -> str:
    """A sentence for a process that ended without its last message."""
    process.join(5)
    code = process.exitcode
    if not begun:
        raise RuntimeError(f"the process for an answer did not start (exit code {code})")
    if hasattr(signal, "SIGXCPU") and code == -signal.SIGXCPU:
        return registry.too_long(limits.seconds)
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        memory = "; most often that is memory" if name in {"SIGKILL", "SIGSEGV", "SIGABRT"} else ""
        return f"your answer made Python crash ({name}{memory})"
    return "your answer ended Python (os._exit, or a crash), so that nothing after it could run"


def _end(process: Any) -> None:
    """Ends a process and all that it started."""
    if hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()
    process.close()


@functools.cache
def _context() -> BaseContext:
    """On Linux processes start from a server that has imported torch once, elsewhere anew.

    On macOS there is a fork, too, but its numerical libraries do not survive it.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["cotlearn.homework.preload"])
    return context


def _work(job: Job, folder: str, limits: Limits, channel: Connection) -> None:
    """Does a job in this process, and sends pairs [kind, value] as JSON, which cannot run code.

    ["begun", null] when the learner's code starts, ["found", value] for each finding of `run`, and
    ["end", problem] when all is done.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.setsid()  # so that all it starts can be ended together
    _prepare(folder)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.suppress(Exception):
        exec(compile(job.setup, "<setup>", "exec"), namespace)
    _limit(limits)  # from here on it is the learner's code that runs
    _send(channel, "begun")
    problem: str | None = None
    try:
        for found in _findings(job, namespace):
            _send(channel, "found", found)
    except registry.Stopped as reason:
        problem = str(reason)
    except BaseException as error:
        problem = f"your answer {registry.said(error)}"
    _send(channel, "end", problem)
    channel.close()
    os._exit(0)  # whatever the answer left behind must not run now


def _send(channel: Connection, kind: str, value: object = None) -> None:
    channel.send_bytes(json.dumps([kind, value]).encode())


def _findings(job: Job, namespace: dict[str, Any]) -> Iterator[Any]:
    registry.TIME_LIMIT = math.inf  # this process has its own
    for cell in job.cells:
        _run_cell(cell, namespace, own=cell.number == job.own)
    question = job.question
    try:
        answer = eval(question.answer, namespace)
    except Exception as error:
        raise registry.Stopped(f"{question.answer} {registry.said(error)}") from error
    verdict, sentence = registry.judge(answer, question.name)
    yield verdict, sentence
    if verdict is not registry.Verdict.NOT_ATTEMPTED:
        yield from (_complaint(test, namespace) for test in question.tests)


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
        raise registry.Stopped(f"{which}{where} {registry.said(error)}") from error


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

    rest = PRINT_LIMIT

    def write(self, text: str) -> int:
        self.rest -= len(text)
        if self.rest < 0:
            self.rest = PRINT_LIMIT  # so that the last words can be said
            words = f"your answer printed more than {PRINT_LIMIT:,} characters; remove the print"
            raise registry.Stopped(words)
        return len(text)


def _limit(limits: Limits) -> None:
    try:
        import resource
    except ImportError:  # Windows
        return
    used = resource.getrusage(resource.RUSAGE_SELF)
    whole = math.ceil(used.ru_utime + used.ru_stime + limits.seconds)
    most = {resource.RLIMIT_CPU: (whole, whole + 5), resource.RLIMIT_CORE: (0, 0)}
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        space = pages * resource.getpagesize() + int(limits.gigabytes * 1e9)
        most[resource.RLIMIT_AS] = (space, space)
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    # When the process that listens is killed, a sleeper would stay for ever.
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    signal.alarm(math.ceil(30 * limits.seconds) + 10)
    for kind, limit in most.items():
        with contextlib.suppress(ValueError, OSError):  # a stricter limit may be there already
            resource.setrlimit(kind, limit)
