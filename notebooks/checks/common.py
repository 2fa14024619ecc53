"""Tools for checks. Most checks are a table of cases with the right result and known mistakes.

    @table("02.halve")
    def halve(g: torch.Generator) -> Cases:
        x = torch.randn(5, generator=g)
        yield Case((x,), x / 2, {"that is twice x, not half of it": 2 * x}, "divide by 2")

`run` tries an answer on all cases. A check that does not fit into a table is a plain function of
the answer, registered with `exercise`.
"""

import copy
import functools
import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn.course.checking import NotYet, exercise
from cotlearn.robots.plane import rotate

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Case:
    """One test case for an answer.

    Attributes:
        given: arguments for the learner's function, which receives copies of them; None if the
            answer is a value, not a function.
        right: the correct result: a number, tensor, array, string or list of strings.
        wrong: known mistakes: hint -> the wrong result, or a function that recognises it.
        otherwise: hint for every other wrong result, or a function of the result that returns the
            hint; if empty, the hint says what was expected.
        what: name of the result in hints about its shape.
        also: other results that count as correct.
        read: converts the returned value to the one that is compared; if None, the returned value
            must have the type and shape of `right`.
        tolerance: relative and absolute tolerance.
        nfe: how many times the answer must call its first argument, a velocity; None if any number
            of calls is allowed.
    """

    given: tuple[Any, ...] | None
    right: Any
    wrong: Mapping[str, Any] = field(default_factory=dict)
    otherwise: str | Callable[[Any], str] = ""
    what: str = "the result"
    also: tuple[Any, ...] = ()
    read: Callable[[Any], Any] | None = None
    tolerance: float = 1e-4
    nfe: int | None = None


Cases = Iterator[Case]


def table(name: str, *, seed: int = 0) -> Callable[[Callable[..., Cases]], Callable[..., None]]:
    """Registers a function that yields cases as the check of an exercise.

    Args:
        name: The exercise, as for `exercise`.
        seed: Seed of the `torch.Generator` that is passed to the function, if it takes an argument.
            A hidden test can pass another seed.
    """

    def register(cases: Callable[..., Cases]) -> Callable[..., None]:
        draws = bool(inspect.signature(cases).parameters)

        def check(answer: Any, seed: int = seed) -> None:
            run(answer, cases(torch.Generator().manual_seed(seed)) if draws else cases())

        return exercise(name)(check)

    return register


def run(answer: Any, cases: Cases) -> None:
    """Raises `NotYet` with the hint for the first case that the answer gets wrong.

    An answer that modifies its arguments is wrong, too.
    """
    for number, case in enumerate(cases):
        calls: list[Any] = []
        try:
            returned = _returned(answer, case, calls)
        except NotYet as failed:
            if number and failed.__cause__ and isinstance(case.otherwise, str) and case.otherwise:
                raise NotYet(
                    f"{failed}; {case.otherwise}"
                ) from failed  # the cases before are right
            raise
        found = (case.read or functools.partial(_like, case))(returned)
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
    """Returns the answer's result; `calls` collects its calls of the velocity, if they count."""
    if case.given is None:
        return answer
    given = copy.deepcopy(case.given)

    def counted(*args: Any) -> Any:
        calls.append(args)
        return given[0](*args)

    result = call(answer, *(given if case.nfe is None else (counted, *given[1:])))
    if repr(given) != repr(case.given):
        raise NotYet("your function changed its inputs; work on copies (x = x + y, not x += y)")
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
    """Returns the value if it has the type and shape of the correct result."""
    if isinstance(case.right, str):
        return value
    if np.ndim(case.right) == 0:
        return number(value)
    reader = tensor if isinstance(case.right, Tensor) else array
    return reader(value, tuple(case.right.shape), case.what)


def call(answer: Any, *given: Any, **options: Any) -> Any:
    """Calls a learner's function; raises `NotYet` if the answer is not a function."""
    if not callable(answer):
        raise NotYet(f"expected a function, got {type(answer).__name__}")
    return answer(*given, **options)


def tensor(value: Any, shape: tuple[int, ...], what: str) -> Tensor:
    """Returns the value as float64 if it is a finite tensor of this shape; hints call it `what`."""
    if not isinstance(value, Tensor):
        raise NotYet(f"{what} must be a tensor of shape {shape}, got {type(value).__name__}")
    return torch.from_numpy(array(value.detach(), shape, what))


def array(value: Any, shape: tuple[int, ...], what: str) -> Array:
    """Returns the value as an array if it has this shape and is finite; hints call it `what`."""
    try:
        found = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise NotYet(f"{what} must be an array of shape {shape}") from None
    if found.shape != shape:
        hint = f"{what} must have shape {shape}, got {found.shape}"
        if found.shape == shape[::-1]:
            hint += ": rows and columns are swapped"
        elif found.squeeze().shape == shape:
            hint += ": drop the axis of length 1"
        elif len(shape) == 1 and found.shape[:1] in ((), shape):
            hint += ": one value for each row; sum over the coordinates, and not over the rows"
        raise NotYet(hint)
    if not np.isfinite(found).all():
        raise NotYet(f"not all values are finite (nan or inf) in {what}")
    return found


def one_of_two(index: int, shape: tuple[int, ...], what: str, hint: str) -> Callable[[Any], Tensor]:
    """Returns a `read` for one of two returned tensors; `hint` is for results that are not two."""

    def read(value: Any) -> Tensor:
        if not isinstance(value, tuple | list) or len(value) != 2:
            raise NotYet(hint)
        return tensor(value[index], shape, what)

    return read


def learnable(case: Case, what: str) -> Case:
    """The case, for a loss through which gradients must reach `what`, which is in its function."""

    def read(value: Any) -> Any:
        found = _like(case, value)
        if same(found, case.right, case.tolerance) and not value.requires_grad:
            raise NotYet(f"no gradient reaches {what}: drop no_grad, detach, item or numpy")
        return found

    return replace(case, read=read)


def permutation(value: Any, n: int, hint: str) -> Tensor:
    """Returns the value if it is a permutation of 0 to n - 1; `hint` is for repeated numbers."""
    p = np.asarray(value)
    if p.dtype.kind not in "iu" or p.shape != (n,):
        raise NotYet(f"return integers of shape ({n},), got {p.dtype} of shape {p.shape}")
    if sorted(p.tolist()) != list(range(n)):
        raise NotYet(f"{p.tolist()} is not a permutation: {hint}")
    return torch.from_numpy(p.astype(np.int64))


def number(value: Any) -> float:
    """Returns the value as a number; a text such as "320" is none."""
    try:
        return float(value + 0)
    except (TypeError, ValueError, RuntimeError):
        got = f"shape {tuple(value.shape)}" if hasattr(value, "shape") else type(value).__name__
        raise NotYet(f"return one number, got {got}") from None


def same(a: Any, b: Any, tolerance: float = 1e-4) -> bool:
    """Tells whether two results are equal; numbers are compared up to the tolerance."""
    if isinstance(b, str | list):
        return isinstance(a, type(b)) and a == b
    try:
        left, right = (np.asarray(value, dtype=np.float64) for value in (a, b))
    except (TypeError, ValueError):  # no numbers
        return False
    return left.shape == right.shape and np.allclose(left, right, rtol=tolerance, atol=tolerance)


def cheapest(cost: Tensor) -> Tensor:
    """Returns the permutation of smallest total cost: the column that each row takes."""
    return torch.from_numpy(linear_sum_assignment(cost)[1])


def field_at(t: Any, x: Tensor) -> Tensor:
    """A velocity field that depends on t and x; t is a number or has one value per row."""
    time = torch.as_tensor(t, dtype=x.dtype)
    return torch.cos(2 * x) + 1.5 * (time[:, None] if time.ndim == 1 else time) * x - 0.3


def squares(off: Tensor, unit: Any = 1.0) -> dict[str, Any]:
    """Returns common mistakes in computing unit * mean |off|² over the n rows of off (n, d)."""
    far = off.norm(dim=1)
    return {
        "take the mean over the rows, not the total": unit * far.square().sum(),
        "take the mean over rows, but the sum over coordinates": unit * off.square().mean(),
        "these are distances: square them before the mean": unit * far.mean(),
        "square each distance first, then take the mean": unit * far.mean() ** 2,
    }


def turned(points: Array, angle: float) -> Array:
    """Rotates points (..., 2) in the plane about the origin by an angle in radians."""
    return rotate(points, np.cos(angle), np.sin(angle))
