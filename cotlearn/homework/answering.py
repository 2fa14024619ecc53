"""Code in the process of an answer: runs the cells, checks the answer, runs the hidden tests.

On Linux there are two processes: one runs the answer. The other waits until the answer is done or
the parent is gone, and then ends everything that the answer started.
"""

from __future__ import annotations

import contextlib
import ctypes
import inspect
import io
import json
import linecache
import math
import multiprocessing.connection
import multiprocessing.resource_tracker
import os
import random
import shutil
import signal
import sys
import threading
import traceback
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cotlearn import homework
from cotlearn.homework import registry

if TYPE_CHECKING:
    from cotlearn.homework.isolation import Job, Limits
    from cotlearn.homework.submissions import Cell

PRINT_LIMIT = 1_000_000  #: characters that an answer may print; more than any person reads
FILE_BYTES = 200_000_000  #: that an answer may write into one file
PROCESSES = 200  #: that an answer may start, threads included; root has no such limit
#: What an answer may know of the environment: where programs and libraries are.
_ENVIRONMENT = {"PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "SYSTEMROOT", "TMPDIR"}
_ENVIRONMENT |= {"OMP_NUM_THREADS", "MPLBACKEND", "COTLEARN_PROGRESS"}
_PR_SET_PDEATHSIG, _PR_SET_CHILD_SUBREAPER = 1, 36  # of linux/prctl.h
_CLONE_NEWUSER, _CLONE_NEWPID = 0x10000000, 0x20000000  # of linux/sched.h


def clear_environment() -> None:
    """Removes from the environment what an answer does not need."""
    for name in set(os.environ) - _ENVIRONMENT:
        del os.environ[name]


def work(job: Job, folder: str, limits: Limits, channel: Connection, life: Connection) -> None:
    """Does a job in this process and sends messages [kind, value] as JSON, which cannot run code.

    The messages are ["begun", process id] when the learner's code starts, ["found", value] for each
    finding of `run`, to which the parent replies with the next hidden test, and ["end", problem].
    """
    with contextlib.suppress(AttributeError, OSError):
        os.setsid()  # so that all it starts can be ended together
    if sys.platform == "linux":
        _fork(folder, limits, channel, life)
    else:
        threading.Thread(target=_outlive_nobody, args=(life,), daemon=True).start()
    try:
        _prepare(folder)
    except FileNotFoundError:  # a neighbour deleted it; the parent tries again
        os._exit(1)
    namespace: dict[str, Any] = {"__name__": "__main__"}
    with contextlib.suppress(Exception):
        exec(compile(job.setup, "<setup>", "exec"), namespace)
    if sys.platform != "win32":
        _limit(limits)  # from here on it is the learner's code that runs
    # in a namespace of its own the process does not know its number outside, but /proc does
    known = sys.platform == "linux"
    _send(channel, "begun", int(os.readlink("/proc/self")) if known else os.getpid())
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
    """Ends this process as soon as its parent is gone."""
    with contextlib.suppress(EOFError, OSError):
        life.recv_bytes()
    os._exit(1)


def _fork(folder: str, limits: Limits, channel: Connection, life: Connection) -> None:
    """Returns in a new process; this one waits for its end, or that of the parent, and cleans up.

    Where the system allows it, the answer is the first process of a namespace: it can end no
    process but its own, and they all end with it. Elsewhere, processes that the answer started come
    to this one when they lose their parents, even if they are in sessions of their own.
    """
    system = ctypes.CDLL(None)
    system.prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
    if system.unshare(_CLONE_NEWPID):  # not as root
        system.unshare(_CLONE_NEWUSER | _CLONE_NEWPID)
    answer = os.fork()
    if answer == 0:
        _close_all_but(channel.fileno())
        os.setsid()
        system.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
        return
    channel.close()
    status, used = 0, 0.0
    end = os.pidfd_open(answer)
    if life not in multiprocessing.connection.wait([life, end]):
        _, status, usage = os.wait4(answer, 0)
        used = usage.ru_utime + usage.ru_stime
    else:
        remove(folder)  # the parent may be gone
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
    os._exit(1)


def remove(folder: str) -> None:
    """Deletes a folder, but not thousands of folders inside each other."""
    with contextlib.suppress(RecursionError):
        shutil.rmtree(folder, ignore_errors=True)


def _close_all_but(kept: int) -> None:
    """Closes all files but one: what is written into the others would end the server."""
    os.closerange(3, kept)
    os.closerange(kept + 1, os.sysconf("SC_OPEN_MAX"))
    tracker: Any = multiprocessing.resource_tracker._resource_tracker
    tracker._fd = tracker._pid = None  # the answer starts its own, if it needs one


def _children() -> list[int]:
    """The process ids of this process's children."""
    found = []
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            words = path.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
            if int(words[1]) == os.getpid():
                found.append(int(path.parent.name))
    return found


def _send(channel: Connection, kind: str, value: object = None) -> None:
    channel.send_bytes(json.dumps([kind, value]).encode())


def _find(job: Job, namespace: dict[str, Any], channel: Connection) -> None:
    """Runs the cells, the check, and each hidden test that the parent sends; sends the findings.

    The process receives no test before the cells have run.
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
    """Runs cells in IPython, with magics; only an error in the answer's own cell counts."""
    from IPython.core.interactiveshell import InteractiveShell
    from traitlets.config import Config

    class Shell(InteractiveShell):
        def enable_gui(self, gui: str | None = None) -> None:
            """Does nothing, so that `%matplotlib inline` works."""

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
    """The failure message of a hidden test; "" if it passes."""
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
    """Sets an empty folder, no input, an output that is dropped, and fixed random seeds."""
    import numpy as np
    import torch

    import cotlearn.homework.preload  # noqa: F401

    os.chdir(folder)
    clear_environment()
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
    """Counts the printed characters and drops them."""

    rest = PRINT_LIMIT

    def write(self, text: str) -> int:
        self.rest -= len(text)
        if self.rest < 0:
            self.rest = PRINT_LIMIT  # so that the last words can be said
            words = f"your answer printed more than {PRINT_LIMIT:,} characters; remove the print"
            raise registry.Stopped(words)
        return len(text)


def _limit(limits: Limits) -> None:
    import resource

    used = resource.getrusage(resource.RUSAGE_SELF)
    whole = math.ceil(used.ru_utime + used.ru_stime + limits.seconds)
    # the first process of a namespace does not get SIGXCPU, which comes before the hard limit
    hard = whole if sys.platform == "linux" else whole + 5
    most = {resource.RLIMIT_CPU: (whole, hard), resource.RLIMIT_CORE: (0, 0)}
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
