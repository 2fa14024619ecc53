"""Runs one question in a process of its own, with limits on time, memory and output.

This keeps accidents apart: an endless loop, an `exit()`, a flood of prints or an array that fills
the memory costs one question and nothing else. It is no security sandbox: code that means harm has
all rights of the user who runs it (see docs/teaching/grading.md).
"""

from __future__ import annotations

import contextlib
import functools
import json
import multiprocessing
import multiprocessing.connection
import os
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from multiprocessing.context import BaseContext
from pathlib import Path
from typing import Any

from cotlearn.homework import registry, worker

START = 300.0  #: seconds that a process may take to begin, on a very busy machine
_MESSAGE_BYTES = 1_000_000


@dataclass(frozen=True)
class Limits:
    """What a question may use.

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
class Outcome:
    """What came out of a process.

    Attributes:
        messages: that it sent before it ended.
        problem: why it did not come to its end, in a sentence; None if it did.
    """

    messages: tuple[dict[str, Any], ...]
    problem: str | None


def has_memory_limit() -> bool:
    """Tells whether this system can limit the memory of a process; of ours, only Linux can."""
    return sys.platform == "linux"


def run(job: worker.Job, limits: Limits) -> Outcome:
    """Does a job in its own process and in an empty folder.

    Args:
        job: A question and the cells that it needs.
        limits: Of time and memory.

    Raises:
        RuntimeError: The process did not even begin, which is not the answer's fault.
    """
    context = _context()
    ours, theirs = context.Pipe(duplex=False)
    with tempfile.TemporaryDirectory(prefix="cotlearn-", ignore_cleanup_errors=True) as folder:
        process = context.Process(  # type: ignore[attr-defined]
            target=worker.run, args=(job, folder, limits.seconds, limits.gigabytes, theirs)
        )
        process.start()
        theirs.close()
        try:
            messages, problem = _listen(ours, process, limits)
        finally:
            _end(process)
            ours.close()
    return Outcome(tuple(messages), problem)


def _listen(
    channel: multiprocessing.connection.Connection, process: Any, limits: Limits
) -> tuple[list[dict[str, Any]], str | None]:
    messages: list[dict[str, Any]] = []
    begun = False
    deadline = time.monotonic() + START
    while True:
        rest = deadline - time.monotonic()
        ready = multiprocessing.connection.wait([channel, process.sentinel], max(rest, 0))
        if channel in ready:
            try:
                message = json.loads(channel.recv_bytes(_MESSAGE_BYTES))
            except (EOFError, OSError, ValueError):
                return messages, _why(process, limits, begun=begun)
            if message.get("end"):
                return messages, message.get("problem")
            if message.get("begun"):  # loading is not the learner's time
                begun = True
                deadline = time.monotonic() + 3 * limits.seconds
            else:
                messages.append(message)
        elif ready:  # it is gone, and left nothing in the channel
            return messages, _why(process, limits, begun=begun)
        elif rest <= 0:
            if not begun:
                raise RuntimeError("the process for an answer took too long to start")
            if not _waits_for_a_core(process.pid):
                return messages, registry.too_long(limits.seconds)
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
    context.set_forkserver_preload([worker.__name__, "cotlearn.homework.preload"])
    return context
