"""Wrong answers to the exercises of notebooks 05, 07 and 09, words of their hints, right ones."""

import numpy as np
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


def turn(points, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def entropy(p):
    p = p[p > 0]
    return -(p * np.log(p)).sum()


def naive(p):
    with np.errstate(all="ignore"):
        return np.exp(-(p * np.log(p)).sum())


MISTAKES += [
    ("07.perplexity", entropy, "exp of it"),
    ("07.perplexity", lambda p: np.exp(-entropy(p)), "minus sign"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / np.log(2)), "log2"),
    ("07.perplexity", lambda p: 2 ** entropy(p), "2 ** goes with log2"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / len(p)), "not its mean"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / np.log(len(p))), "log k"),
    ("07.perplexity", naive, "leave the zeros out"),
    ("07.perplexity", lambda p: (p > 0).sum(), "rare ones"),
    ("07.perplexity", lambda p: 1 / (p**2).sum(), "another count"),
    ("07.perplexity", lambda p: np.exp(-np.log(p[p > 0]).sum()), "weighted by its p"),
    ("07.perplexity", lambda p: 7.0, "expected 2.2"),
    ("07.perplexity", lambda p: p, "one number"),
    ("07.perplexity", 2.0, "expected a function"),
    ("07.to_body", lambda x, pose: x - pose[:2], "not turned"),
    ("07.to_body", lambda x, pose: turn(x - pose[:2], pose[2]), "the wrong way"),
    ("07.to_body", lambda x, pose: turn(x, -pose[2]) - pose[:2], "then turn"),
    ("07.to_body", lambda x, pose: turn(x, -pose[2]), "place first"),
    ("07.to_body", lambda x, pose: turn(x, pose[2]) + pose[:2], "to the world"),
    ("07.to_body", lambda x, pose: turn(pose[:2] - x, -pose[2]), "point minus place"),
    ("07.to_body", lambda x, pose: x * 0 + 9, "expected [["),
    ("07.to_body", lambda x, pose: x[0], "shape (3, 2)"),
    ("07.to_body", lambda x, pose: "here", "array of points"),
    ("07.to_body", "here", "expected a function"),
]


RIGHT += [
    ("07.perplexity", lambda p: 2 ** -(p * np.log2(np.maximum(p, 1e-300))).sum()),
    ("07.to_body", lambda x, pose: turn(x - pose[:2], -pose[2])),
]


def damped(J, e, damping):
    return J.T @ np.linalg.solve(J @ J.T + damping * np.eye(len(J)), e)


def within(paths, ddof=1):
    return paths.var(axis=1, ddof=ddof).sum(axis=-1).mean()


def total(paths, ddof=0):
    return paths.reshape(-1, paths.shape[-1]).var(axis=0, ddof=ddof).sum()


def means_apart(paths):
    return paths.mean(axis=1).var(axis=0, ddof=1).sum() / total(paths)


def column_by_column(paths):
    columns = paths.var(axis=1, ddof=1).mean(axis=0)
    return 1 - (columns / paths.reshape(-1, paths.shape[-1]).var(axis=0)).mean()


MISTAKES += [
    ("09.damped_step", lambda J, e, d: -damped(J, e, d), "target minus tip"),
    ("09.damped_step", lambda J, e, d: np.linalg.pinv(J) @ e, "undamped step"),
    ("09.damped_step", lambda J, e, d: damped(J, e, d**2), "do not square it"),
    ("09.damped_step", lambda J, e, d: J.T @ np.linalg.solve(J @ J.T + d, e), "np.eye"),
    ("09.damped_step", lambda J, e, d: J.T @ e, "still to be solved"),
    ("09.damped_step", lambda J, e, d: J.T @ (J @ J.T + d * np.eye(len(J))) @ e, "inverse"),
    ("09.damped_step", lambda J, e, d: np.ones(7), "not the minimiser"),
    ("09.damped_step", lambda J, e, d: np.linalg.solve(J @ J.T, e), "must have shape (7,)"),
    ("09.damped_step", lambda J, e, d: damped(J, e, d)[:, None], "drop the axis of length 1"),
    ("09.damped_step", lambda J, e, d: np.full(7, np.nan), "not all values are finite"),
    ("09.damped_step", 3.0, "expected a function"),
    ("09.between_share", lambda p: within(p) / total(p), "share within"),
    ("09.between_share", lambda p: 1 - within(p, 0) / total(p), "draws - 1"),
    ("09.between_share", lambda p: 1 - p.var(0, ddof=1).sum(-1).mean() / total(p), "axis 1"),
    ("09.between_share", lambda p: 1 - within(p) / (p**2).sum(-1).mean(), "rows' mean"),
    ("09.between_share", lambda p: 1 - p.var(1, ddof=1).mean() / total(p), "sum the variances"),
    ("09.between_share", means_apart, "counts part"),
    ("09.between_share", lambda p: 1 - len(p) * within(p) / total(p), "do not sum"),
    ("09.between_share", column_by_column, "before you divide"),
    ("09.between_share", lambda p: 0.5, "expected"),
    ("09.between_share", lambda p: p, "one number"),
    ("09.between_share", "half", "expected a function"),
]


RIGHT += [
    ("09.damped_step", lambda J, e, d: np.linalg.solve(J.T @ J + d * np.eye(7), J.T @ e)),
    ("09.between_share", lambda p: 1 - within(p) / total(p, 1)),
]
