"""Finds the check of an exercise and runs it on an answer.

`judge` returns the verdict and a sentence about it, `check` prints them in a notebook, and
`require` raises an AssertionError with the sentence in a hidden test.
"""

import enum
import functools
import importlib
import itertools
import math
import pkgutil
import random
import re
import signal
import sys
import textwrap
import threading
from collections.abc import Callable
from types import FrameType
from typing import Any

from cotlearn.course import assets, checks, record

#: Seconds that a learner's answer may take before the check stops it; inf: no limit.
TIME_LIMIT = 20.0
WAITS = (1.0, 1.0)  #: seconds until an answer that swallowed the exception meets it again
SOON = (2e-6, 6e-5)  #: seconds between later ones, at random: the range of their aim
#: The kind of output that carries a verdict from a kernel to whoever grades.
MIME = "application/vnd.cotlearn+json"
#: The exit code of a kernel in which a cell asked for more memory than there is.
OUT_OF_MEMORY = 77
TOO_LONG = "ran for longer than"  #: how the sentence on an endless loop begins

_NAME = re.compile(r"(\d\d|hw\d)\.[a-z0-9_]+")
_Check = Callable[..., None]
_registry: dict[str, _Check] = {}
_correct: set[str] = set()  # in this process
_NO_CODE = (lambda: None).__code__  #: as short as that of a function whose body is only `...`


class _Silent:
    """Displays nothing when it is the last value of a cell."""

    def _ipython_display_(self) -> None:
        pass


class Verdict(_Silent, enum.StrEnum):
    """The verdict of a check; it displays nothing in a notebook, because `check` has printed it."""

    NOT_ATTEMPTED = "not attempted yet"
    NOT_YET = "not yet"
    CORRECT = "correct"


class NotYet(Exception):
    """Raised by a check; the message is a hint for the learner."""


class Stopped(BaseException):
    """Stops an answer with a reason; a BaseException, so that no `except Exception` catches it."""


def exercise(name: str) -> Callable[[_Check], _Check]:
    """Registers the check of an exercise.

    Args:
        name: "NN.short_name", where NN is the number of the notebook, or "hwN.short_name".

    Returns:
        A decorator for a function that takes the answer, raises `NotYet("a hint")` if it is wrong
        and returns if it is correct. If it has a second argument, `seed=0`, a hidden test can
        repeat the check with other random numbers.

    Raises:
        ValueError: If the name has another form or is already registered.

    Example:
        >>> @exercise("00.two")
        ... def _(answer):
        ...     if answer != 2:
        ...         raise NotYet(f"expected 2, got {answer}")
    """
    if not _NAME.fullmatch(name):
        raise ValueError(f'name must look like "01.interpolate", got {name!r}')

    def register(function: _Check) -> _Check:
        if name in _registry:
            raise ValueError(f"name {name!r} is already the name of an exercise")
        _registry[name] = function
        return function

    return register


def exercises() -> list[str]:
    """Returns the names of all exercises."""
    for module in _modules():
        importlib.import_module(f"{checks.__name__}.{module}")
    return sorted(_registry)


def _modules() -> set[str]:
    return {module.name for module in pkgutil.iter_modules([str(checks.folder())])}


def check(answer: object, name: str) -> Verdict:
    """Checks an answer and prints what it found.

    A wrong answer never raises. An exception in the learner's function is reported as a sentence,
    and so is a function that runs too long (not on Windows: interrupt the kernel there). In a
    notebook, the verdict is stored for `cotlearn progress` in a file on this machine.

    Args:
        answer: The learner's function or value. `None`, `...`, and a function without code, or that
            raises NotImplementedError or returns `...`, count as not attempted.
        name: The exercise, as "01.interpolate".

    Returns:
        The verdict.

    Raises:
        TypeError: If `name` is not a string; usually the two arguments were swapped.
        ValueError: If there is no exercise of that name.
    """
    verdict, sentence = judge(answer, name)
    _correct.discard(name)
    if verdict is Verdict.CORRECT:
        _correct.add(name)
        print("✓ correct")
    else:
        not_yet = verdict is Verdict.NOT_YET
        print(wrapped(f"✗ not yet: {sentence}") if not_yet else f"not attempted yet: {name}")
    if record.in_notebook():
        record.remember({name: verdict})
    return verdict


def passed(*names: str) -> bool:
    """Tells whether `check` has found these answers correct since the kernel started.

    Use it in cells that need the answers: it prints the exercises that are still missing.

    Args:
        *names: Names of exercises, such as "hw1.euler".
    """
    missing = [name for name in names if name not in _correct]
    if missing:
        print(f"first, to be checked above: {', '.join(missing)}")
    return not missing


def require(answer: object, name: str, *, seed: int | None = None) -> None:
    """Raises AssertionError unless an answer is correct; for hidden tests.

    Args:
        answer: As for `check`.
        name: As for `check`.
        seed: Seed of the check's random numbers; the default seed of the check if None.

    Raises:
        AssertionError: The answer is wrong; the message is a hint.
    """
    verdict, sentence = judge(answer, name, seed=seed)
    if verdict is not Verdict.CORRECT:
        raise AssertionError(sentence)


def judge(answer: object, name: str, *, seed: int | None = None) -> tuple[Verdict, str]:
    """Returns the verdict on an answer and a sentence about it.

    Args:
        answer: As for `check`.
        name: As for `check`.
        seed: As for `require`.

    Raises:
        TypeError: As for `check`.
        ValueError: As for `check`.
    """
    function = find(name)
    options = {} if seed is None else {"seed": seed}
    try:
        if _is_stub(answer):
            raise NotImplementedError
        watch = callable(answer) and hasattr(answer, "__name__") and not isinstance(answer, type)
        given = _watched(answer) if watch else answer
        run_within(TIME_LIMIT, function, given, **options)
    except NotImplementedError:
        return Verdict.NOT_ATTEMPTED, "not attempted yet"
    except (NotYet, Stopped) as reason:
        return Verdict.NOT_YET, str(reason)
    except Exception as error:
        return Verdict.NOT_YET, f"the check of your answer {said(error)}"
    return Verdict.CORRECT, "correct"


def find(name: str) -> _Check:
    """Returns the check of an exercise; imports only the file that it is in.

    Raises:
        TypeError: As for `check`.
        ValueError: As for `check`.
    """
    if not isinstance(name, str):
        raise TypeError(f'name must be a string such as "01.interpolate", got {name!r}')
    where = name.partition(".")[0]
    module = f"nb{where}" if where.isdigit() else where
    if name not in _registry and module in _modules():
        importlib.import_module(f"{checks.__name__}.{module}")
    if name not in _registry:
        raise ValueError(assets.not_found("exercise", name, exercises()))
    return _registry[name]


def _is_stub(answer: object) -> bool:
    if isinstance(answer, tuple | list) and answer:
        return all(_is_stub(item) for item in answer)
    return answer is None or answer is ...


def _watched(function: Any) -> Callable[..., Any]:
    """Wraps a learner's function, to tell unchanged stubs from errors in the function."""
    code = getattr(function, "__code__", _NO_CODE).co_code

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        try:
            result = function(*args, **kwargs)
        except (NotYet, NotImplementedError):
            raise
        except (Exception, SystemExit) as error:
            raise NotYet(f"your function {function.__name__} {said(error)}") from error
        if result is None and len(code) > len(_NO_CODE.co_code):
            raise NotYet(f"your function {function.__name__} returned None; is a return missing?")
        if _is_stub(result):
            raise NotImplementedError
        return result

    return call


def too_long(seconds: float) -> str:
    """Describes an answer that ran too long."""
    words = f"{TOO_LONG} {seconds:g} seconds and was stopped"
    return f"{words}; is there a loop that never ends?"


def said(error: BaseException) -> str:
    """Describes an exception in a learner's code: "raised ValueError: ...", or plainer words."""
    text = " ".join(str(error).split()) or "(no message)"
    if isinstance(error, MemoryError) or "allocate memory" in text or "not enough memory" in text:
        return "asked for more memory than it may have; look at the shapes that meet in it"
    if isinstance(error, RecursionError):
        return "called itself without end (RecursionError)"
    if isinstance(error, SystemExit | GeneratorExit):
        return "ended Python (exit or quit); use return to leave a function"
    if isinstance(error, KeyboardInterrupt):
        return "was interrupted"
    if isinstance(error, EOFError):
        return "waited for input, and nobody is there to type"
    if "must match the size of tensor" in text:
        text += ". Beside (n, d) a tensor of shape (n,), such as times t, is written t[:, None]"
    return f"raised {type(error).__name__}: {text[:300]}"


def wrapped(text: str) -> str:
    """Returns a text in lines of at most 80 characters; JupyterLab breaks longer ones in words."""
    return textwrap.fill(text, 80, break_long_words=False, break_on_hyphens=False)


def printable(text: str, most: int = 500) -> str:
    r"""Returns a text that is safe to print and to store, with at most `most` characters.

    Control characters, escape sequences and lone surrogates are escaped as in Python, `\x1b`.
    """
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text[:most])
    return "".join(shown) + ("…" if len(text) > most else "")


def run_within(seconds: float, function: Callable[..., None], *args: Any, **options: Any) -> None:
    """Calls a function, and raises `Stopped` in it after some seconds.

    That needs the main thread and a system with alarms (not Windows). A function can swallow the
    exception, by a bare `except` in a loop. Then it is raised again after a second, and again; in
    the end so often that it meets the few instructions between two `try` statements.
    """
    able = hasattr(signal, "setitimer") and threading.current_thread() is threading.main_thread()
    if math.isinf(seconds) or not able:
        function(*args, **options)
        return
    here, draw = sys._getframe(), random.Random(0)
    soon = (draw.uniform(*SOON) for _ in itertools.count())
    waits = itertools.chain(WAITS, soon)

    def stop(number: int, frame: FrameType | None) -> None:
        if frame is here:  # the function has ended
            return
        signal.setitimer(signal.ITIMER_REAL, next(waits))
        raise Stopped(f"your answer {too_long(seconds)}")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        function(*args, **options)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
