"""The checks of homework 2: a conditional coupling and its weight."""

from __future__ import annotations

import math
from typing import Any

import torch
from scipy.optimize import linear_sum_assignment
from torch import Tensor

from cotlearn.homework.checks.common import compare, expect_function, number, same, tensor
from cotlearn.homework.registry import NotYet, exercise


@exercise("hw2.cost")
def cost(answer: Any, seed: int = 0) -> None:
    """|x0 - x1|^2 + weight |c0 - c1|^2 for all pairs."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    for n, m in ((4, 6), (5, 5)):
        x0, x1 = torch.randn(n, 2, generator=g), torch.randn(m, 2, generator=g)
        c0, c1 = torch.randn(n, 3, generator=g), torch.randn(m, 3, generator=g)
        weight = 7.0
        found = answer(x0.clone(), x1.clone(), c0.clone(), c1.clone(), weight)
        if n != m and isinstance(found, Tensor) and tuple(found.shape) == (m, n):
            raise NotYet(f"rows belong to x0 and columns to x1: shape ({n}, {m})")
        got = tensor(found, (n, m), "the costs")
        far, apart = torch.cdist(x0, x1), torch.cdist(c0, c1)
        right = far**2 + weight * apart**2
        mistakes = [
            (far + weight * apart, "square the distances"),
            (far + weight * apart**2, "square the distance of x0 and x1, too"),
            (far**2 + weight * apart, "square the distance of the conditions, too"),
            (
                far**2 + weight**2 * apart**2,
                "the weight stands before the squared distance, it is not squared itself",
            ),
            (far**2, "the conditions do not count yet: add weight times their squared distance"),
            (weight * apart**2, "only the conditions count; add the distance of x0 and x1"),
            (weight * far**2 + apart**2, "the weight belongs to the conditions"),
            (weight * (far**2 + apart**2), "the weight belongs to the conditions alone"),
            (torch.sqrt(right), "no root: the cost is a sum of squares"),
            (right.T, "rows belong to x0, columns to x1"),
        ]
        compare(got, right, mistakes, "entry i, j is |x0_i - x1_j|² + weight |c0_i - c1_j|²")


@exercise("hw2.pair")
def pair(answer: Any, seed: int = 0) -> None:
    """Conditional OT on a batch: a permutation of the rows, labels kept, c0 shuffled."""
    expect_function(answer)
    n, classes = 48, 3
    g = torch.Generator().manual_seed(seed)
    x0, x1 = torch.randn(n, 2, generator=g), torch.randn(n, 2, generator=g)
    label = torch.arange(n) % classes
    x1 = x1 + 2.5 * torch.eye(classes, 2)[label] - 1
    c = torch.eye(classes)[label]
    order = torch.randperm(n, generator=g)
    x1, c, label = x1[order], c[order], label[order]

    made = [_pairs(answer, x0, x1, c, weight, k) for weight, k in ((1e4, 1), (1e4, 1), (1e4, 2))]
    source, target = made[0]
    if not same(source, made[1][0]) or not same(target, made[1][1]):
        raise NotYet(
            "the same generator must give the same pairs: randperm(n, generator=generator)"
        )
    chosen = label[target[source.argsort()]]  # the class that each row of x0 was given
    if torch.equal(chosen, label):
        raise NotYet(
            "noise in row i always gets condition c_i: let c0 be a random permutation of c's rows"
        )
    if same(source, made[2][0]) and same(target, made[2][1]):
        raise NotYet("another generator must shuffle the conditions in another way")
    far = torch.cdist(x0.double(), x1.double()).square()
    for k in range(classes):
        inside = label[target] == k
        found = float(far[source[inside], target[inside]].sum())
        rows, columns = source[inside], target[inside]
        best = far[rows][:, columns]
        if found > float(best[linear_sum_assignment(best)].sum()) + 1e-3:
            raise NotYet(
                "with a large weight the pairs inside each class must be the cheapest; yours are "
                "not: solve the assignment for the cost of question 1"
            )
    source, target = _pairs(answer, x0, x1, c, 0.0, 3)
    cheapest = float(far[linear_sum_assignment(far)].sum())
    if float(far[source, target].sum()) > cheapest + 1e-3:
        raise NotYet("with weight 0 it must be plain OT: the cheapest pairs of x0 and x1")


def _pairs(
    answer: Any, x0: Tensor, x1: Tensor, c: Tensor, weight: float, seed: int
) -> tuple[Tensor, Tensor]:
    """The rows of x0 and of x1 that an answer puts together."""
    n = len(x0)
    g = torch.Generator().manual_seed(seed)
    found = answer(x0.clone(), x1.clone(), c.clone(), weight, g)
    if not isinstance(found, tuple | list) or len(found) != 3:
        raise NotYet("return three things: x0, x1 and c, with rows that belong together")
    parts = zip(found, (x0, x1, c), ("x0", "x1", "c"), strict=True)
    a, b, k = (tensor(part, tuple(like.shape), name) for part, like, name in parts)
    source, target = _rows(a, x0), _rows(b, x1)
    if (source < 0).any() or (target < 0).any():
        raise NotYet("the rows of x0 and x1 must stay as they are; only their order changes")
    if len(target.unique()) < n or len(source.unique()) < n:
        missing = n - min(len(target.unique()), len(source.unique()))
        raise NotYet(
            f"{missing} of {n} rows were never used: a pairing uses each row once; do not draw "
            "with replacement"
        )
    if not same(k, c[target]):
        if same(k, c):
            raise NotYet("the labels stayed behind: c must be permuted together with x1")
        raise NotYet("a row of x1 must keep its own condition: index c as you index x1")
    return source, target


def _rows(part: Tensor, whole: Tensor) -> Tensor:
    """The index in `whole` of each row of `part`, or -1."""
    distance = torch.cdist(part, whole.double())
    return torch.where(distance.min(1).values < 1e-5, distance.argmin(1), -1)


@exercise("hw2.conditional_w2")
def conditional_w2(answer: Any, seed: int = 0) -> None:
    """The mean over classes of the squared W2 inside each class."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    label = torch.arange(24) % 3
    label[label == 2] = torch.where(torch.arange(8) < 4, 2, 0)  # classes of different sizes
    c = torch.eye(3)[label]
    centres = torch.tensor([[0.0, 0.0], [1.0, 1.0], [-1.0, 2.0]])
    made = torch.randn(24, 2, generator=g) + centres[label.flip(0)]
    real = torch.randn(24, 2, generator=g) + 1.5 * centres[label]
    found = number(answer(made.clone(), real.clone(), c.clone()))
    each = [_w2(made[label == k], real[label == k]) for k in range(3)]
    right = sum(each) / 3
    share = [float((label == k).double().mean()) for k in range(3)]
    mistakes = [
        (_w2(made, real), "the conditions do not count yet: compare inside each class"),
        (sum(each), "average over the classes, do not sum"),
        (max(each), "average over the classes; this is the worst of them"),
        (
            sum(math.sqrt(value) for value in each) / 3,
            "squared W2 is asked for: no root before the mean",
        ),
        (math.sqrt(right), "squared W2 is asked for: no root"),
        (
            sum(w * value for w, value in zip(share, each, strict=True)),
            "each class counts alike here, however many rows it has",
        ),
    ]
    compare(found, right, mistakes, f"expected {right:.4f}, got {found:.4f}")


def _w2(a: Tensor, b: Tensor) -> float:
    far = torch.cdist(a.double(), b.double()).square()
    return float(far[linear_sum_assignment(far)].mean())


@exercise("hw2.choose_weight")
def choose_weight(answer: Any, seed: int = 0) -> None:
    """The smallest one-step variance among the weights whose skew fits the budget."""
    expect_function(answer)
    g = torch.Generator().manual_seed(seed)
    for case in range(4):
        weights = [0.0, 0.3, 1.0, 4.0, 10.0, 30.0, 100.0]
        skew = (torch.rand(7, generator=g) * 0.05 + torch.linspace(0.5, 0.02, 7)).tolist()
        variance = (torch.rand(7, generator=g) * 0.05 + torch.linspace(0.1, 1.2, 7)).tolist()
        if case % 2:  # in no order: the weights may come as they like
            order = torch.randperm(7, generator=g).tolist()
            weights, skew, variance = ([v[i] for i in order] for v in (weights, skew, variance))
        variance[weights.index(30.0)] = variance[weights.index(10.0)] - 0.01
        budget = 0.2 if case < 3 else -1.0
        if budget < 0:
            skew[weights.index(10.0)] = 0.0
        found = number(answer(list(weights), list(skew), list(variance), budget))
        rows = range(7)
        fits = [i for i in rows if skew[i] <= budget]
        least = min(rows, key=skew.__getitem__)
        best = min(fits, key=variance.__getitem__) if fits else least
        if found == weights[best]:
            continue
        if not fits:
            raise NotYet("where no skew fits the budget, take the weight with the smallest skew")
        if found == best:
            raise NotYet("return the weight itself, not its place in the list")
        if found == weights[min(rows, key=variance.__getitem__)]:
            raise NotYet("the skew of that weight is above the budget")
        if found == weights[least]:
            raise NotYet("the smallest skew costs variance: any skew within the budget will do")
        if found in (variance[best], skew[best]):
            raise NotYet("return the weight, not what was measured for it")
        if found == min(weights[i] for i in fits):
            raise NotYet(
                "the smallest weight within the budget need not have the smallest variance: compare"
            )
        if found == max(weights):
            raise NotYet("a large weight is nearly independent coupling: its variance is high")
        raise NotYet(
            f"of the weights with skew <= {budget:g} the one with the smallest variance is "
            f"{weights[best]:g}, got {found:g}"
        )
