"""What is done in the kernel of a hand-in: its limits, and the checks of its answers."""

import inspect
import math
import os
import random
import sys
from typing import Any

import numpy as np
import torch
from IPython import get_ipython
from IPython.display import display

from cotlearn import course
from cotlearn.course import checking


def begin(exercise: str, gigabytes: float | None) -> None:
    """Prepares the kernel, before the cells of the hand-in run.

    Args:
        exercise: One of those that will be checked, to load its check.
        gigabytes: Memory that the hand-in may take, beyond what Python and torch take; None for
            no limit.
    """
    checking.find(exercise)
    checking.TIME_LIMIT = math.inf  # the kernel has its own
    course.check = lambda answer, name: checking.Verdict.NOT_ATTEMPTED  # the cells' own checks
    course.passed = lambda *names: False  # and nobody waits for their trainings
    get_ipython().ask_exit = _leave
    get_ipython().set_custom_exc((MemoryError,), _out_of_memory)
    sys.stdout = sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    random.seed(0)
    np.random.seed(0)  # noqa: NPY002, the learner may use it
    torch.manual_seed(0)
    if gigabytes is not None:
        _limit_memory(gigabytes)
    _show()


def _leave() -> None:
    """What `exit` and `quit` do: they end their cell, and not the kernel."""
    raise SystemExit


def _out_of_memory(*error: object, **options: object) -> None:
    """Ends the kernel: what the cell still holds would be missing to all others."""
    os._exit(checking.OUT_OF_MEMORY)


def _limit_memory(gigabytes: float) -> None:
    import resource

    with open("/proc/self/statm", encoding="ascii") as file:
        pages = int(file.read().split()[0])
    space = pages * resource.getpagesize() + int(gigabytes * 1e9)
    resource.setrlimit(resource.RLIMIT_AS, (space, space))


def check(name: str, expression: str) -> None:
    """Shows the verdict on an answer and a sentence; no verdict if there is no answer.

    Args:
        name: The question.
        expression: The answer in the hand-in, such as "euler".
    """
    try:
        answer = eval(expression, get_ipython().user_ns)
    except NameError:
        _show(None, "")
    except Exception as error:
        _show(checking.Verdict.NOT_YET, f"{expression} {checking.said(error)}")
    else:
        _show(*checking.judge(answer, name))


def test(source: str, hint: str) -> None:
    """Shows what a hidden test says; "" if it passes.

    Args:
        source: Of one function; its arguments are names in the hand-in.
        hint: The message if an assertion fails.
    """
    try:
        _run(source)
    except AssertionError as error:
        _show(hint or str(error) or "a hidden test failed")
    except (Exception, SystemExit) as error:
        _show(f"your answer {checking.said(error)}" + (f" ({hint})" if hint else ""))
    else:
        _show("")


def _run(source: str) -> None:
    scope: dict[str, Any] = {}
    exec(compile(source, "<hidden test>", "exec", optimize=0), scope)  # asserts are the test
    function = next(value for value in reversed(scope.values()) if inspect.isfunction(value))
    names, space = inspect.signature(function).parameters, get_ipython().user_ns
    function(**{name: space if name == "env" else space.get(name) for name in names})


def _show(*found: str | None) -> None:
    texts = [text if text is None else checking.printable(text) for text in found]
    display({checking.MIME: texts}, raw=True)
