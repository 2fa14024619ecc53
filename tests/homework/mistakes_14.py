"""Wrong answers to the exercises of notebook 14, words of their hints, right ones."""

import torch


def cross_fit(episode, fit):
    found = fit(torch.ones_like(episode, dtype=torch.bool)).clone()
    for fold in range(5):
        left = episode % 5 == fold
        found[left] = fit(~left)[left]
    return found


def alone(episode, fit):
    found = torch.zeros_like(fit(episode >= 0))
    for fold in range(5):
        rows = episode % 5 == fold
        found[rows] = fit(rows)[rows]
    return found


def balance(left):
    share = left.double().mean(dim=1)
    return float(torch.minimum(share, 1 - share).mean())


def pooled(left):
    share = float(left.double().mean())
    return min(share, 1 - share)


MISTAKES = [
    ("14.cross_fit", lambda episode, fit: fit(episode >= 0), "saw the window's own episode"),
    ("14.cross_fit", alone, "on the fold alone"),
    (
        "14.cross_fit",
        lambda episode, fit: cross_fit(torch.arange(len(episode)), fit),
        "folds are of windows",
    ),
    (
        "14.cross_fit",
        lambda episode, fit: sum(fit(episode % 5 != k) for k in range(5)) / 5,
        "not the mean of five",
    ),
    ("14.cross_fit", lambda episode, fit: episode, "shape"),
    ("14.cross_fit", 5, "expected a function"),
    ("14.balance", pooled, "would look balanced"),
    ("14.balance", lambda left: 1 - balance(left), "the more frequent way"),
    ("14.balance", lambda left: float(left.double().mean()), "that goes left"),
    (
        "14.balance",
        lambda left: float(
            torch.minimum(left.double().mean(dim=1), 1 - left.double().mean(dim=1)).min()
        ),
        "the smallest fork",
    ),
    ("14.balance", lambda left: 0.5, "expected"),
    ("14.balance", 0.4, "expected a function"),
]

RIGHT = [
    ("14.cross_fit", cross_fit),
    (
        "14.cross_fit",
        lambda episode, fit: torch.stack(
            [fit(episode % 5 != int(e) % 5)[i] for i, e in enumerate(episode)]
        ),
    ),
    ("14.balance", balance),
    ("14.balance", lambda left: sum(min(r.sum(), (~r).sum()) / len(r) for r in left) / len(left)),
]
