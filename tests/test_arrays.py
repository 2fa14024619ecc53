"""Every public function that takes arrays, given arrays that are wrong or unusual.

It must either work, or raise ValueError or TypeError with the name of an argument; never another
error, never a silent NaN, and never may it change what it was given.
"""

import copy
import dataclasses
import fnmatch
import re
import warnings
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import torch
from array_cases import CASES, WITHOUT, public, that_take_arrays


def broken(array: Any, place: int, value: float) -> Any:
    """An array with another number at a place."""
    if array.dtype.kind == "f" and array.size:
        array = array.copy()
        array.flat[place % array.size] = value
    return array


#: Of an array and an axis.
PLACED = {
    "shorter": lambda a, axis: np.delete(a, 0, axis=axis) if a.ndim else a,
    "longer": lambda a, axis: np.concatenate([a, a], axis=axis) if a.ndim else a[None],
    "empty": lambda a, axis: a.take([], axis=axis) if a.ndim else a[None][:0],
    "one": lambda a, axis: a.take([0], axis=axis) if a.ndim else a,
    "deeper": np.expand_dims,
    "strided": lambda a, axis: np.repeat(a, 2, axis)[np.s_[:,] * axis + np.s_[::2,]],
}
TYPES = {"double": "f8", "half": "f2", "integers": "i8", "bools": bool, "complex": np.complex64}
ANYWHERE = {
    "flat": lambda a: a.reshape(-1),
    "number": lambda a: a.reshape(-1)[0],
    "turned": np.asfortranarray,
    # these stay as they are; -9999 behind a mask must not enter a mean
    "masked": lambda a: np.ma.masked_array(a, np.arange(a.size).reshape(a.shape) == 0),
    "dates": lambda a: a.astype(np.int64).astype("datetime64[ns]"),
    "gradient": lambda a: torch.tensor(a, dtype=torch.float32, requires_grad=True),
}


def spoil(value: Any, kind: str, place: int) -> Any:
    """A wrong or unusual array instead of a right one; `place` is where, if somewhere."""
    tensor = isinstance(value, torch.Tensor)
    array = value.detach().numpy() if tensor else value
    if kind == "other":  # an array where a tensor is expected, a tensor where an array
        return np.array(array) if tensor else torch.from_numpy(np.array(array))
    if kind in ("nan", "infinite"):
        array = broken(array, place, np.nan if kind == "nan" else (-1) ** place * np.inf)
    elif kind in PLACED:
        array = PLACED[kind](array, place % max(array.ndim, 1))
    else:
        array = array.astype(TYPES[kind]) if kind in TYPES else ANYWHERE[kind](array)
    return torch.as_tensor(array) if tensor and kind not in ("masked", "dates") else array


LOSSY = ("complex", "masked", "dates")  # NumPy takes them for real numbers, some with a warning
#: What an array is called where a function hands it on to another, which looks at it.
HANDED_ON = ("x", "c", "x0", "state")
SAME = {"strided", "turned"}  # other memory, the same numbers


def numbers(value: Any) -> list[Any]:
    """All numbers in a result, as arrays."""
    if isinstance(value, torch.Tensor):
        return [value.detach().resolve_conj().numpy()]
    if isinstance(value, float | np.ndarray | np.generic):
        return [np.asarray(value)]
    if dataclasses.is_dataclass(value):
        fields = [f.name for f in dataclasses.fields(value) if f.name != "seconds"]
        return numbers([getattr(value, name) for name in fields])
    if isinstance(value, dict):
        return numbers(list(value.values()))
    if isinstance(value, list | tuple):
        return [array for item in value for array in numbers(item)]
    return []


def has_nan(value: Any) -> bool:
    return any(a.dtype.kind == "f" and np.isnan(a).any() for a in numbers(value))


def same_bits(a: Any, b: Any) -> bool:
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and torch.equal(torch.nan_to_num(a), torch.nan_to_num(b))
    if isinstance(a, np.ndarray) and a.dtype.kind in "fc":
        return a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)
    return np.array_equal(a, b) if isinstance(a, np.ndarray) else a == b


def call(case: Any, arrays: dict[str, Any]) -> Any:
    """The result, its randomness fixed, without warnings."""
    torch.manual_seed(0)
    np.random.seed(0)  # noqa: NPY002
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return case.call(**arrays)


@pytest.mark.usefixtures("two_candidates")
@pytest.mark.parametrize(
    ("name", "argument"), [(name, key) for name, case in CASES.items() for key in case.arrays]
)
def test_a_spoilt_array_works_or_is_refused_by_name(name, argument):
    case = CASES[name]
    right = cache(lambda: numbers(call(case, case.arrays)))
    for kind in (*ANYWHERE, *TYPES, "other"):
        look(case, argument, kind, 0, right)
    for kind in ("nan", "infinite", *PLACED):
        for place in (0, 5):  # first and last axis
            look(case, argument, kind, place, right)


def test_every_function_of_the_reference_that_takes_arrays_has_a_case():
    tried = {name.partition(",")[0] for name in CASES}
    listed = that_take_arrays()
    excused = {name for name in listed for p in WITHOUT if fnmatch.fnmatch(name, p)}
    assert sorted(listed - tried - excused) == [], "without a case and without a reason"
    assert sorted(tried & excused) == [], "with a case and with a reason to have none"
    assert sorted(tried - set(public())) == [], "not in the reference"
    unused = {p for p in WITHOUT if not fnmatch.filter(listed, p)}
    assert not unused, "reasons for nothing"


def look(case: Any, argument: str, kind: str, place: int, right: Callable[[], Any]) -> None:
    """One spoilt call."""
    spoilt = spoil(case.arrays[argument], kind, place)
    arrays = {**case.arrays, argument: spoilt}
    before = copy.deepcopy(arrays)
    refused = result = None
    try:
        result = call(case, arrays)
    except (ValueError, TypeError) as error:
        refused = error
    what = f"{argument}, {kind} at {place}"
    if refused is not None:
        named = "|".join(map(re.escape, (*case.arrays, *HANDED_ON)))
        assert re.search(rf"\b({named})\b", str(refused)), f"{what}: no name in {refused!r}"
        assert kind not in SAME, f"{what}: the same numbers are refused: {refused}"
    elif argument not in case.bare:
        assert not has_nan(result), f"{what}: a silent NaN"
        assert kind not in LOSSY, f"{what}: something is lost"
    if kind in SAME:
        for a, b in zip(numbers(result), right(), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-4, atol=1e-5)
    for key, value in before.items():
        assert same_bits(value, arrays[key]), f"{what}: {key} was changed"
