"""Every door that takes arrays, given arrays that are wrong.

It must either work, or raise ValueError or TypeError with the name of an argument; never another
error, never a silent NaN, and never may it change what it was given.
"""

import copy
import dataclasses
import re
import warnings
from typing import Any

import numpy as np
import pytest
import torch

from array_cases import CASES


def with_value(value: float) -> Any:
    """Puts a number at the first place of an array of floating-point numbers."""

    def change(array: Any) -> Any:
        array = array.copy()
        if array.dtype.kind == "f" and array.size:
            array.flat[0] = value
        return array

    return change


SPOIL = {
    "nan": with_value(np.nan),
    "infinite": with_value(np.inf),
    "shorter": lambda a: a[1:] if a.ndim else a,
    "narrower": lambda a: a[..., 1:] if a.ndim else a,
    "deeper": lambda a: a[None],
    "empty": lambda a: a[:0] if a.ndim else a[None][:0],
    "integers": lambda a: a.astype(np.int64),
    "complex": lambda a: a.astype(np.complex64),
}
#: What an array is called where a function hands it on to another, which looks at it.
HANDED_ON = ("x", "c", "x0", "state")


def spoil(value: Any, kind: str) -> Any:
    """A wrong array instead of a right one; "other": an array for a tensor and a tensor for one."""
    tensor = isinstance(value, torch.Tensor)
    array = value.detach().numpy() if tensor else value
    if kind == "other":
        return np.array(array) if tensor else torch.from_numpy(np.array(array))
    changed = SPOIL[kind](array)
    return torch.as_tensor(changed) if tensor else changed


def numbers(value: Any) -> list[Any]:
    """All numbers in a result, as arrays."""
    if isinstance(value, torch.Tensor):
        return [value.detach().resolve_conj().numpy()]
    if isinstance(value, float | np.ndarray | np.generic):
        return [np.asarray(value)]
    if dataclasses.is_dataclass(value):
        return numbers([getattr(value, field.name) for field in dataclasses.fields(value)])
    if isinstance(value, dict):
        return numbers(list(value.values()))
    if isinstance(value, list | tuple):
        return [array for item in value for array in numbers(item)]
    return []


def has_nan(value: Any) -> bool:
    return any(a.dtype.kind == "f" and np.isnan(a).any() for a in numbers(value))


def same(a: Any, b: Any) -> bool:
    first, second = np.asarray(a), np.asarray(b)
    return first.dtype == second.dtype and np.array_equal(first, second, equal_nan=True)


def call(case: Any, arrays: dict[str, Any]) -> Any:
    """The result, its randomness fixed, without warnings."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return case.call(**arrays)


@pytest.mark.slow
@pytest.mark.usefixtures("two_candidates")
@pytest.mark.parametrize(
    ("name", "argument"), [(name, key) for name, case in CASES.items() for key in case.arrays]
)
def test_a_spoilt_array_works_or_is_refused_by_name(name, argument):
    for kind in (*SPOIL, "other"):
        look(CASES[name], argument, kind)


def look(case: Any, argument: str, kind: str) -> None:
    """One spoilt call."""
    arrays = {**case.arrays, argument: spoil(case.arrays[argument], kind)}
    before = copy.deepcopy(arrays)
    what = f"{argument}, {kind}"
    try:
        result = call(case, arrays)
    except (ValueError, TypeError) as refused:
        named = "|".join(map(re.escape, (*case.arrays, *HANDED_ON)))
        assert re.search(rf"\b({named})\b", str(refused)), f"{what}: no name in {refused!r}"  # noqa: PT017
    else:
        if argument not in case.bare:
            assert not has_nan(result), f"{what}: a silent NaN"
            assert kind != "complex", f"{what}: something is lost"
    for key, value in before.items():
        assert same(value, arrays[key]), f"{what}: {key} was changed"
