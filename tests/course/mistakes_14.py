"""Wrong answers to the exercises of notebook 14, words of their hints, right ones."""

import torch


def cross_fit(episode, fit, *, alone=False):
    found = torch.zeros_like(fit(episode >= 0))
    for fold in range(5):
        left = episode % 5 == fold
        found[left] = fit(left if alone else ~left)[left]
    return found


def smaller(left):
    share = left.double().mean(dim=1)
    return torch.minimum(share, 1 - share)


def balance(left):
    return float(smaller(left).mean())


def pooled(left):
    share = float(left.double().mean())
    return min(share, 1 - share)


MISTAKES = [
    ("14.cross_fit", lambda episode, fit: fit(episode >= 0), "saw the window's own episode"),
    ("14.cross_fit", lambda *given: cross_fit(*given, alone=True), "on the fold alone"),
    ("14.cross_fit", lambda e, fit: cross_fit(torch.arange(len(e)), fit), "folds are of windows"),
    ("14.cross_fit", lambda e, f: sum(f(e % 5 != k) for k in range(5)) / 5, "not the mean of five"),
    ("14.cross_fit", lambda episode, fit: episode, "shape"),
    ("14.cross_fit", 5, "expected a function"),
    ("14.balance", pooled, "would look balanced"),
    ("14.balance", lambda left: 1 - balance(left), "the more frequent way"),
    ("14.balance", lambda left: float(left.double().mean()), "that goes left"),
    ("14.balance", lambda left: float(smaller(left).min()), "the smallest fork"),
    ("14.balance", lambda left: 0.5, "expected"),
    ("14.balance", 0.4, "expected a function"),
]

RIGHT = [
    ("14.cross_fit", cross_fit),
    ("14.cross_fit", lambda e, fit: torch.stack([fit(e % 5 != k % 5)[i] for i, k in enumerate(e)])),
    ("14.balance", balance),
    ("14.balance", lambda left: sum(min(r.sum(), (~r).sum()) / len(r) for r in left) / len(left)),
]
