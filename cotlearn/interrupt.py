"""Ctrl-C while a command loads, and between two steps: never lost, and files stay whole."""

import contextlib
import os
import signal
import sys
import threading
from _thread import interrupt_main
from collections.abc import Iterator
from typing import Any


def end_at_once() -> None:
    """From now on, Ctrl-C ends the process with one line and the exit code 130.

    This is for a command that loads: an exception in an import can be lost, or come out as another
    one with a traceback. Nothing is under way yet that would have to be put in order.
    """
    main = threading.current_thread() is threading.main_thread()
    if main and signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, _end)


def raise_again() -> None:
    """From now on, Ctrl-C raises KeyboardInterrupt, if `end_at_once` was called before."""
    if signal.getsignal(signal.SIGINT) is _end:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@contextlib.contextmanager
def loading() -> Iterator[None]:
    """Let Ctrl-C end the process at once in a block of imports; see `end_at_once`.

    They take seconds: a terminal says so until they are done.
    """
    end_at_once()
    shown = "loading" if sys.stderr.isatty() else ""
    print(shown, end="\r" * bool(shown), file=sys.stderr, flush=True)
    try:
        yield
    finally:
        print(" " * len(shown), end="\r" * bool(shown), file=sys.stderr, flush=True)
        raise_again()


@contextlib.contextmanager
def not_lost() -> Iterator[None]:
    """Repeat a Ctrl-C in the block that fell into a destructor or a callback.

    Python prints an exception there, a lock's or the physics' for instance, and goes on.
    """
    before = sys.unraisablehook

    def again(lost: Any) -> None:
        if not issubclass(lost.exc_type, KeyboardInterrupt):
            return before(lost)
        timer = threading.Timer(0.01, _interrupt)  # at once, it would fall into this function
        timer.daemon = True
        timer.start()

    sys.unraisablehook = again
    try:
        yield
    finally:
        sys.unraisablehook = before


def _interrupt() -> None:
    if sys.platform == "win32":
        interrupt_main()
    else:  # which ends a sleep, too
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)


def _end(signum: int, frame: Any) -> None:
    os.write(2, b"stopped\n")
    os._exit(130)


@contextlib.contextmanager
def interrupt_between_steps() -> Iterator[threading.Event]:
    """Turn Ctrl-C into an event, so that a step is completed; a second Ctrl-C interrupts it.

    An exception can be lost: Python prints those of callbacks and destructors, of the physics for
    instance, and goes on. The event cannot, and at its end the block raises KeyboardInterrupt.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event  # only the main thread receives signals
        return

    def note(signum: int, frame: Any) -> None:
        if event.is_set():
            raise KeyboardInterrupt
        event.set()

    before = signal.signal(signal.SIGINT, note)
    try:
        yield event
    finally:
        signal.signal(signal.SIGINT, before)
    if event.is_set():
        raise KeyboardInterrupt
