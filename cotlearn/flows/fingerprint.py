"""What a training trains on, in few digits: a checkpoint must not go on with something else."""

from types import CodeType
from typing import Any

import torch
from torch import nn

from cotlearn.couplings.base import Sampler, Source
from cotlearn.flows.matching import Loss
from cotlearn.storage import digest
from cotlearn.validation import check_function

DIGITS, ROWS = 16, 64


def fingerprint(
    network: nn.Module, data: Sampler, source: Source | None, loss: Loss
) -> dict[str, str]:
    """Digests of the initial weights, the data, the source of noise and the loss, by name.

    Data without rows `x1` and a source are known by the rows that they draw from a fixed seed.
    """
    rows = getattr(data, "x1", None), getattr(data, "c", None)
    if rows[0] is None:
        rows = data.sample(ROWS, generator=torch.Generator().manual_seed(0))
    noise = None
    if source is not None:
        check_function(source, "source", "(n, generator) -> x0")
        noise = source(ROWS, generator=torch.Generator().manual_seed(0))
    found = {
        "initial weights": digest(network.state_dict(), {})[:DIGITS],
        "rows of data": _digest(*rows),
        "source": "standard normal" if noise is None else _digest(noise),
    }
    if code := _code(loss):
        found["code of loss"] = digest({}, {"code": code})[:DIGITS]
    return found


def _digest(*tensors: Any) -> str:
    named = {str(i): value for i, value in enumerate(tensors) if value is not None}
    return digest(named, {})[:DIGITS]


def _code(loss: Any) -> list[Any]:
    """The instructions of a function, with the constants that it holds; of an object nothing."""
    function = getattr(loss, "__func__", loss)
    code = getattr(function, "__code__", None)
    if code is None:
        return []
    held = [cell.cell_contents for cell in function.__closure__ or ()]
    return [*_instructions(code), *map(_plain, [*(function.__defaults__ or ()), *held])]


def _instructions(code: CodeType) -> list[Any]:
    constants = [_instructions(k) if isinstance(k, CodeType) else repr(k) for k in code.co_consts]
    return [code.co_code.hex(), list(code.co_names), constants]


def _plain(value: Any) -> str:
    """A value that cannot change, as it prints; of others the kind."""
    return repr(value) if isinstance(value, int | float | str | None) else type(value).__qualname__
