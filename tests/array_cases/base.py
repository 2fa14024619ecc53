"""What a case is, and arrays that many of them share."""

from collections.abc import Callable
from typing import Any, NamedTuple

import torch

from cotlearn import flows, mixtures

N, D, K = 6, 2, 3


class Case(NamedTuple):
    """A call and its array arguments.

    Attributes:
        call: takes the arrays by name.
        arrays: all right.
        bare: arguments that are not looked at: they stand in the innermost loop, where what calls
            the function has looked already. Of them only this is asked: no other error.
    """

    call: Callable[..., Any]
    arrays: dict[str, Any]
    bare: frozenset[str] = frozenset()


CASES: dict[str, Case] = {}


def add(name: str, call: Callable[..., Any], bare: tuple[str, ...] = (), **arrays: Any) -> None:
    """Note a case by its name in the reference; there may be several, told apart by a comma."""
    assert name not in CASES
    CASES[name] = Case(call, arrays, frozenset(bare))


def g(seed: int = 0) -> torch.Generator:
    """A generator."""
    return torch.Generator().manual_seed(seed)


def rows(n: int = N, d: int = D, seed: int = 0) -> torch.Tensor:
    """Normal rows."""
    return torch.randn(n, d, generator=g(seed))


def labels(n: int = N, k: int = K) -> torch.Tensor:
    """One-hot rows, every class among them."""
    return torch.eye(k)[torch.arange(n) % k]


X0, X1, C = rows(), rows(seed=1) + 1, labels()
PAIRS = {"x0": X0, "x1": X1, "c": C}
NETWORK = flows.VelocityMLP(D, K, width=8, depth=1, seed=0)
PETALS = mixtures.petals(K)
