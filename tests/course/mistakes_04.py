"""Wrong answers to the exercises of notebook 04, words of their hints, right ones."""

import torch
from scipy.optimize import linear_sum_assignment


def mean_distances(x0, x1, c):
    return float(torch.cdist(x0, x1).mean()), float(torch.cdist(c, c).mean())


def gamma(x0, x1, c):
    sample, condition = mean_distances(x0, x1, c)
    return 10 * sample / condition


def of_squares(x0, x1, c):
    return 100 * (torch.cdist(x0, x1) ** 2).mean() / (torch.cdist(c, c) ** 2).mean()


def upside_down(x0, x1, c):
    sample, condition = mean_distances(x0, x1, c)
    return (10 * condition / sample) ** 2


def share(cost, own):
    return float((cost <= own).float().mean())


def cheapest(x0, x1):
    return torch.from_numpy(linear_sum_assignment(torch.cdist(x0, x1) ** 2)[1])


def within(x0, x1, label, *, positions=False, labels=None):
    p = torch.arange(len(x0))
    for k in label.unique() if labels is None else labels:
        rows = (label == k).nonzero()[:, 0]
        found = cheapest(x0[rows], x1[rows])
        p[rows] = found if positions else rows[found]
    return p


def nearest_within(x0, x1, label):
    far = torch.cdist(x0, x1)
    return torch.where(label[:, None] == label, far, torch.inf).argmin(dim=1)


MISTAKES = [
    ("04.candidates", lambda B, K: B / K, "always finds one"),
    ("04.candidates", lambda B, K: (B - 1) / K, "itself"),
    ("04.candidates", lambda B, K: B * K, "expected"),
    ("04.candidates", lambda B, K: 1 + B / K, "only B - 1 others"),
    ("04.candidates", lambda B, K: "many", "one number"),
    ("04.candidates", lambda B, K: 1 + (B - 1) // K, "do not round"),
    ("04.candidates", lambda B, K: round(1 + (B - 1) / K), "do not round"),
    ("04.balanced_weight", gamma, "w = g^2"),
    ("04.balanced_weight", of_squares, "not of their squares"),
    ("04.balanced_weight", lambda x0, x1, c: gamma(x0, x1, c) ** 2 / 10, "belongs to g"),
    ("04.balanced_weight", lambda x0, x1, c: gamma(x0, x1, c) ** 2 / 100, "missing"),
    ("04.balanced_weight", upside_down, "stands above"),
    ("04.balanced_weight", lambda x0, x1, c: 1.0, "all i and j"),
    ("04.candidate_share", lambda w, M, C: share(M + w * C, M.diagonal()[:, None]), "column j"),
    ("04.candidate_share", lambda w, M, C: share(M, M.diagonal()), "part is missing"),
    ("04.candidate_share", lambda w, M, C: 12 * share(M + w * C, M.diagonal()), "expected"),
    ("04.stratify", lambda *given: within(*given, positions=True), "turn its positions into rows"),
    ("04.stratify", nearest_within, "an assignment inside each label"),
    ("04.stratify", lambda *given: within(*given, labels=range(3)), "labels [2, 5, 9] are kept"),
    ("04.stratify", lambda x0, x1, label: cheapest(x0, x1), "another label"),
    ("04.stratify", lambda x0, x1, label: torch.arange(len(x0)), "cheapest"),
    ("04.stratify", lambda x0, x1, label: x0, "integers"),
    ("04.stratify", lambda x0, x1, label: "p", "integers"),
]


RIGHT = [
    ("04.candidates", lambda B, K: 1 + (B - 1) / K),
    ("04.balanced_weight", lambda x0, x1, c: gamma(x0, x1, c) ** 2),
    ("04.candidate_share", lambda w, M, C: share(M + w * C, M.diagonal())),
    ("04.stratify", within),
]
