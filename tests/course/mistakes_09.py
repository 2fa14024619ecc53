"""Wrong answers to the exercises of notebook 09, words of their hints, right ones."""

import numpy as np


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


MISTAKES = [
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


RIGHT = [
    ("09.damped_step", lambda J, e, d: np.linalg.solve(J.T @ J + d * np.eye(7), J.T @ e)),
    ("09.between_share", lambda p: 1 - within(p) / total(p, 1)),
]
