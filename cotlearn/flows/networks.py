"""Velocity networks."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator

import torch
from torch import Tensor, nn

from cotlearn.validation import check_count


class VelocityMLP(nn.Module):
    """A multilayer perceptron v(t, x, c).

    Args:
        dim: d, columns of x and of the velocity.
        condition_dim: k, columns of c; 0 for no condition (c is then None).
        width: neurons of each hidden layer.
        depth: hidden layers.
        seed: of the initial weights; torch's global randomness if None.
    """

    def __init__(
        self,
        dim: int,
        condition_dim: int = 0,
        *,
        width: int = 128,
        depth: int = 3,
        seed: int | None = None,
    ) -> None:
        super().__init__()
        self.dim = check_count(dim, "dim")
        self.condition_dim = check_count(condition_dim, "condition_dim", minimum=0)
        check_count(width, "width")
        sizes = [1 + dim + condition_dim] + [width] * check_count(depth, "depth")
        with _seeded(seed):
            hidden = [
                layer
                for before, after in itertools.pairwise(sizes)
                for layer in (nn.Linear(before, after), nn.SiLU())
            ]
            self.layers = nn.Sequential(*hidden, nn.Linear(width, dim))

    def forward(self, t: Tensor | float, x: Tensor, c: Tensor | None = None) -> Tensor:
        """The velocity, shape (B, d).

        Args:
            t: a number or shape (B,), in [0, 1].
            x: (B, d).
            c: (B, k), or None if the network has no condition.
        """
        if x.ndim != 2 or x.shape[1] != self.dim:
            raise ValueError(f"x must have shape (rows, {self.dim}), got {tuple(x.shape)}")
        time = torch.as_tensor(t, dtype=x.dtype, device=x.device)
        if time.ndim > 1 or (time.ndim == 1 and len(time) != len(x)):
            raise ValueError(
                f"t must be a number or have shape ({len(x)},), got {tuple(time.shape)}"
            )
        inputs = [time.expand(len(x))[:, None], x]
        if self.condition_dim:
            inputs.append(self._check_condition(c, x))
        elif c is not None:
            raise ValueError("this network has condition_dim=0, but got c; pass c=None")
        return self.layers(torch.cat(inputs, dim=1))

    def _check_condition(self, c: Tensor | None, x: Tensor) -> Tensor:
        if c is None:
            raise ValueError(f"this network needs c of shape (rows, {self.condition_dim})")
        if c.shape != (len(x), self.condition_dim):
            raise ValueError(
                f"c must have shape ({len(x)}, {self.condition_dim}), got {tuple(c.shape)}"
            )
        return c.to(x.dtype)


@contextlib.contextmanager
def _seeded(seed: int | None) -> Iterator[None]:
    """Draw from a seed of one's own, and leave the global randomness as it was."""
    if seed is None:
        yield
        return
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield
