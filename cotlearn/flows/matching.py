"""Conditional flow matching: the straight path, its velocity, and the loss."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, TypeAlias

import torch
from torch import Tensor

from cotlearn.couplings.base import Pairs, lent
from cotlearn.validation import (
    check_choice,
    check_function,
    check_generator,
    check_has,
    check_number,
    check_shape,
    check_share,
)

Time: TypeAlias = Tensor | float  #: the time of all rows, or of each, (B,)
#: A velocity field: (t, x, c) -> (B, d), with t a number or of shape (B,).
Velocity: TypeAlias = Callable[[Tensor, Tensor, Tensor | None], Tensor]
#: A loss: (network, pairs, generator) -> one value per row of the pairs, shape (B,).
Loss: TypeAlias = Callable[[Any, Pairs, torch.Generator], Tensor]
PREDICTIONS = ("velocity", "data")  #: what the network of a flow can be trained to predict
SOFTENING = 0.01  #: added to the squared error in adaptive weights, see `MeanFlow`


def interpolate(x0: Tensor, x1: Tensor, t: Tensor) -> Tensor:
    """The straight path x_t = (1 - t) x0 + t x1, (B, d), for t of shape (B,).

    Raises:
        TypeError: x0 and x1 have different types.
        ValueError: they have different shapes, or t has another one.
    """
    check_same_type(x1, x0)
    t = check_shape(t, "t", x0.shape[:1])[:, None]
    return (1 - t) * x0 + t * x1


def check_same_type(x1: Any, x0: Tensor) -> None:
    """Raise an error unless x1 has the shape and the type of x0; a coupling keeps both types."""
    if check_shape(x1, "x1", x0.shape).dtype != x0.dtype:
        raise TypeError(f"x1 must have x0's type {x0.dtype}, got {x1.dtype}: pass x1.to(x0.dtype)")


def flow_matching_step(
    network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
) -> Tensor:
    """The loss of one gradient step on a batch: a number to call `backward` on.

    For training loops other than `fit`; the optimiser's three lines stay with the loop.

    Args:
        network: called as network(t, x, c).
        pairs: a batch of any coupling.
        generator: draws the times on the CPU; torch's global one if None.
    """
    check_function(network, "network", "(t, x, c) -> v")
    check_has(pairs, "pairs", "Pairs, as a coupling returns them", "x0", "x1", "c")
    check_generator(generator)
    return weighted_mean(conditional_flow_matching_loss(network, pairs, generator), pairs)


def conditional_flow_matching_loss(
    network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
) -> Tensor:
    """|v(t, x_t, c) - (x1 - x0)|^2 at one uniform time per row (Lipman 2210.02747, eq. 14).

    Args:
        network: called as network(t, x, c).
        pairs: a batch of any coupling.
        generator: draws t on the CPU.

    Returns:
        (B,), the squared error of each row, summed over dimensions.
    """
    return FlowMatching()(network, pairs, generator)


@dataclass(frozen=True)
class FlowMatching:
    """Conditional flow matching with more rows at t = 0, another target, or adaptive weights.

    A network that predicts the data is trained on |network(t, x_t, c) - x1|^2. It represents the
    velocity field (network - x_t) / (1 - t), whose squared error this loss weighs by (1 - t)^2.

    With a power, a row of squared error e has the weight 1 / (e + 0.01)^power (Geng 2505.13447,
    section 4.3, where it belongs to `MeanFlow`). Rows that are far from their target count less:
    where a velocity has several likely values, the best answer is no longer their mean, but lies
    near one of them.

    Args:
        share_at_t0: share of the rows, in [0, 1], that are trained at t = 0: one-step sampling
            evaluates the network there alone, and a uniform t hardly ever meets it.
        prediction: "velocity" or "data".
        power: 0 for squared errors; with 1 the gradient hardly depends on their size.
    """

    share_at_t0: float = 0.0
    prediction: str = "velocity"
    power: float = 0.0

    def __post_init__(self) -> None:
        check_share(self.share_at_t0, "share_at_t0")
        check_choice(self.prediction, "prediction", PREDICTIONS)
        check_number(self.power, "power")

    def __call__(
        self, network: Velocity, pairs: Pairs, generator: torch.Generator | None = None
    ) -> Tensor:
        """The squared error of each row, with its weight, (B,)."""
        early = None
        if self.share_at_t0:
            drawn = torch.rand(len(pairs), generator=generator)
            early = drawn.to(pairs.x0.device) < self.share_at_t0
        t = uniform_times(pairs, generator)
        if early is not None:
            t = t.masked_fill(early, 0.0)
        predicted = network(t, interpolate(pairs.x0, pairs.x1, t), pairs.c)
        target = pairs.x1 if self.prediction == "data" else pairs.x1 - pairs.x0
        return squared_error(predicted, target, self.power)


def velocity_of(network: Velocity, prediction: str = "velocity") -> Velocity:
    """The velocity field that a network represents, for t below 1.

    Args:
        network: trained with `FlowMatching` of the same prediction.
        prediction: "velocity" returns the network itself; "data" (network - x) / (1 - t), also of
            a network of mean velocities and its jump's length.
    """
    if check_choice(prediction, "prediction", PREDICTIONS) == "velocity":
        return check_function(network, "network", "(t, x, c) -> v")
    return lambda t, x, c, *length: (
        (network(t, x, c, *length) - x) / (1 - torch.as_tensor(t).reshape(-1, 1))
    )


def evaluate(velocity: Any, t: Time, x: Tensor, *inputs: Any, name: str = "velocity") -> Tensor:
    """velocity(t, x, *inputs), of x's shape (B, d) and, under autocast too, of its type.

    It gets copies of x and of the inputs, which it may overwrite; so may its next call what it
    returned.
    """
    found = check_shape(velocity(t, *lent(x, *inputs)), name, x.shape, "return")
    return found.to(x.dtype, copy=True)


def uniform_times(pairs: Pairs, generator: torch.Generator | None) -> Tensor:
    """One time for each row, (B,), drawn on the CPU."""
    return torch.rand(len(pairs), generator=generator, dtype=pairs.x0.dtype).to(pairs.x0.device)


def squared_error(predicted: Tensor, target: Tensor, power: float = 0.0) -> Tensor:
    """e = |predicted - target|^2 of each row, (B,), with the fixed weight 1 / (e + 0.01)^power."""
    check_shape(predicted, "network", target.shape, "return")
    errors = (predicted - target).square().sum(dim=1)
    return errors / (errors.detach() + SOFTENING) ** power if power else errors


def weighted_mean(losses: Tensor, pairs: Pairs) -> Tensor:
    """The mean of the rows' losses, with the weights that the pairs carry."""
    check_shape(losses, "loss", (len(pairs),), "return one value per row,")
    if pairs.weight is None:
        return losses.mean()
    check_shape(pairs.weight, "weight of the pairs", (len(pairs),))
    return (pairs.weight * losses).mean()
