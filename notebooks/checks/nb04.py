"""The checks of notebook 04 and of its laboratory."""

from typing import Any

import torch

from cotlearn.course.checking import NotYet, exercise

from .common import Case, Cases, call, cheapest, permutation, table


@table("04.candidates")
def candidates() -> Cases:
    """The number of candidates, 1 + (B - 1)/K, for several batch sizes and numbers of labels."""
    for B, K in ((250, 4), (64, 64), (1, 10), (1024, 1)):
        wrong = {
            "a mean need not be whole: do not round": 1 + (B - 1) // K,
            "B / K leaves out that a row always finds one partner, whose label it copied": B / K,
            "count the row itself too: it is always there": (B - 1) / K,
            "the row itself is one of the B: only B - 1 others are left to chance": 1 + B / K,
        }
        yield Case((B, K), 1 + (B - 1) / K, wrong)


@table("04.balanced_weight", seed=4)
def balanced_weight(g: torch.Generator) -> Cases:
    """The weight by COT Policy's rule."""
    for scale in (1.0, 7.0):
        x0, x1 = torch.randn(40, 2, generator=g), scale * torch.randn(40, 2, generator=g)
        c = torch.randn(40, 3, generator=g)
        far, apart = torch.cdist(x0, x1), torch.cdist(c, c)
        gamma = 10 * far.mean() / apart.mean()
        squares = 100 * far.square().mean() / apart.square().mean()
        wrong = {
            "this is g; the weight of the squared distance is w = g^2": gamma,
            "the rule takes the means of the distances, not of their squares": squares,
            "the factor 10 belongs to g, so it is squared in w": gamma**2 / 10,
            "the factor 10 is missing": gamma**2 / 100,
            "the sample's distance stands above, the condition's below": 1e4 / gamma**2,
        }
        hint = f"expected {gamma**2:.4g}; the mean runs over all i and j"
        yield Case((x0, x1, c), gamma**2, wrong, hint, tolerance=1e-3)


@table("04.candidate_share", seed=6)
def candidate_share(g: torch.Generator) -> Cases:
    """The share of the pairs that cost no more than their data row with its own noise."""
    for w in (0.2, 0.5):
        M, c = 3 * torch.rand(12, 12, generator=g), torch.randn(12, 2, generator=g)
        C = torch.cdist(c, c).square()
        cost, own = M + w * C, M.diagonal()
        wrong = {
            "compare with M_jj of the column j, the data row": cost <= own[:, None],
            "a row with its own noise counts, too: use <=": cost < own,
            "the condition's part is missing": own >= M,
            "the condition's part has the weight w": own >= M + C,
            "that is the share of the pairs that are no candidates": cost > own,
        }
        shares = {hint: float(found.float().mean()) for hint, found in wrong.items()}
        yield Case((w, M, C), float((cost <= own).float().mean()), shares)


@exercise("04.stratify")
def stratify(answer: Any) -> None:
    """Optimal pairs within each label, never across labels."""
    g = torch.Generator().manual_seed(5)
    for sizes in ((5, 5, 5), (1, 7, 4)):
        label = torch.repeat_interleave(torch.tensor([2, 5, 9]), torch.tensor(sizes))
        label = label[torch.randperm(len(label), generator=g)]
        n = len(label)
        x0, x1 = torch.randn(n, 2, generator=g), 3 * torch.randn(n, 2, generator=g)
        hint = "solve an assignment inside each label; turn its positions into rows of the batch"
        p = permutation(call(answer, x0.clone(), x1.clone(), label.clone()), n, hint)
        if not torch.equal(label[p], label):
            raise NotYet("some noise meets data of another label")
        cost = torch.cdist(x0, x1).square()
        across = label[:, None] != label
        best, got = (cost[range(n), q].sum() for q in (cheapest(cost + 1e6 * across), p))
        if got > best * (1 + 1e-5):
            kept = f"the labels {label.unique().tolist()} are kept"
            raise NotYet(f"{kept}, but the pairs cost {got:.3f}, the cheapest {best:.3f}")
