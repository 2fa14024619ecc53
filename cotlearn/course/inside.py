"""What is done in the kernel of a hand-in: its limits, and the checks of its answers."""

import ast
import importlib
import inspect
import math
import os
import random
import re
import sys
import traceback
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from IPython import get_ipython
from IPython.display import display

from cotlearn import course
from cotlearn.course import checking

_CELL_MAGICS = re.compile(r"\A(\s*%%.*\n)+")  #: such as %%time, above the code


def begin(exercise: str, gigabytes: float | None) -> None:
    """Prepares the kernel, before the cells of the hand-in run.

    Args:
        exercise: One of those that will be checked, to load its check.
        gigabytes: Memory that the hand-in may take, beyond what Python and torch take; None for
            no limit.
    """
    checking.find(exercise)
    if "cotlearn.metrics" in sys.modules:
        importlib.import_module("ot")  # which it imports late, in the time of an answer
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


def load(source: str) -> None:
    """Imports what a cell imports, and binds no name; what fails here fails again in the cell."""
    for statement in _imports(source):
        module = ast.Module([statement], type_ignores=[])
        try:
            exec(compile(module, "<import>", "exec"), {})
        except (Exception, SystemExit):
            importlib.invalidate_caches()  # the cell may write the module first


def _imports(source: str) -> Iterator[ast.stmt]:
    """The imports in a cell, whose magics are left out."""
    try:
        tree = ast.parse(get_ipython().transform_cell(_CELL_MAGICS.sub("", source)))
    except (SyntaxError, ValueError, RecursionError):
        return
    yield from (node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom))


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
        hint: The message if an assertion fails that has none of its own.
    """
    try:
        _run(source)
    except (Exception, SystemExit) as error:
        _show(_complaint(error, hint))
    else:
        _show("")


def _complaint(error: BaseException, hint: str) -> str:
    """What a hidden test says of an error; its hint is about its assertions only."""
    if _is_from_answer(error):
        return f"your answer {checking.said(error)}"
    if isinstance(error, AssertionError):
        return str(error) or hint or "a hidden test failed"
    return f"what your answer returned does not fit: the hidden test {checking.said(error)}"


def _is_from_answer(error: BaseException) -> bool:
    """Whether an error passed through code of the hand-in."""
    frames = (frame for frame, _ in traceback.walk_tb(error.__traceback__))
    return any(frame.f_globals is get_ipython().user_ns for frame in frames)


def _run(source: str) -> None:
    scope: dict[str, Any] = {}
    exec(compile(source, "<hidden test>", "exec", optimize=0), scope)  # asserts are the test
    function = next(value for value in reversed(scope.values()) if inspect.isfunction(value))
    names, space = inspect.signature(function).parameters, get_ipython().user_ns
    function(**{name: space if name == "env" else space.get(name) for name in names})


def _show(*found: str | None) -> None:
    texts = [text if text is None else checking.printable(text) for text in found]
    display({checking.MIME: texts}, raw=True)
