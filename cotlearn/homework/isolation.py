"""Runs one question in a separate process, with limits on time, memory and output.

This isolates accidents: an endless loop, an `exit()`, a flood of prints or an array that fills the
memory affects only its own question. It is no security sandbox: malicious code has all rights of
the user who runs it (see docs/teaching/grading.md).

The first half of this file is the parent, which starts the process and listens; the second half is
what happens in the process: run the cells, check the answer, run the hidden tests. On Linux the
process is two: one runs the answer, and the other ends it and all that it started when it is done
or the parent is gone.
"""

import contextlib
import ctypes
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
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from dataclasses import dataclass, replace
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

from cotlearn import homework
from cotlearn.homework import registry
from cotlearn.homework.assignments import HiddenTest, Question
from cotlearn.homework.submissions import Cell

START = 300.0  #: seconds that a process may take to begin, on a very busy machine
PRINT_LIMIT = 1_000_000  #: characters that an answer may print; more than any person reads
FILE_BYTES = 200_000_000  #: that an answer may write into one file
PROCESSES = 200  #: that an answer may start, threads included; root has no such limit
_MESSAGE_BYTES = 1_000_000
#: What an answer may know of the environment: where programs and libraries are.
_ENVIRONMENT = {"PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "SYSTEMROOT"} | {
    *("OMP_NUM_THREADS", "MPLBACKEND", "COTLEARN_PROGRESS")
}
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # of linux/prctl.h

#: Set it to end all `run` of this program within half a second.
stopping = threading.Event()


class Disturbed(RuntimeError):
    """The process of an answer ended for a reason that is not the answer's."""


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
        as_notebook: run the cells in IPython, as they are, and go on after one that fails.
    """

    question: Question
    setup: str
    cells: list[Cell]
    own: int
    as_notebook: bool = False


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
        Disturbed: The process did not even begin, or was killed by another program or the system.
        KeyboardInterrupt: `stopping` was set.
    """
    context = _context()
    ours, theirs = context.Pipe()
    watched, life = context.Pipe(duplex=False)  # ends with this program, or when it is closed
    tests = list(job.question.tests)
    bare = replace(job, question=replace(job.question, tests=()))
    with tempfile.TemporaryDirectory(prefix="cotlearn-", ignore_cleanup_errors=True) as folder:
        process = context.Process(  # type: ignore[attr-defined]
            target=_work, args=(bare, folder, limits, theirs, watched)
        )
        process.start()
        theirs.close()
        watched.close()
        try:
            return _listen(ours, process, limits, tests)
        finally:
            life.close()
            _end(process)
            ours.close()


def start_server() -> None:
    """Loads all that answers need, so that `run` begins at once; Ctrl-C ends this, too."""
    process = _context().Process(target=int)  # type: ignore[attr-defined]
    process.start()
    process.join()


def _listen(
    channel: Connection, process: Any, limits: Limits, tests: list[HiddenTest]
) -> tuple[list[Any], str | None]:
    found: list[Any] = []
    answer = 0  # its process, once it has begun
    deadline = time.monotonic() + START
    while True:
        if stopping.is_set():
            raise KeyboardInterrupt
        rest = deadline - time.monotonic()
        wait = min(max(rest, 0), 0.5)
        ready = multiprocessing.connection.wait([channel, process.sentinel], wait)
        if channel in ready:
            try:
                kind, value = json.loads(channel.recv_bytes(_MESSAGE_BYTES))
                if kind == "end":
                    return found, None if value is None else str(value)
                if kind == "begun":  # loading is not the learner's time
                    answer, deadline = int(value), time.monotonic() + 3 * limits.seconds
                    continue
                found.append(str(value) if found else _verdict(value))
                test = tests.pop(0) if tests else None
                channel.send_bytes(json.dumps(test and [test.source, test.hint]).encode())
            except (EOFError, OSError):
                return found, _why(process, limits, begun=bool(answer))
            except (ValueError, TypeError, RecursionError):
                return found, "your answer wrote into the channel of the grader"
        elif ready:  # it is gone, and left nothing in the channel
            return found, _why(process, limits, begun=bool(answer))
        elif rest <= 0:
            if not answer:
                raise Disturbed("the process for an answer took too long to start")
            if not _waits_for_a_core(answer):
                return found, registry.too_long(limits.seconds)
            deadline += limits.seconds  # its computing time is limited by the system


def _verdict(value: Any) -> list[str]:
    """The verdict of the self-check and its sentence, from what a process sent."""
    verdict, sentence = value
    return [str(registry.Verdict(verdict)), str(sentence)]


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
        raise Disturbed(f"the process for an answer did not start (exit code {code})")
    if hasattr(signal, "SIGXCPU") and code == -signal.SIGXCPU:
        return registry.too_long(limits.seconds)
    if code in (-signal.SIGTERM, -getattr(signal, "SIGKILL", signal.SIGTERM)):
        raise Disturbed("the process of this answer was killed from outside")
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        memory = "; most often that is memory" if name in {"SIGSEGV", "SIGABRT"} else ""
        return f"your answer made Python crash ({name}{memory})"
    return "your answer ended Python (os._exit, or a crash), so that nothing after it could run"


def _end(process: Any) -> None:
    """Ends a process and all that it started."""
    process.join(2)  # it ends by itself, as its life was closed
    if process.is_alive() and hasattr(os, "killpg"):
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
    before = dict(os.environ)
    _clear_environment()  # /proc shows what a process was started with
    try:
        forkserver.ensure_running()
    finally:
        os.environ.update(before)
    return context


def _clear_environment() -> None:
    for name in set(os.environ) - _ENVIRONMENT:
        del os.environ[name]


def _work(job: Job, folder: str, limits: Limits, channel: Connection, life: Connection) -> None:
    """Does a job in this process, and sends pairs [kind, value] as JSON, which cannot run code.

    ["begun", process] when the learner's code starts, ["found", value] for each finding of `run`,
    each answered with the next hidden test, and ["end", problem] when all is done.
    """
    with contextlib.suppress(AttributeError, OSError):
        os.setsid()  # so that all it starts can be ended together
    if sys.platform == "linux":
        _fork(folder, limits, channel, life)
    else:
        threading.Thread(target=_outlive_nobody, args=(life,), daemon=True).start()
    _prepare(folder)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.suppress(Exception):
        exec(compile(job.setup, "<setup>", "exec"), namespace)
    _limit(limits)  # from here on it is the learner's code that runs
    _send(channel, "begun", os.getpid())
    problem: str | None = None
    try:
        _find(job, namespace, channel)
    except registry.Stopped as reason:
        problem = str(reason)
    except BaseException as error:
        problem = f"your answer {registry.said(error)}"
    _send(channel, "end", problem)
    channel.close()
    os._exit(0)  # whatever the answer left behind must not run now


def _outlive_nobody(life: Connection) -> None:
    """Ends this process when its parent is gone."""
    with contextlib.suppress(EOFError, OSError):
        life.recv_bytes()
    os._exit(1)


def _fork(folder: str, limits: Limits, channel: Connection, life: Connection) -> None:
    """Returns in a new process; this one waits for its end, or that of the parent, and cleans up.

    Processes that the answer started come to this one when they lose their parents, even if they
    are in sessions of their own.
    """
    _prctl(_PR_SET_CHILD_SUBREAPER, 1)
    answer = os.fork()
    if answer == 0:
        life.close()
        os.setsid()
        _prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
        return
    channel.close()
    status, used = 0, 0.0
    end = os.pidfd_open(answer)
    if life not in multiprocessing.connection.wait([life, end]):
        _, status, usage = os.wait4(answer, 0)
        used = usage.ru_utime + usage.ru_stime
    else:
        shutil.rmtree(folder, ignore_errors=True)  # the parent may be gone
    with contextlib.suppress(ProcessLookupError):
        os.killpg(answer, signal.SIGKILL)
    with contextlib.suppress(ChildProcessError):
        while True:
            for child in _children():
                with contextlib.suppress(ProcessLookupError):
                    os.kill(child, signal.SIGKILL)
            os.waitpid(-1, 0)
    if os.WIFSIGNALED(status):  # this process ends in the same way, to tell it to the parent
        number = os.WTERMSIG(status)
        if number == signal.SIGKILL and used > limits.seconds:  # it had ignored SIGXCPU
            number = signal.SIGXCPU
        if number != signal.SIGKILL:
            signal.signal(number, signal.SIG_DFL)
        os.kill(os.getpid(), number)
    os._exit(os.waitstatus_to_exitcode(status) if os.WIFEXITED(status) else 1)


def _children() -> list[int]:
    """The children of this process."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            if int(words[1]) == os.getpid():
                found.append(int(path.parent.name))
    return found


def _prctl(option: int, value: int) -> None:
    ctypes.CDLL(None).prctl(option, value, 0, 0, 0)


def _send(channel: Connection, kind: str, value: object = None) -> None:
    channel.send_bytes(json.dumps([kind, value]).encode())


def _find(job: Job, namespace: dict[str, Any], channel: Connection) -> None:
    """Runs the cells, and sends what the check finds, and each hidden test that the parent sends.

    No test is in this process before the cells have run.
    """
    registry.TIME_LIMIT = math.inf  # this process has its own
    if job.as_notebook:
        _run_notebook(job, namespace)
    else:
        for cell in job.cells:
            _run_cell(cell, namespace, own=cell.number == job.own)
    question = job.question
    try:
        answer = eval(question.answer, namespace)
    except Exception as error:
        raise registry.Stopped(f"{question.answer} {registry.said(error)}") from error
    verdict, sentence = registry.judge(answer, question.name)
    _send(channel, "found", [verdict, sentence])
    if verdict is not registry.Verdict.NOT_ATTEMPTED:
        while test := json.loads(channel.recv_bytes()):
            source, hint = test
            _send(channel, "found", _complaint(source, hint, namespace))


def _run_notebook(job: Job, namespace: dict[str, Any]) -> None:
    """Runs cells in IPython, magics included; only an error in the answer's own cell counts."""
    from IPython.core.interactiveshell import InteractiveShell
    from traitlets.config import Config

    class Shell(InteractiveShell):
        def enable_gui(self, gui: str | None = None) -> None:
            """Has no windows, for `%matplotlib inline`."""

    config = Config({"HistoryManager": {"enabled": False}})
    shell = Shell.instance(user_ns=namespace, config=config)
    for cell in job.cells:
        error = shell.run_cell(cell.written, silent=True).error_in_exec
        if isinstance(error, registry.Stopped):
            raise error
        if cell.number == job.own and error and not isinstance(error, NotImplementedError):
            raise registry.Stopped(f"your cell (number {cell.number}) {registry.said(error)}")


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


def _complaint(source: str, hint: str, namespace: dict[str, Any]) -> str:
    """What a hidden test has to say; "" if it passes."""
    scope: dict[str, Any] = {}
    exec(compile(source, "<hidden test>", "exec", optimize=0), scope)  # asserts are the test
    function = next(value for value in reversed(scope.values()) if inspect.isfunction(value))
    names = inspect.signature(function).parameters
    values = {name: namespace if name == "env" else namespace.get(name) for name in names}
    try:
        function(**values)
    except AssertionError as error:
        return hint or str(error) or "a hidden test failed"
    except Exception as error:
        return f"your answer {registry.said(error)}" + (f" ({hint})" if hint else "")
    return ""


def _prepare(folder: str) -> None:
    """An empty folder, no input, an output that nobody reads, the same random numbers each time."""
    import numpy as np
    import torch

    import cotlearn.homework.preload  # noqa: F401

    os.chdir(folder)
    _clear_environment()
    os.environ["HOME"] = folder  # a file that is deleted "at home" is none of the user's
    nowhere = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(nowhere, descriptor)
    sys.stdin = io.StringIO()
    sys.stdout = sys.stderr = _Counted()
    homework.check = lambda answer, name: registry.Verdict.NOT_ATTEMPTED  # the cells' own checks
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
    most[resource.RLIMIT_FSIZE] = (FILE_BYTES, FILE_BYTES)
    if sys.platform == "linux":
        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
        space = pages * resource.getpagesize() + int(limits.gigabytes * 1e9)
        most[resource.RLIMIT_AS] = (space, space)
        processes = _tasks() + PROCESSES  # the system counts all of this user
        most[resource.RLIMIT_NPROC] = (processes, processes)
    signal.signal(signal.SIGXCPU, signal.SIG_DFL)
    for kind, limit in most.items():
        with contextlib.suppress(ValueError, OSError):  # a stricter limit may be there already
            resource.setrlimit(kind, limit)


def _tasks() -> int:
    """The number of processes and threads that this user has."""
    count = 0
    for path in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            if path.stat().st_uid == os.getuid():
                count += len(list((path / "task").iterdir()))
    return count
