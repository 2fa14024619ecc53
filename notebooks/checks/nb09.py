"""The checks of notebook 09."""

import numpy as np

from .common import Array, Case, Cases, table


@table("09.damped_step")
def damped_step() -> Cases:
    """The step of damped least squares, J^T (J J^T + damping I)^-1 e."""
    rng = np.random.default_rng(9)
    for rows, damping in ((3, 0.1), (3, 0.01), (5, 0.4)):
        J, e = rng.normal(size=(rows, 7)), rng.normal(size=rows)
        square = J @ J.T + damping * np.eye(rows)
        everywhere = J.T @ np.linalg.solve(J @ J.T + damping, e)
        right = _damped(J, e, damping)
        wrong = {
            "the wrong sign: error is target minus tip, so the step goes along it": -right,
            "that is the undamped step: add damping * I": _damped(J, e, 0.0),
            "damping is lambda itself, do not square it": _damped(J, e, damping**2),
            "damping goes on the diagonal alone: damping * np.eye(len(jacobian))": everywhere,
            "the system (J J^T + damping I) is still to be solved": J.T @ e,
            "J J^T + damping I multiplies; its inverse must: np.linalg.solve": J.T @ square @ e,
        }
        hint = "not the minimiser of |J dq - e|^2 + damping |dq|^2"
        yield Case((J, e, damping), right, wrong, hint, "the change of joints")


@table("09.between_share")
def between_share() -> Cases:
    """The share of variance between conditions, 1 - within / total."""
    rng = np.random.default_rng(90)
    for conditions, draws, spread in ((4, 3, 2.0), (6, 2, 0.3), (3, 5, 0.0)):
        means = 5 + spread * rng.normal(size=(conditions, 1, 2))
        paths = means + rng.normal(size=(conditions, draws, 2)) * (1.0, 0.5)
        rows = paths.reshape(-1, 2)
        each, total = paths.var(axis=1, ddof=1), rows.var(axis=0).sum()
        within, biased = each.sum(axis=-1).mean(), paths.var(axis=1).sum(axis=-1).mean()
        columns = each.mean(axis=0) / rows.var(axis=0)
        deviations = np.sqrt(each).sum(axis=-1).mean() / rows.std(axis=0).sum()
        over = paths.var(axis=0, ddof=1).sum(axis=-1).mean()
        wrong = {
            "that is the share within; the rest lies between": within / total,
            "within a condition divide by draws - 1: var(..., ddof=1); the variance of the "
            "conditions' means counts part of the variance within, too": 1 - biased / total,
            "that is over conditions; within goes over the draws, axis 1": 1 - over / total,
            "the total is about the rows' mean": 1 - within / (rows**2).sum(axis=1).mean(),
            "sum the variances of the columns, average over conditions": 1 - each.mean() / total,
            "average over the conditions, do not sum": 1 - conditions * within / total,
            "sum the variances over the columns before you divide": (1 - columns).mean(),
            "the variance of the conditions' means counts part of the variance within, too; return "
            "1 - within / total": paths.mean(axis=1).var(axis=0, ddof=1).sum() / total,
            "these are standard deviations: take variances": 1 - deviations,
        }
        by_rows = 1 - within / rows.var(axis=0, ddof=1).sum()  # rows - 1 will do
        hint = f"expected {1 - within / total:.4g} for paths of shape {paths.shape}"
        yield Case((paths,), 1 - within / total, wrong, hint, also=(by_rows,))


def _damped(jacobian: Array, error: Array, damping: float) -> Array:
    square = jacobian @ jacobian.T + damping * np.eye(len(jacobian))
    return np.asarray(jacobian.T @ np.linalg.solve(square, error))
