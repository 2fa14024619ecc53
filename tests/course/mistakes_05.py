"""Wrong answers to the exercises of notebook 05, words of their hints, right ones."""

import torch


def raised(errors, fraction, boost, *, descending=False, others=1.0, more=0):
    weights = torch.full_like(errors, others)
    chosen = int(len(errors) * fraction) + more
    weights[errors.argsort(descending=descending)[:chosen]] = 1 + boost
    return weights


def mean_one(**options):
    def answer(errors, fraction, boost):
        weights = raised(errors, fraction, boost, **options)
        return weights / weights.mean()

    return answer


MISTAKES = [
    ("05.pair_weights", raised, "divide by the mean"),
    ("05.pair_weights", mean_one(descending=True), "highest error"),
    ("05.pair_weights", mean_one(others=0.0), "top-k"),
    ("05.pair_weights", mean_one(more=1), "one too many"),
    ("05.pair_weights", lambda e, p, b: raised(e, p, b) / raised(e, p, b).sum(), "not sum 1"),
    ("05.pair_weights", lambda e, p, b: e.add_(1), "changed its inputs"),
    ("05.pair_weights", lambda e, p, b: e[:2], "shape"),
    ("05.pair_weights", lambda e, p, b: e / 0, "not all values are finite"),
    ("05.pair_weights", lambda e, p, b: torch.ones_like(e), "expected ["),
    ("05.evaluations", lambda B, K: 2 * B * B, "one pair at a time"),
    ("05.evaluations", lambda B, K: 2 * B * K, "B rows only"),
    ("05.evaluations", lambda B, K: B * K, "add t = 1"),
    ("05.evaluations", lambda B, K: B, "add t = 0"),
    ("05.evaluations", lambda B, K: 7, "expected 320"),
    ("05.evaluations", lambda B, K: "many", "one number"),
    ("05.evaluations", lambda B, K: str(B * (1 + K)), "one number, got str"),
    ("05.at_zero", lambda x0, x1: torch.cdist(x1, x0).square(), "transposed"),
    ("05.at_zero", torch.cdist, "squared"),
    ("05.at_zero", lambda x0, x1: 2 * torch.cdist(x0, x1).square(), "not their sum"),
    ("05.at_zero", lambda x0, x1: (x0 - x1).square().sum(dim=1), "shape (5, 5)"),
    ("05.at_zero", lambda x0, x1: torch.zeros(5, 5), "what is left"),
]


RIGHT = [("05.evaluations", lambda B, K: torch.tensor(B * (1 + K)))]
