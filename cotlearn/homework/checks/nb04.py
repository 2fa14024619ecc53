"""The checks of notebook 04."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import torch
from scipy.optimize import linear_sum_assignment

from cotlearn.homework.checks.common import number
from cotlearn.homework.registry import NotYet, exercise


@exercise("04.candidates")
def candidates(answer: Any) -> None:
    """1 + (B - 1)/K for several batches and numbers of labels."""
    for B, K in ((256, 4), (64, 64), (1, 10), (1024, 1)):
        got, expected = number(answer(B, K)), 1 + (B - 1) / K
        if math.isclose(got, expected, rel_tol=1e-6):
            continue
        if math.isclose(got, B / K, rel_tol=1e-6):
            raise NotYet(
                "B / K leaves out that a row always finds one partner of its own label: the row "
                f"that its label was copied from; for B = {B}, K = {K} there are {expected:.4g}"
            )
        if math.isclose(got, (B - 1) / K, rel_tol=1e-6):
            raise NotYet("count the row itself too: it is always there")
        if math.isclose(got, 1 + B / K, rel_tol=1e-6):
            raise NotYet("the row itself is one of the B: only B - 1 others are left to chance")
        raise NotYet(f"for B = {B} and K = {K} expected {expected:.4g}, got {got:.4g}")


@exercise("04.balanced_weight")
def balanced_weight(answer: Any) -> None:
    """COT Policy's rule, with the mistakes that are easily made."""
    g = torch.Generator().manual_seed(4)
    for scale in (1.0, 7.0):
        x0, x1 = torch.randn(40, 2, generator=g), scale * torch.randn(40, 2, generator=g)
        c = torch.randn(40, 3, generator=g)
        sample, condition = torch.cdist(x0, x1), torch.cdist(c, c)
        gamma = float(10 * sample.mean() / condition.mean())
        got = number(answer(x0, x1, c))
        if math.isclose(got, gamma**2, rel_tol=1e-3):
            continue
        guesses = {
            "this is g; the weight of the squared distance is w = g^2": gamma,
            "the rule takes the means of the distances, not of their squares": float(
                100 * sample.square().mean() / condition.square().mean()
            ),
            "the factor 10 belongs to g, so it is squared in w": gamma**2 / 10,
            "the factor 10 is missing": gamma**2 / 100,
            "the sample's distance stands above, the condition's below": float(
                (10 * condition.mean() / sample.mean()) ** 2
            ),
        }
        for hint, wrong in guesses.items():
            if math.isclose(got, wrong, rel_tol=1e-3):
                raise NotYet(hint)
        raise NotYet(f"expected {gamma**2:.4g}, got {got:.4g}; the mean runs over all i and j")


@exercise("04.stratify")
def stratify(answer: Any) -> None:
    """Cheapest pairs within each label, and never across."""
    g = torch.Generator().manual_seed(5)
    for sizes in ((5, 5, 5), (1, 7, 4)):
        label = torch.repeat_interleave(torch.arange(len(sizes)), torch.tensor(sizes))
        label = label[torch.randperm(len(label), generator=g)]
        n = len(label)
        x0, x1 = torch.randn(n, 2, generator=g), 3 * torch.randn(n, 2, generator=g)
        found = answer(x0.clone(), x1.clone(), label.clone())
        try:
            p = torch.as_tensor(found)
        except (TypeError, ValueError, RuntimeError):
            raise NotYet(f"return {n} integers, got {type(found).__name__}") from None
        if p.dtype.is_floating_point or p.dtype == torch.bool or tuple(p.shape) != (n,):
            raise NotYet(f"return integers of shape ({n},), got {p.dtype} {tuple(p.shape)}")
        if sorted(p.tolist()) != list(range(n)):
            raise NotYet(
                "p must use every data row exactly once; positions inside a label have to be "
                "turned back into rows of the whole batch"
            )
        if not torch.equal(label[p], label):
            raise NotYet("some noise meets data of another label")
        cost = torch.cdist(x0, x1).square().numpy()
        best = 0.0
        for k in range(len(sizes)):
            rows = np.flatnonzero(label.numpy() == k)
            block = cost[np.ix_(rows, rows)]
            best += float(block[linear_sum_assignment(block)].sum())
        got = float(cost[np.arange(n), p.numpy()].sum())
        if got > best * (1 + 1e-5):
            raise NotYet(f"labels are kept, but the pairs cost {got:.3f}, the cheapest {best:.3f}")
