"""What a training trains on, in few digits: a checkpoint must not go on with something else."""

import functools
import inspect
from typing import Any

import torch
from torch import nn

from cotlearn.couplings.base import Sampler, Source, draw_rows
from cotlearn.datasets import Dataset
from cotlearn.storage import digest
from cotlearn.validation import check_function

DIGITS, ROWS = 16, 64
COMPILED = "_orig_mod."  #: what `torch.compile` adds to the names of a state


def fingerprint(network: nn.Module, data: Sampler, source: Source | None) -> dict[str, str]:
    """Digests of the initial weights, the data and the source of noise, by name.

    A source, and data that draw in a way of their own, are known by what they draw from a fixed
    seed.
    """
    rows: tuple[Any, ...] = getattr(data, "x1", None), getattr(data, "c", None)
    drawn: tuple[Any, ...] = ()
    if rows[0] is None or getattr(type(data), "sample", None) is not Dataset.sample:
        drawn = draw_rows(data, ROWS, torch.Generator().manual_seed(0))
    rows = drawn if rows[0] is None else (*rows, *drawn)
    noise = None
    if source is not None:
        check_function(source, "source", "(n, generator) -> x0")
        noise = source(ROWS, generator=torch.Generator().manual_seed(0))
    return {
        "initial weights": digest(plain_state(network), {})[:DIGITS],
        "rows of data": _digest(*rows),
        "source": "standard normal" if noise is None else _digest(noise),
    }


def plain_state(network: nn.Module) -> dict[str, torch.Tensor]:
    """The state of a network under the names that it has without `torch.compile`."""
    return {name.replace(COMPILED, ""): value for name, value in network.state_dict().items()}


def described(part: Any) -> str:
    """A function by its qualified name and settings, an object by its repr.

    Settings are the defaults of a function and what it holds of the function around it. What it
    computes, and what is in the tensors that it holds, is for `contents`.
    """
    if isinstance(part, functools.partial):
        settings = [*map(_plain, part.args), *_named(part.keywords)]
        return f"{described(part.func)}({', '.join(settings)})"
    name = getattr(part, "__qualname__", None)
    if name is None:
        return _printed(part)
    owner, function = getattr(part, "__self__", None), getattr(part, "__func__", part)
    if inspect.isfunction(function) and (settings := _settings(function)):
        name = f"{name}({', '.join(settings)})"
    return str(name) if owner is None else f"{_printed(owner)}: {name}"


def _settings(function: Any) -> list[str]:
    given = inspect.signature(function).parameters.values()
    defaults = {p.name: p.default for p in given if not (p.default is p.empty or p.default is None)}
    return _named({**defaults, **inspect.getclosurevars(function).nonlocals})


def _named(settings: dict[str, Any]) -> list[str]:
    return [f"{name}={_plain(value)}" for name, value in settings.items()]


def _plain(value: Any) -> str:
    """A value that cannot change, as it prints; of others the kind."""
    return repr(value) if isinstance(value, int | float | str | None) else type(value).__qualname__


def _printed(value: Any) -> str:
    """An object's repr, or its class where the repr is an address that changes with the process."""
    kind: Any = type(value)
    return str(kind.__qualname__) if kind.__repr__ is object.__repr__ else repr(value)


def _digest(*tensors: Any) -> str:
    named = {str(i): value for i, value in enumerate(tensors) if value is not None}
    return digest(named, {})[:DIGITS]
