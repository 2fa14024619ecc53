"""The machinery behind `check`: finds the check of an exercise and runs it on an answer."""

from __future__ import annotations

import difflib
import enum
import functools
import importlib
import pkgutil
import re
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

#: Seconds that a learner's answer may take before the check stops it.
TIME_LIMIT = 20.0

_NAME = re.compile(r"(\d\d)\.[a-z0-9_]+")
_registry: dict[str, Callable[[Any], None]] = {}


class _Silent:
    """Shows nothing as the last value of a cell."""

    def _ipython_display_(self) -> None:
        pass


class Verdict(_Silent, enum.Enum):
    """What a check says about an answer; silent, because `check` has printed it already."""

    NOT_ATTEMPTED = "not attempted yet"
    NOT_YET = "not yet"
    CORRECT = "correct"


class NotYet(Exception):
    """Raised by a check with a sentence that helps the learner on."""


class _NotAttempted(Exception):
    """The answer is still the stub."""


class _OutOfTime(BaseException):
    """The answer ran for too long; no Exception, so that no `except Exception` swallows it."""


def exercise(name: str) -> Callable[[Callable[[Any], None]], Callable[[Any], None]]:
    """Registers the check of an exercise.

    Args:
        name: "NN.short_name", where NN is the number of the notebook.

    Returns:
        A decorator for a function that takes the answer, raises `NotYet("a helpful sentence")` if
        it is wrong, and returns if it is right.

    Raises:
        ValueError: If the name has another form or is taken.

    Example:
        >>> @exercise("00.two")
        ... def _(answer):
        ...     if answer != 2:
        ...         raise NotYet(f"expected 2, got {answer}")
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f'name must look like "01.interpolate", got {name!r}')

    def register(function: Callable[[Any], None]) -> Callable[[Any], None]:
        if name in _registry:
            raise ValueError(f"name {name!r} is already the name of an exercise")
        _registry[name] = function
        return function

    return register


def exercises() -> list[str]:
    """Returns the names of all exercises."""
    package = importlib.import_module("cotlearn.homework.checks")
    for module in pkgutil.iter_modules(package.__path__):
        importlib.import_module(f"{package.__name__}.{module.name}")
    return sorted(_registry)


def check(answer: object, name: str) -> Verdict:
    """Checks an answer and prints what it found.

    A wrong answer never raises. An exception inside the learner's function becomes a sentence,
    and so does a function that does not come to an end (not on Windows: interrupt the kernel).

    Args:
        answer: The learner's function or value. `None`, `...`, and a function that raises
            NotImplementedError or returns `None` or `...` count as not attempted.
        name: The exercise, as "01.interpolate".

    Returns:
        The verdict.

    Raises:
        TypeError: If `name` is not a string; usually the two arguments were swapped.
        ValueError: If there is no exercise of that name.
    """
    if not isinstance(name, str):
        raise TypeError(f'name must be a string such as "01.interpolate", got {name!r}')
    function = _find(name)
    try:
        if _is_stub(answer):
            raise _NotAttempted
        with _time_limit(TIME_LIMIT):
            function(_watched(answer) if _is_function(answer) else answer)
    except (_NotAttempted, NotImplementedError):
        print(f"not attempted yet: {name}")
        return Verdict.NOT_ATTEMPTED
    except NotYet as reason:
        return _wrong(str(reason))
    except _OutOfTime:
        return _wrong(
            f"your answer ran for longer than {TIME_LIMIT:.0f} seconds and was stopped; "
            "is there a loop that never ends?"
        )
    except Exception as error:
        return _wrong(
            f"the check could not use your answer: {type(error).__name__}: {_one_line(error)}"
        )
    print("✓ correct")
    return Verdict.CORRECT


def _wrong(sentence: str) -> Verdict:
    print(f"✗ not yet: {sentence}")
    return Verdict.NOT_YET


def _find(name: str) -> Callable[[Any], None]:
    match = _NAME.fullmatch(name)
    if match and name not in _registry:
        module = f"cotlearn.homework.checks.nb{match[1]}"
        try:
            importlib.import_module(module)
        except ModuleNotFoundError as error:
            if error.name != module:
                raise
    if name in _registry:
        return _registry[name]
    available = exercises()
    near = difflib.get_close_matches(name, available, n=3, cutoff=0.5)
    hint = f"did you mean {' or '.join(near)}?" if near else f"there are: {', '.join(available)}"
    raise ValueError(f"there is no exercise {name!r}; {hint}")


def _is_stub(answer: object) -> bool:
    if isinstance(answer, tuple | list) and answer:
        return all(_is_stub(item) for item in answer)
    return answer is None or answer is ...


def _is_function(answer: object) -> bool:
    """Tells functions from classes, modules and values, which go to the check as they are."""
    return callable(answer) and hasattr(answer, "__name__") and not isinstance(answer, type)


def _watched(function: Any) -> Callable[..., Any]:
    """Wraps a learner's function, so that the stub and its own errors are told apart."""

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            result = function(*args, **kwargs)
        except (NotYet, NotImplementedError):
            raise
        except Exception as error:
            raise NotYet(
                f"your function {function.__name__} raised {type(error).__name__}: "
                f"{_one_line(error)}"
            ) from error
        if _is_stub(result):
            raise _NotAttempted
        return result

    return call


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or "(no message)"


@contextmanager
def _time_limit(seconds: float) -> Iterator[None]:
    """Raises `_OutOfTime` after `seconds`, where the system can (main thread, not Windows)."""
    if not hasattr(signal, "setitimer") or (
        threading.current_thread() is not threading.main_thread()
    ):
        yield
        return

    def stop(number: int, frame: FrameType | None) -> None:
        raise _OutOfTime

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
