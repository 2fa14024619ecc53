"""Runs one question in a separate process, with limits on time, memory and output.

This isolates accidents: an endless loop, an `exit()`, a flood of prints or an array that fills the
memory affects only its own question. It is not a security sandbox: malicious code has all rights
of the user who runs it (see docs/teaching/grading.md). This module is the parent, which starts the
process and receives its results; `answering.py` runs in the process.
"""

import contextlib
import functools
import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, replace
from multiprocessing import forkserver
from multiprocessing.connection import Connection
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

from cotlearn.homework import answering, registry
from cotlearn.homework.assignments import HiddenTest, Question
from cotlearn.homework.submissions import Cell
from cotlearn.validation import check_positive

START = 300.0  #: seconds that a process may take to begin, on a very busy machine
_MESSAGE_BYTES = 1_000_000
_MESSAGE_SECONDS = 10.0  #: until the rest of a message must have come
_PRELOAD = ["cotlearn.homework.preload"]  #: imported by the server, once for all answers
_SERVER_GONE = 255  #: multiprocessing's exit code of processes whose server has ended
#: Set it to end all `run` of this program within half a second.
stopping = threading.Event()


class Disturbed(RuntimeError):
    """The process of an answer ended for a reason that is not the answer's fault."""


@dataclass(frozen=True)
class Limits:
    """The time and memory limits of a question.

    Attributes:
        seconds: computing time. An answer that sleeps is stopped after three times as long; on
            Linux, one that only waits for a core of a busy machine is not.
        gigabytes: memory, in addition to what Python and torch need; only on systems with
            `has_memory_limit`.
    """

    seconds: float = 60.0
    gigabytes: float = 4.0

    def __post_init__(self) -> None:
        for name in ("seconds", "gigabytes"):
            check_positive(getattr(self, name), name)


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
    """Tells whether this system can limit the memory of a process; only Linux can."""
    return sys.platform == "linux"


def run(job: Job, limits: Limits) -> tuple[list[Any], str | None]:
    """Runs a job in a separate process and an empty folder.

    Args:
        job: A question and the cells that it needs.
        limits: Limits on time and memory.

    Returns:
        The findings: the verdict and sentence of the check, then the failure message of each hidden
        test, "" if it passed. And the reason why the process did not finish, None if it did.

    Raises:
        Disturbed: The process did not begin, or was killed by another program or the system.
        KeyboardInterrupt: `stopping` was set.
    """
    context = _context()
    ours, theirs = context.Pipe()
    watched, life = context.Pipe(duplex=False)  # ends with this program, or when it is closed
    tests = list(job.question.tests)
    bare = replace(job, question=replace(job.question, tests=()))
    folder = tempfile.mkdtemp(prefix="cotlearn-")
    process = context.Process(  # type: ignore[attr-defined]
        target=answering.work, args=(bare, folder, limits, theirs, watched)
    )
    try:
        process.start()
        theirs.close()
        watched.close()
        found = _listen(ours, life, process, limits, tests)
        if not Path(folder).is_dir():
            raise Disturbed("the folder of this answer was deleted, perhaps by another answer")
        return found
    except (OSError, EOFError) as error:  # the server is gone
        raise Disturbed(f"the process for an answer did not start: {error}") from error
    finally:
        life.close()
        _end(process)
        ours.close()
        answering.remove(folder)


def start_server() -> None:
    """Imports everything that answers need, so that `run` starts quickly; Ctrl-C ends it."""
    process = _context().Process(target=int)  # type: ignore[attr-defined]
    process.start()
    process.join()


def _listen(
    channel: Connection, life: Connection, process: Any, limits: Limits, tests: list[HiddenTest]
) -> tuple[list[Any], str | None]:
    found: list[Any] = []
    most = 1 + len(tests)  # findings: of the check, and of each test
    answer = ticks = 0  # its process, once it has begun, and what it has computed
    deadline = time.monotonic() + START
    while True:
        if stopping.is_set():
            raise KeyboardInterrupt
        rest = deadline - time.monotonic()
        wait = min(max(rest, 0), 0.5)
        ready = multiprocessing.connection.wait([channel, process.sentinel], wait)
        if channel in ready:
            try:
                watch = threading.Timer(_MESSAGE_SECONDS, life.close)  # this ends the process
                watch.start()
                try:
                    kind, value = json.loads(channel.recv_bytes(_MESSAGE_BYTES))
                finally:
                    watch.cancel()
                if kind == "end":
                    return found, None if value is None else str(value)
                if kind == "begun" and not answer:  # loading is not the learner's time
                    answer, deadline = int(value), time.monotonic() + 3 * limits.seconds
                    continue
                if kind != "found" or len(found) == most:
                    raise ValueError("no message that is expected here")
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
            before, ticks = ticks, _computed(answer)
            if ticks <= before:
                return found, registry.too_long(limits.seconds)
            deadline += limits.seconds  # its computing time is limited by the system


def _verdict(value: Any) -> list[str]:
    """The verdict of the self-check and its sentence, from a process's message."""
    verdict, sentence = value
    return [str(registry.Verdict(verdict)), str(sentence)]


def _computed(pid: int) -> int:
    """Clock ticks that a process has computed if it waits for a core or a disk now; 0 if not."""
    try:
        stat = Path(f"/proc/{pid}/stat").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return 0
    words = stat.rpartition(")")[2].split()
    return int(words[11]) + int(words[12]) if words[0] in {"R", "D"} else 0


def _why(process: Any, limits: Limits, *, begun: bool) -> str:
    """Explains why a process ended before its last message."""
    process.join(5)
    code = process.exitcode
    if not begun:
        raise Disturbed(f"the process for an answer did not start (exit code {code})")
    if hasattr(signal, "SIGXCPU") and code == -signal.SIGXCPU:
        return registry.too_long(limits.seconds)
    if code in (-signal.SIGTERM, -getattr(signal, "SIGKILL", signal.SIGTERM), _SERVER_GONE):
        raise Disturbed("the process of this answer was killed from outside")
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in set(signal.Signals) else f"signal {-code}"
        memory = "; most often that is memory" if name in {"SIGSEGV", "SIGABRT"} else ""
        return f"your answer made Python crash ({name}{memory})"
    return "your answer ended Python (os._exit, or a crash), so that nothing after it could run"


def _end(process: Any) -> None:
    """Ends a process and everything that it started."""
    if process.pid is None:
        return
    process.join(2)  # it ends by itself, as its life was closed
    if process.is_alive() and hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(process.pid, signal.SIGKILL)
    process.kill()
    process.join()
    process.close()


@functools.cache
def _context() -> BaseContext:
    """On Linux, processes are forked from a server that has imported torch; elsewhere they spawn.

    macOS has fork, too, but its numerical libraries do not survive it.
    """
    if sys.platform != "linux":
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(_PRELOAD)
    before = dict(os.environ)
    answering.clear_environment()  # /proc shows what a process was started with
    try:
        forkserver.ensure_running()
    finally:
        os.environ.update(before)
    return context
