"""Checks of the arguments of public functions, one for each kind of argument.

Each error message names the argument, the value that came and the value that was expected.
"""

import functools
import itertools
import math
import reprlib
from collections.abc import Iterator, Sequence
from numbers import Integral
from types import EllipsisType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

Shape = tuple[int | EllipsisType | None, ...]
#: Floating-point types that torch computes with.
FLOATS = {torch.float16, torch.bfloat16, torch.float32, torch.float64}
LARGEST_SEED = 2**63 - 1  #: that a torch.Generator takes
SMALLEST_SQUARED, LARGEST_SQUARED = 1e-140, 1e145  #: of numbers whose squares are summed
#: What couplings say of images.
IMAGES = "; images[pairs.target_index] are the images of the pairs"
LONGEST = 120  #: characters of a value in an error message


class _Short(reprlib.Repr):
    """Values on one line: of tensors and arrays only kind and shape, of long ones both ends."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = LONGEST

    def repr_instance(self, x: Any, level: int) -> str:
        """A value that is no container, string or integer; numbers without axes are written out."""
        shape = getattr(x, "shape", None)
        if isinstance(shape, tuple) and shape:
            return f"{type(x).__name__} of shape {tuple(shape)}"
        return " ".join(super().repr_instance(x, level).split())


short = _Short().repr  #: a value as error messages have it


def counted(count: int, noun: str) -> str:
    """The number with its noun, as "1 row" and "2 rows"."""
    return f"{count} {noun}{'s' * (count != 1)}"


def check_matrix(value: Any, name: str, *, columns: int | None = None, hint: str = "") -> Tensor:
    """Return `value` if it is a finite, non-empty floating-point tensor of shape (n, columns).

    Args:
        value: the argument.
        name: its name.
        columns: expected columns; any number if None.
        hint: what else the error says if there are more than two axes.

    Raises:
        TypeError: `value` is not a floating-point tensor.
        ValueError: `value` has another shape, no rows, or values that are not finite.
    """
    if not isinstance(value, Tensor):
        raise TypeError(f"{name} must be a torch tensor, got {type(value).__name__}")
    if not value.is_floating_point():
        raise TypeError(f"{name} must be a floating-point tensor, got {value.dtype}")
    _check_plain(value, name)
    if value.ndim != 2:
        flat = f"; pass {name}.flatten(1){hint}" if value.ndim > 2 else ""
        raise ValueError(f"{name} must have shape (rows, columns), got {tuple(value.shape)}{flat}")
    if not value.numel() and columns != 0:
        raise ValueError(f"{name} is empty: it has shape {tuple(value.shape)}")
    if columns is not None and value.shape[1] != columns:
        raise ValueError(f"{name} has {value.shape[1]} columns, expected {columns}")
    if not math.isfinite(value.detach().sum()):  # quick; large finite numbers can overflow, too
        bad = (~torch.isfinite(value)).any(dim=1).nonzero()[:, 0]
        if len(bad):
            where = f"{len(bad)} of {len(value)} rows, the first is row {int(bad[0])}"
            raise ValueError(f"{name} has NaN or infinite values in {where}")
    return value


def check_shape(value: Any, name: str, shape: tuple[int, ...], verb: str = "have") -> Tensor:
    """Return `value` if it is a floating-point tensor of this shape; its numbers are not checked.

    For the result of a user's function, `name` is the function and `verb` is "return".
    """
    if not isinstance(value, Tensor) or not value.is_floating_point():
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name} must {verb} a floating-point tensor, got {got}")
    _check_plain(value, name)
    if value.shape != shape:  # broadcasting would hide it
        raise ValueError(f"{name} must {verb} shape {tuple(shape)}, got {tuple(value.shape)}")
    return value


def _check_plain(value: Tensor, name: str) -> None:
    """Raise TypeError unless a tensor of numbers is dense, holds them, and can be computed with."""
    if value.layout != torch.strided:
        got = f"{value.layout}: pass {name}.to_dense()"
        raise TypeError(f"{name} must be a dense tensor, got {got}")
    if value.is_meta:
        raise TypeError(f"{name} must hold numbers, got a tensor on the device 'meta'")
    if value.is_floating_point() and value.dtype not in FLOATS:
        raise TypeError(f"{name} must have 16, 32 or 64 bits a number, got {value.dtype}")


def check_index(value: Any, name: str, rows: int) -> Tensor:
    """Return `value` if it is a tensor of integers of shape (rows,)."""
    whole = isinstance(value, Tensor) and not (value.is_floating_point() or value.is_complex())
    if not whole or value.dtype == torch.bool:
        got = value.dtype if isinstance(value, Tensor) else type(value).__name__
        raise TypeError(f"{name} must be a tensor of integers, got {got}")
    if value.shape != (rows,):
        raise ValueError(f"{name} must have shape ({rows},), got {tuple(value.shape)}")
    return value


def check_condition(value: Any, name: str = "c", *, columns: int | None = None) -> Tensor:
    """Return a condition as a floating-point tensor of shape (n, columns).

    Integer and bool tensors of shape (n, k) are converted to floats. A vector of n labels is
    refused, because the distance between labels 1 and 7 means nothing: make it one-hot.

    Raises:
        TypeError: `value` is not a tensor of real numbers.
        ValueError: `value` has another shape, no rows, or values that are not finite.
    """
    if isinstance(value, Tensor) and not value.is_floating_point() and not value.is_complex():
        value = _as_floats(value, name)
    if isinstance(value, Tensor) and value.ndim == 1:
        hint = "for class labels use torch.nn.functional.one_hot, for one number per row c[:, None]"
        got = tuple(value.shape)
        raise ValueError(f"{name} must have shape (rows, columns), got {got}; {hint}")
    return check_matrix(value, name, columns=columns)


def _as_floats(value: Tensor, name: str) -> Tensor:
    """Integers or bools as floats, if none of them merge."""
    _check_plain(value, name)
    floats = value.to(torch.get_default_dtype())
    if not torch.equal(floats.to(value.dtype), value):  # as integers: float64 rounds them, too
        largest = int(value.abs().max())
        or_double = f", or pass {name}.double()" if largest <= 2**53 else ""
        raise ValueError(
            f"{name} has integers up to {largest}, of which {floats.dtype} would merge some: "
            f"subtract a constant{or_double}"
        )
    return floats


def check_single(value: NDArray[Any], name: str) -> Tensor:
    """Return real numbers (n, k) as a float32 tensor, unless that rounds away what a column says.

    Raises:
        ValueError: the rounding error of a column exceeds a thousandth of its deviation, or half of
            its distinct values would merge.
    """
    deviation, noise = _deviation(value)
    largest = np.abs(value.astype(np.float64)).max(axis=0)
    single = np.finfo(np.float32)
    error = np.maximum(single.eps * largest, single.smallest_subnormal)
    lost = (deviation > noise) & (error > 1e-3 * deviation) & np.isfinite(deviation)
    lost |= _half_would_merge(value)
    if lost.any():
        column = int(np.flatnonzero(lost)[0])
        raise ValueError(
            f"{name} has values up to {largest[column]:.6g} in column {column}, so near each other "
            f"(deviation {deviation[column]:.3g}) that float32 would merge them; subtract the "
            "column's mean and divide by its deviation"
        )
    with np.errstate(over="ignore"):  # what is too large becomes infinite, and is refused
        return torch.from_numpy(value.astype(np.float32))


def _deviation(value: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The standard deviation of each column (n, k), and up to where it is rounding, each (k,)."""
    least = value.min(axis=0)
    if value.dtype.kind in "iu":  # before floats merge them; exact, as it wraps around
        above = (value.astype(np.uint64) - least.astype(np.uint64)).astype(np.float64)
        noise = np.zeros(value.shape[1])
    else:
        value = value.astype(np.float64)
        with np.errstate(over="ignore"):
            above = value - least
        noise = 4 * np.finfo(np.float64).eps * np.abs(value).max(axis=0)
    reach = above.max(axis=0)
    with np.errstate(invalid="ignore"):  # of an infinite reach
        return (above / np.where(reach > 0, reach, 1.0)).std(axis=0) * reach, noise


def _half_would_merge(value: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether float32 merges half of about 1,000 neighbouring values of a column (n, k), (k,)."""
    some = np.sort(value[:: max(1, len(value) // 1000)], axis=0)
    rounding = 0.0 if value.dtype.kind in "iub" else 4 * np.finfo(np.float64).eps
    with np.errstate(over="ignore", invalid="ignore"):
        differ = np.diff(some, axis=0) > rounding * np.abs(some[1:].astype(np.float64))
        merge = differ & (np.diff(some.astype(np.float32), axis=0) == 0)
    return merge.sum(axis=0) > differ.sum(axis=0) / 2


def check_same_rows(first: Tensor, first_name: str, second: Tensor, second_name: str) -> None:
    """Raise ValueError unless both tensors have the same number of rows."""
    if not isinstance(second, Tensor) or not second.ndim:  # the first is checked already
        raise TypeError(f"{second_name} must be a torch tensor with rows, got {short(second)}")
    if first.shape[0] != second.shape[0]:  # len() of a tensor takes ten times as long
        rows = f"{first_name} has {counted(len(first), 'row')}, {second_name} has {len(second)}"
        raise ValueError(f"{rows}: they must have the same number")


def check_squares(**values: Tensor) -> None:
    """Raise ValueError if squares of these finite tensors (n, k) overflow, or a column's vanish.

    Only float64 holds such numbers.
    """
    for name, x in values.items():
        if x.dtype != torch.float64:
            continue
        size = x.detach().abs().amax(dim=0).tolist()
        wrong = (s > LARGEST_SQUARED or 0 < s < SMALLEST_SQUARED for s in size)
        column = next((j for j, is_wrong in enumerate(wrong) if is_wrong), None)
        if column is not None:
            raise ValueError(
                f"{' and '.join(values)} must have columns of 0 or of sizes from "
                f"{SMALLEST_SQUARED:g} to {LARGEST_SQUARED:g}, whose squares float64 holds; {name} "
                f"has values up to {size[column]:.3g} in column {column}: divide by their "
                "scale"
            )


def check_inputs(network: Any, x: Any, c: Any, name: str = "x") -> Any:
    """Check the inputs of a network; return c as a floating-point tensor, or None.

    Args:
        network: a network or data. Columns are compared with its `dim` and `condition_dim`, if it
            has them; the dtype of x with its weights', if it is a module.
        x: (B, d), finite.
        c: (B, k), or None.
        name: name of x in error messages.

    Raises:
        TypeError: x or c is not a floating-point tensor, or x has another dtype than the weights.
        ValueError: a shape does not fit, values are not finite, or c is missing or not wanted.
    """
    check_matrix(x, name, columns=getattr(network, "dim", None))
    if isinstance(network, nn.Module):
        weights = next(itertools.chain(network.parameters(), network.buffers()), x)
        if x.dtype != weights.dtype:
            raise TypeError(f"{name} must have the weights' type {weights.dtype}, got {x.dtype}")
    who, wanted = type(network).__name__, getattr(network, "condition_dim", None)
    if c is None:
        if wanted:
            raise ValueError(f"c is missing: {who} needs c of shape (rows, {wanted})")
        return None
    if wanted == 0:
        raise ValueError(f"{who} has condition_dim=0, but got c; pass c=None")
    c = check_condition(c, columns=wanted)
    check_same_rows(c, "c", x, name)
    return c


def check_sampled(network: Any, x: Any, c: Any, name: str = "x0", of: str = "network") -> Any:
    """Check the inputs of a network that makes samples, and that equal calls give equal ones.

    Raises:
        ValueError: also, the network is in train mode and has dropout or normalises by its batch.
    """
    c = check_inputs(network, x, c, name)
    check_draws_nothing(network, of, "equal calls give other samples")
    return c


def check_times(t: Any, x: Tensor) -> Tensor:
    """Return t in [0, 1], a number or of shape (B,), as a tensor (B,) with x's dtype and device."""
    if not isinstance(t, Tensor):
        t = check_real(t, "t")
    elif t.is_complex():
        raise TypeError(f"t must hold real numbers, got {t.dtype}")
    time = torch.as_tensor(t, dtype=x.dtype, device=x.device).detach()
    if time.ndim > 1 or (time.ndim == 1 and len(time) != len(x)):
        raise ValueError(f"t must be a number or have shape ({len(x)},), got {tuple(time.shape)}")
    if not ((time >= 0) & (time <= 1)).all():
        raise ValueError(f"t must lie in [0, 1], got values from {time.min()} to {time.max()}")
    return time.expand(len(x))


def check_real(value: Any, name: str, kinds: str = "fiub") -> NDArray[Any]:
    """Return `value` as a NumPy array if NumPy reads it without a loss.

    Args:
        value: numbers, in any shape and not necessarily finite.
        name: of the argument.
        kinds: letters of the types (`dtype.kind`) that are allowed.

    Raises:
        TypeError: it has another type (complex numbers, Python objects), or needs gradients.
        ValueError: it is a masked array in which something is masked.
    """
    if isinstance(value, Tensor):
        value = check_without_gradient(value, name).cpu().resolve_neg()
        value = value.float() if value.dtype == torch.bfloat16 else value  # NumPy has no such type
    if np.ma.is_masked(value):
        raise ValueError(f"{name} has masked values: drop their rows, or fill them")
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):  # rows of different lengths
        array = np.array(None)
    if array.dtype.kind not in kinds:
        wanted = "integers" if kinds == "iu" else "real numbers"
        wanted += " or strings" if "U" in kinds else ""
        raise TypeError(f"{name} must hold {wanted}, got {_held(value, array)}")
    return array


def _held(value: Any, array: NDArray[Any]) -> str:
    """What a value holds in the place of real numbers, if NumPy reads it as this array."""
    if array.dtype.kind not in "OUS":
        return str(array.dtype)
    if array is not value or not array.ndim:
        return short(value)
    return f"{'objects' if array.dtype.kind == 'O' else 'text'} of shape {array.shape}"


def check_without_gradient(value: Tensor, name: str) -> Tensor:
    """Return `value` unless it is a tensor that requires gradients."""
    if value.requires_grad:
        raise TypeError(f"{name} must be data, got a tensor with gradients: pass {name}.detach()")
    return value


def check_array(value: Any, name: str, shape: Shape) -> NDArray[np.float64]:
    """Return finite real numbers as a float64 array of this shape.

    None allows any size above 0; ... at the beginning allows any axes, which may be empty.
    """
    array = check_real(value, name).astype(np.float64, copy=False)
    more = shape[0] is ...
    tail = shape[1:] if more else shape
    fits = array.ndim >= len(tail) if more else array.ndim == len(tail) and array.size > 0
    sizes = zip(array.shape[array.ndim - len(tail) :], tail, strict=False)
    if not fits or any(wanted not in (None, size) for size, wanted in sizes):
        wanted = str(shape).replace("None", "any").replace("Ellipsis", "...")
        raise ValueError(f"{name} must have shape {wanted}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} has NaN or infinite values")
    return array


def check_count(
    value: Any, name: str, *, minimum: int = 1, most: int | None = None, of: str = "{}"
) -> int:
    """Return `value` if it is an integer from `minimum` to `most`.

    True, 3.0 and tensors are not integers. `of` says what `most` is, as "the {} rows".
    """
    if isinstance(value, bool) or not isinstance(value, Integral):
        raise TypeError(f"{name} must be an integer, got {short(value)}")
    number = int(value)
    if number < minimum:
        raise ValueError(f"{name} must be at least {minimum}, got {number}")
    if most is not None and number > most:
        raise ValueError(f"{name} must be at most {of.format(most)}, got {number}")
    return number


def check_seed(value: Any, name: str = "seed") -> int:
    """Return `value` if it is an integer from 0 to 2^63 - 1, the largest that torch takes."""
    return check_count(value, name, minimum=0, most=LARGEST_SEED)


def check_number(value: Any, name: str, *, minimum: float = 0.0, infinite: bool = False) -> float:
    """Return `value` as a float if it is a number of at least `minimum`; NaN is refused."""
    try:
        scalar = value.item() if hasattr(value, "item") else value  # of numpy or torch
    except (ValueError, RuntimeError):
        scalar = None
    if isinstance(scalar, bool) or not isinstance(scalar, int | float):
        raise TypeError(f"{name} must be a number, got {short(value)}")
    try:
        number = float(scalar)
    except OverflowError:
        raise ValueError(
            f"{name} must be a number that float64 holds, got {short(value)}"
        ) from None
    if math.isnan(number) or number < minimum or (math.isinf(number) and not infinite):
        also = " (infinity is allowed)" if infinite else " and finite"
        raise ValueError(f"{name} must be at least {minimum:g}{also}, got {number}")
    return number


def check_positive(value: Any, name: str) -> float:
    """Return `value` as a float if it is a finite number above 0."""
    if (number := check_number(value, name)) == 0:
        raise ValueError(f"{name} must be above 0, got {value}")
    return number


def check_share(value: Any, name: str) -> float:
    """Return `value` as a float if it is a number in [0, 1]."""
    if (share := check_number(value, name)) > 1:
        raise ValueError(f"{name} must lie in [0, 1], got {share}")
    return share


def check_choice(value: Any, name: str, choices: tuple[str, ...], also: str = "") -> str:
    """Return `value` if it is one of `choices`; `also` says what else the argument may be."""
    if not isinstance(value, str) or value not in choices:
        raise ValueError(f"{name} must be {also}one of {', '.join(choices)}; got {short(value)}")
    return str(value)


def check_function(value: Any, name: str, form: str) -> Any:
    """Return `value` if it can be called; `form` is, for instance, "(x, c) -> x"."""
    if not callable(value):
        raise TypeError(f"{name} must be a function {form}, got {short(value)}")
    return value


def check_has(value: Any, name: str, wanted: str, *attributes: str) -> Any:
    """Return `value` if it is an object, not a class, with these attributes; `wanted` names it."""
    if isinstance(value, type) or not all(hasattr(value, item) for item in attributes):
        raise TypeError(f"{name} must be {wanted}, got {short(value)}")
    return value


def check_draws_nothing(network: Any, name: str, what_happens: str) -> None:
    """Raise ValueError if a network has dropout, or normalises by its batch, and trains.

    So may one in a wrapper of this package, as `Guided`, or whose method this is.
    """
    parts = itertools.chain.from_iterable(part.modules() for part in networks_in(network))
    kinds = nn.modules.dropout._DropoutNd, nn.modules.batchnorm._BatchNorm
    drawing = (part for part in parts if isinstance(part, kinds) and part.training)
    if any(getattr(part, "p", 1.0) > 0 for part in drawing):
        raise ValueError(
            f"{name} must be in eval mode: by dropout or batch normalisation {what_happens}"
        )


def networks_in(function: Any, seen: tuple[Any, ...] = ()) -> Iterator[nn.Module]:
    """The network that a function is, whose method it is, or that it holds if it is of cotlearn."""
    if isinstance(function, nn.Module):
        yield function
        return
    if isinstance(function, type) or any(function is other for other in seen):
        return
    held = [getattr(function, "__self__", None)]
    if isinstance(function, functools.partial):
        held += [function.func, *function.args, *function.keywords.values()]
    elif str(getattr(function, "__module__", "")).startswith("cotlearn."):
        cells = getattr(function, "__closure__", None) or ()
        held += [*getattr(function, "__dict__", {}).values(), *(c.cell_contents for c in cells)]
    for part in held:
        if callable(part):
            yield from networks_in(part, (*seen, function))


def check_seeds(values: Any, name: str = "seeds") -> list[int]:
    """Return seeds as a list if they are a sequence of at least one integer from 0."""
    if not isinstance(values, Sequence | np.ndarray) or isinstance(values, str) or not len(values):
        raise TypeError(f"{name} must be a non-empty sequence of integers, got {short(values)}")
    return [check_seed(seed, f"{name}[{i}]") for i, seed in enumerate(values)]


def check_generator(value: Any, name: str = "generator") -> None:
    """Raise TypeError unless `value` is torch's generator of random numbers, or None.

    Raises:
        RuntimeError: new tensors hold no numbers, see `check_default_device`.
    """
    if value is not None and not isinstance(value, torch.Generator):
        raise TypeError(f"{name} must be a torch.Generator or None, got {short(value)}")
    check_default_device()


def check_default_device() -> None:
    """Raise RuntimeError where new tensors hold no numbers, under `torch.device("meta")`."""
    if torch.empty(0).is_meta:
        raise RuntimeError(
            "torch's default device is 'meta', whose tensors hold no numbers: only build networks "
            "in such a block, and draw and pair outside of it"
        )
