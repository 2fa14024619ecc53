"""A fresh kernel for each hand-in, with a limit for each cell and for memory.

This guards against accidents: an endless loop, an exit or an array that fills the memory. It is no
sandbox: a hand-in has all rights of whoever grades it (see docs/teaching/grading.md).
"""

import contextlib
import math
import os
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from dataclasses import dataclass
from typing import Any, TypeVar

import nbformat
from nbclient import NotebookClient
from nbclient.exceptions import CellTimeoutError, DeadKernelError

from cotlearn.course.checking import MIME, OUT_OF_MEMORY, said, too_long
from cotlearn.course.execution import environment, kernel_manager
from cotlearn.progress import LINE_EVERY
from cotlearn.validation import check_number

START = 300  #: seconds that a kernel and its imports may take, on a very busy machine

#: `cotlearn.course.inside` in the kernel, where it binds no name.
_INSIDE = "__import__('cotlearn.course.inside').course.inside"

_managers: set[Any] = set()  # of the kernels that run
_stopping = threading.Event()

Output = dict[str, Any]
Item = TypeVar("Item")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Limits:
    """The limits of a hand-in.

    Attributes:
        seconds: for each cell, check and hidden test; what a cell imports is loaded before.
        gigabytes: memory beyond what Python and torch take, where `has_memory_limit`.
    """

    seconds: float = 60.0
    gigabytes: float = 4.0

    def __post_init__(self) -> None:
        check_number(self.seconds, "seconds", minimum=0.1)
        check_number(self.gigabytes, "gigabytes", minimum=0.1)


class Ended(Exception):
    """Code ended its kernel, or the kernel had to be ended; the message says what the code did."""


def has_memory_limit() -> bool:
    """Tells whether this system can limit the memory of a process; only Linux can."""
    return sys.platform == "linux"


class Kernel:
    """A kernel that runs; its methods raise `Ended` if the code ends it.

    Args:
        client: The client of the kernel.
        limits: The limits that are set in it.
        exercise: One of those that will be checked; it is loaded before its time counts.
    """

    def __init__(self, client: NotebookClient, limits: Limits, exercise: str) -> None:
        self._client, self._limits = client, limits
        self._manager: Any = client.km
        memory = limits.gigabytes if has_memory_limit() else None
        self._call("begin", exercise, memory, seconds=START)

    def run(self, source: str) -> list[Output]:
        """Runs a cell and returns its outputs, of which one may be an error.

        What it imports is loaded before its time counts: that time is the machine's.
        """
        if "import" in source:
            self._execute(f"{_INSIDE}.load({source!r})", START, history=False)
        return self._execute(source, self._limits.seconds)

    def _execute(self, source: str, seconds: float, *, history: bool = True) -> list[Output]:
        if _stopping.is_set():
            raise KeyboardInterrupt
        cell = nbformat.v4.new_code_cell(source)
        self._client.timeout = math.ceil(seconds)
        try:
            self._client.execute_cell(cell, 0, store_history=history)
        except CellTimeoutError:
            raise Ended(too_long(seconds)) from None
        except DeadKernelError:
            if _stopping.is_set():
                raise KeyboardInterrupt from None
            if self._manager.provisioner.process.returncode == OUT_OF_MEMORY:
                raise Ended(said(MemoryError())) from None
            raise Ended("ended Python (os._exit, or a crash)") from None
        return list(cell.outputs)

    def check(self, name: str, expression: str) -> tuple[str | None, str]:
        """The verdict on an answer, None if it is not there, and a sentence."""
        verdict, sentence = self._call("check", name, expression)
        return verdict, sentence

    def test(self, source: str, hint: str) -> str:
        """What a hidden test says of an answer; "" if it passes."""
        [complaint] = self._call("test", source, hint)
        return str(complaint)

    def _call(self, function: str, *given: object, seconds: float | None = None) -> list[Any]:
        """Calls a function of `cotlearn.course.inside`; returns what it shows."""
        call = f"{_INSIDE}.{function}({', '.join(map(repr, given))})"
        outputs = self._execute(call, seconds or self._limits.seconds)
        for output in reversed(outputs):
            if MIME in output.get("data", {}):
                return list(output["data"][MIME])
            if output["output_type"] == "error":
                raise RuntimeError(f"{function} raised {output['ename']}: {output['evalue']}")
        raise Ended("left the kernel unable to answer")


@contextlib.contextmanager
def started(limits: Limits, exercise: str) -> Iterator[Kernel]:
    """A fresh kernel in an empty folder, which ends with the block; see `Kernel`."""
    blank = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell()])
    manager = kernel_manager()
    client = NotebookClient(
        blank,
        km=manager,
        timeout=START,
        startup_timeout=START,
        allow_errors=True,
        record_timing=False,
        shutdown_kernel="immediate",
    )
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    without_figures = {**environment(), "MPLBACKEND": "agg"}
    _managers.add(manager)
    try:
        with (
            tempfile.TemporaryDirectory(prefix="cotlearn-", ignore_cleanup_errors=True) as folder,
            client.setup_kernel(cleanup_kc=True, cwd=folder, env=without_figures, **quiet),
        ):
            try:
                yield Kernel(client, limits, exercise)
            finally:
                _end(manager)
    finally:
        _managers.discard(manager)


def _end(manager: Any) -> None:
    """Ends a kernel and the processes that it started, but for those in groups of their own."""
    group = getattr(manager.provisioner, "pgid", None)
    if group and hasattr(os, "killpg"):
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(group, signal.SIGKILL)


def in_parallel(
    work: Callable[[Item], Result],
    items: Sequence[Item],
    *,
    workers: int,
    then: Callable[[Result], None],
    meanwhile: Callable[[], None] = lambda: None,
) -> None:
    """Does work that starts kernels, in threads; Ctrl-C ends all kernels at once.

    Args:
        work: What is done for each item.
        items: The items.
        workers: How many at the same time.
        then: Called here with each result as soon as it is known.
        meanwhile: Called here after each minute in which no result came.
    """
    try:
        with ThreadPoolExecutor(workers) as pool:
            futures = [pool.submit(work, item) for item in items]
            try:
                pending = set(futures)
                while pending:
                    done, pending = wait(pending, LINE_EVERY, return_when=FIRST_COMPLETED)
                    for future in done:
                        then(future.result())
                    if not done:
                        meanwhile()
            except BaseException:  # Ctrl-C, too
                _stopping.set()
                pool.shutdown(wait=False, cancel_futures=True)
                begun = [future for future in futures if not future.cancelled()]
                while wait(begun, timeout=0.1).not_done:
                    for manager in list(_managers):  # one may have begun meanwhile
                        _end(manager)
                raise
    finally:
        _stopping.clear()
