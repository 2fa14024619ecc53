"""The checks of homework 2: a conditional coupling and its weight."""

from dataclasses import replace
from typing import Any

import torch
from torch import Generator, Tensor

from cotlearn.course.checking import NotYet, exercise
from cotlearn.metrics import squared_w2

from .common import Case, Cases, call, cheapest, same, table, tensor
from .nb03 import costs


@table("hw2.cost")
def cost(g: Generator) -> Cases:
    """The cost |x0 - x1|^2 + weight |c0 - c1|^2 of all pairs, (n, m)."""
    for n, m in ((4, 6), (5, 5)):
        x0, x1 = torch.randn(n, 2, generator=g), torch.randn(m, 2, generator=g)
        c0, c1 = torch.randn(n, 3, generator=g), torch.randn(m, 3, generator=g)
        yield costs((x0, x1, c0, c1, 7.0), torch.cdist(x0, x1), torch.cdist(c0, c1), 7.0)


@exercise("hw2.pair")
def pair(answer: Any, seed: int = 0) -> None:
    """Conditional OT of a batch: rows are permuted, data keep their labels, c0 is shuffled."""
    n, classes = 48, 3
    g = torch.Generator().manual_seed(seed)
    label = torch.randperm(n, generator=g) % classes
    x0, x1 = torch.randn(2, n, 2, generator=g)
    x1, c = x1 + 2.5 * torch.eye(classes, 2)[label] - 1, torch.eye(classes)[label]

    twice, other = _pairs(answer, x0, x1, c, 1e4, 1), _pairs(answer, x0, x1, c, 1e4, 2)
    source, target = rows = _pairs(answer, x0, x1, c, 1e4, 1)
    if not all(map(torch.equal, rows, twice)):
        raise NotYet("equal generators must give equal pairs: randperm(n, generator=generator)")
    if all(torch.equal(part, torch.arange(n)) for part in rows):
        raise NotYet("the rows come back as they went in: index x0, and x1 and c, by the pairs")
    if torch.equal(label[target[source.argsort()]], label):  # each row of x0 got its own class
        raise NotYet("noise in row i always gets c_i: let c0 be a random permutation of c's rows")
    far = torch.cdist(x0.double(), x1.double()).square()
    if torch.equal(target[source.argsort()], cheapest(far)):
        raise NotYet("the weight changes nothing: add weight times the cost of the conditions")
    if all(map(torch.equal, rows, other)):
        raise NotYet("another generator must shuffle the conditions in another way")
    for k in range(classes):
        inside = label[target] == k
        block = far[source[inside]][:, target[inside]]
        if block.trace() > block[range(len(block)), cheapest(block)].sum() + 1e-3:
            hint = "with a large weight the pairs must be the cheapest inside each class"
            raise NotYet(f"{hint}: is the cost that of question 1, and is question 1 right?")
    source, target = _pairs(answer, x0, x1, c, 0.0, 3)
    if far[source, target].sum() > far[range(n), cheapest(far)].sum() + 1e-3:
        raise NotYet("with weight 0 it must be plain OT: the cheapest pairs of x0 and x1")
    if _dependence(answer, g) > 0.15:  # means of 800 normal numbers each
        raise NotYet(
            "with a large weight x0 must not depend on c, and it does: does c0 have each row of c "
            "once? Use randperm"
        )


def _dependence(answer: Any, g: torch.Generator) -> float:
    """How far the mean noise of a class is from 0, over many batches of two far classes."""
    count, rows = 40, 40
    sums, c = torch.zeros(2, 2), torch.eye(2)[torch.arange(rows) % 2]
    for _ in range(count):
        x0, x1 = torch.randn(2, rows, 2, generator=g)
        found = call(answer, x0.clone(), 0.2 * x1 + 4 * (2 * c - 1), c.clone(), 1e6, g)
        sums += torch.as_tensor(found[2]).float().T @ torch.as_tensor(found[0]).float()
    return float(sums.abs().max()) / (count * rows / 2)


def _pairs(
    answer: Any, x0: Tensor, x1: Tensor, c: Tensor, weight: float, seed: int
) -> tuple[Tensor, Tensor]:
    """The indices of the rows of x0 and of x1 that an answer pairs."""
    n = len(x0)
    parts = (x0, x1, c)
    own = (part.clone() for part in parts)
    found = call(answer, *own, weight, torch.Generator().manual_seed(seed))
    if not isinstance(found, tuple | list) or len(found) != 3:
        raise NotYet("return three things: x0, x1 and c, with rows that belong together")
    named = zip(found, parts, ("x0", "x1", "c"), strict=True)
    a, b, k = (tensor(part, tuple(like.shape), name) for part, like, name in named)
    source, target = _rows(a, x0), _rows(b, x1)
    if (source < 0).any() or (target < 0).any():
        raise NotYet("the rows of x0 and x1 must stay as they are; only their order changes")
    if missing := n - min(len(target.unique()), len(source.unique())):
        hint = "a pairing uses each row once; do not draw with replacement"
        raise NotYet(f"{missing} of {n} rows were never used: {hint}")
    if not same(k, c[target]):
        if same(k, c):
            raise NotYet("the labels stayed behind: c must be permuted together with x1")
        raise NotYet("a row of x1 must keep its own condition: index c as you index x1")
    return source, target


def _rows(part: Tensor, whole: Tensor) -> Tensor:
    """The index in `whole` of each row of `part`; -1 if `whole` does not contain it."""
    distance = torch.cdist(part, whole.double())
    return torch.where(distance.min(1).values < 1e-5, distance.argmin(1), -1)


@table("hw2.conditional_w2")
def conditional_w2(g: Generator) -> Cases:
    """The squared W2 within each class, averaged over classes."""
    label = torch.arange(24) % 3
    label[label == 2] = torch.where(torch.arange(8) < 4, 2, 0)  # classes of different sizes
    c = torch.eye(3)[label]
    centres = torch.tensor([[0.0, 0.0], [1.0, 1.0], [-1.0, 2.0]])
    made = torch.randn(24, 2, generator=g) + centres[label.flip(0)]
    real = torch.randn(24, 2, generator=g) + 1.5 * centres[label]
    each = torch.tensor([squared_w2(made[label == k], real[label == k]) for k in range(3)])
    wrong = {
        "the conditions do not count yet: compare inside each class": squared_w2(made, real),
        "average over the classes, do not sum": each.sum(),
        "average over the classes; this is the worst of them": each.max(),
        "squared W2 is asked for: no root before the mean": each.sqrt().mean(),
        "squared W2 is asked for: no root": each.mean().sqrt(),
        "each class counts alike here, however many rows it has": c.mean(0) @ each,
    }
    yield Case((made, real, c), each.mean(), wrong)


@table("hw2.choose_weight")
def choose_weight(g: Generator) -> Cases:
    """The weight of smallest one-step variance among those whose skew is within the budget."""
    for case in range(4):
        weights = [0.0, 0.3, 1.0, 4.0, 10.0, 30.0, 100.0]
        skew = (torch.rand(7, generator=g) * 0.05 + torch.linspace(0.5, 0.02, 7)).tolist()
        variance = (torch.rand(7, generator=g) * 0.05 + torch.linspace(0.1, 1.2, 7)).tolist()
        if case % 2:  # in no order: the weights may come as they like
            order = torch.randperm(7, generator=g).tolist()
            weights, skew, variance = ([v[i] for i in order] for v in (weights, skew, variance))
        variance[weights.index(30.0)] = variance[weights.index(10.0)] - 0.01
        if case == 3:
            skew[weights.index(10.0)] = 0.0
        yield _choice(weights, skew, variance, 0.2 if case < 3 else -1.0)
    on_the_border = (weights, skew, variance, skew[weights.index(4.0)])
    yield replace(_choice(*on_the_border), otherwise="a skew that equals the budget is within it")


def _choice(weights: list[float], skew: list[float], variance: list[float], budget: float) -> Case:
    given, rows = (weights, skew, variance, budget), range(len(weights))
    fits = [i for i in rows if skew[i] <= budget]
    least = min(rows, key=skew.__getitem__)
    if not fits:
        hint = "where no skew fits the budget, take the weight with the smallest skew"
        return Case(given, weights[least], {}, hint, tolerance=0)
    best = min(fits, key=variance.__getitem__)
    cheapest = weights[min(rows, key=variance.__getitem__)]
    smallest, measured = min(weights[i] for i in fits), (variance[best], skew[best])
    wrong = {
        "return the weight itself, not its place in the list": best,
        "the skew of that weight is above the budget": cheapest,
        "the smallest skew costs variance, as large weights do: stay in the budget": weights[least],
        "return the weight, not what was measured for it": measured.__contains__,
        "the smallest weight within the budget need not have the smallest variance": smallest,
    }
    hint = f"of the weights with skew <= {budget:g}, {weights[best]:g} has the smallest variance"
    return Case(given, weights[best], wrong, hint, tolerance=0)
