"""How a check is written: a table of cases, each with the right result and known mistakes.

    @table("02.halve")
    def halve(g: torch.Generator) -> Cases:
        x = torch.randn(5, generator=g)
        yield Case((x,), x / 2, {"that is twice x, not half of it": 2 * x}, "divide by 2")

`run` puts the table to an answer. A check that fits no table is a function of the answer,
registered with `exercise`.
"""

import copy
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn.homework.registry import NotYet, exercise

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Case:
    """One trial of an answer.

    Attributes:
        given: the arguments of the learner's function, which gets copies; None if the answer is
            a value and not a function.
        right: the result: a number, tensor, array, word or list of words.
        wrong: known mistakes, hint to wrong result (or to a function that recognises the result).
        otherwise: the hint for all other results, or a function of the result that returns it;
            without it the hint says what was expected.
        what: the name of the result, for the hint about its shape.
        also: other results that count as right.
        read: turns what was returned into what is compared, if shape and type of `right` do not
            say it all.
        tolerance: relative and absolute.
        unchanged: whether the answer must leave its arguments as they are.
        nfe: how often the answer must call its first argument, a velocity; None if that is free.
    """

    given: tuple[Any, ...] | None
    right: Any
    wrong: Mapping[str, Any] = field(default_factory=dict)
    otherwise: str | Callable[[Any], str] = ""
    what: str = "the result"
    also: tuple[Any, ...] = ()
    read: Callable[[Any], Any] | None = None
    tolerance: float = 1e-4
    unchanged: bool = False
    nfe: int | None = None


Cases = Iterator[Case]


def table(name: str, *, seed: int = 0) -> Callable[[Callable[..., Cases]], Callable[..., None]]:
    """Registers a generator of cases as the check of an exercise.

    Args:
        name: As for `exercise`.
        seed: Of the `torch.Generator` that the generator of cases is called with, if it takes an
            argument; a hidden test can ask for another.
    """

    def register(cases: Callable[..., Cases]) -> Callable[..., None]:
        draws = bool(inspect.signature(cases).parameters)

        def check(answer: Any, seed: int = seed) -> None:
            run(answer, cases(torch.Generator().manual_seed(seed)) if draws else cases())

        return exercise(name)(check)

    return register


def run(answer: Any, cases: Cases) -> None:
    """Raises `NotYet` with the hint of the first case that an answer gets wrong."""
    for case in cases:
        calls: list[Any] = []
        found = (case.read or functools.partial(_like, case))(_returned(answer, case, calls))
        correct = any(same(found, right, case.tolerance) for right in (case.right, *case.also))
        for hint, wrong in () if correct else case.wrong.items():
            if wrong(found) if callable(wrong) else same(found, wrong, case.tolerance):
                raise NotYet(hint)
        if case.nfe not in (None, len(calls)):
            times = f"{case.nfe} times, not {len(calls)}"
            raise NotYet(f"nfe={case.nfe} must evaluate the velocity {times}")
        if not correct:
            last = case.otherwise(found) if callable(case.otherwise) else case.otherwise
            raise NotYet(last or _expected(case, found))


def _returned(answer: Any, case: Case, calls: list[Any]) -> Any:
    """The result of an answer; `calls` gets the arguments that it gives to a counted velocity."""
    if case.given is None:
        return answer
    given = copy.deepcopy(case.given)

    def counted(*args: Any) -> Any:
        calls.append(args)
        return given[0](*args)

    result = call(answer, *(given if case.nfe is None else (counted, *given[1:])))
    if case.unchanged and not all(map(same, given, case.given)):
        raise NotYet("your function changed its inputs; index them, which makes copies")
    return result


def _expected(case: Case, found: Any) -> str:
    if isinstance(case.right, str):
        return f"expected {case.right!r}, got {found!r}"
    given = case.given or ()
    short = all(np.asarray(item).size <= 12 for item in given)
    where = ", ".join(map(_rounded, given)) if short else "these data"
    return f"for {where} expected {_rounded(case.right)}, got {_rounded(found)}"


def _rounded(value: Any) -> str:
    return str(np.round(np.asarray(value, dtype=np.float64), 4).tolist())


def _like(case: Case, value: Any) -> Any:
    """The value, if it is of the type and shape of the right result."""
    if isinstance(case.right, str):
        return value
    if np.ndim(case.right) == 0:
        return number(value)
    reader = tensor if isinstance(case.right, Tensor) else array
    return reader(value, tuple(case.right.shape), case.what)


def call(answer: Any, *given: Any, **options: Any) -> Any:
    """What a learner's function returns, or `NotYet` if the answer is no function."""
    if not callable(answer):
        raise NotYet(f"expected a function, got {type(answer).__name__}")
    return answer(*given, **options)


def tensor(value: Any, shape: tuple[int, ...], what: str) -> Tensor:
    """Returns the value as float64 if it is a finite tensor of this shape, called `what`."""
    if not isinstance(value, Tensor):
        raise NotYet(f"{what} must be a tensor of shape {shape}, got {type(value).__name__}")
    array(value.detach(), shape, what)
    return value.detach().double()


def array(value: Any, shape: tuple[int, ...], what: str) -> Array:
    """Returns the value as an array if it has this shape and finite numbers."""
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise NotYet(f"{what} must be an array of shape {shape}") from None
    if found.shape != shape:
        hint = f"{what} must have shape {shape}, got {found.shape}"
        if found.shape == shape[::-1]:
            hint += ": rows and columns are swapped"
        elif len(shape) == 1 and found.shape[:1] in ((), shape):
            hint += ": one value for each row; sum over the coordinates, and not over the rows"
        raise NotYet(hint)
    if not np.isfinite(found).all():
        raise NotYet(f"not all values are finite (nan or inf) in {what}")
    return found


def one_of_two(index: int, shape: tuple[int, ...], what: str, hint: str) -> Callable[[Any], Tensor]:
    """Returns a reader of one of the two tensors that an answer returns; `hint` if it does not."""

    def read(value: Any) -> Tensor:
        if not isinstance(value, tuple | list) or len(value) != 2:
            raise NotYet(hint)
        return tensor(value[index], shape, what)

    return read


def permutation(value: Any, n: int, hint: str) -> Tensor:
    """Returns the value as the integers 0 to n - 1 in some order; `hint` if one comes twice."""
    p = np.asarray(value)
    if p.dtype.kind not in "iu" or p.shape != (n,):
        raise NotYet(f"return integers of shape ({n},), got {p.dtype} of shape {p.shape}")
    if sorted(p.tolist()) != list(range(n)):
        raise NotYet(f"{p.tolist()} is not a permutation: {hint}")
    return torch.from_numpy(p.astype(np.int64))


def number(value: Any) -> float:
    """Returns the value as a number."""
    try:
        return float(value)
    except (TypeError, ValueError, RuntimeError):
        got = f"shape {tuple(value.shape)}" if hasattr(value, "shape") else type(value).__name__
        raise NotYet(f"return one number, got {got}") from None


def same(a: Any, b: Any, tolerance: float = 1e-4) -> bool:
    """Whether two results are equal, numbers up to rounding."""
    if isinstance(b, str | list):
        return isinstance(a, type(b)) and a == b
    try:
        left, right = (np.asarray(value, dtype=np.float64) for value in (a, b))
    except (TypeError, ValueError):  # no numbers
        return False
    return left.shape == right.shape and np.allclose(left, right, rtol=tolerance, atol=tolerance)


def cheapest(cost: Tensor) -> Tensor:
    """The permutation with the smallest total cost: the column of each row."""
    return torch.from_numpy(linear_sum_assignment(cost)[1])


def field_at(t: Any, x: Tensor) -> Tensor:
    """A velocity that depends on both; t is a number or one for each row."""
    time = torch.as_tensor(t, dtype=x.dtype)
    return torch.cos(2 * x) + 1.5 * (time[:, None] if time.ndim == 1 else time) * x - 0.3


def squares(off: Tensor, unit: Any = 1.0) -> dict[str, Any]:
    """Mistakes in `unit` times the mean over rows of |off|², with off of shape (n, d)."""
    far = off.norm(dim=1)
    return {
        "take the mean over the rows, not the total": unit * far.square().sum(),
        "take the mean over rows, but the sum over coordinates": unit * off.square().mean(),
        "these are distances: square them before the mean": unit * far.mean(),
        "square each distance first, then take the mean": unit * far.mean() ** 2,
    }


def turned(points: Array, angle: float) -> Array:
    """Points (..., 2) of the plane, turned about the origin by an angle in radians."""
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])
