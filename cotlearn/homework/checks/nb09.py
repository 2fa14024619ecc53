"""The checks of notebook 09."""

from __future__ import annotations

from typing import Any

import numpy as np

from cotlearn.homework.checks.common import Array, array, compare, expect_function, number
from cotlearn.homework.registry import exercise


@exercise("09.damped_step")
def damped_step(answer: Any) -> None:
    """J^T (J J^T + damping I)^-1 e."""
    expect_function(answer)
    rng = np.random.default_rng(9)
    for rows, damping in ((3, 0.1), (3, 0.01), (5, 0.4)):
        jacobian, error = rng.normal(size=(rows, 7)), rng.normal(size=rows)
        found = array(answer(jacobian.copy(), error.copy(), damping), (7,), "the change of joints")
        right = _damped(jacobian, error, damping)
        compare(
            found,
            right,
            (
                (-right, "the other way: error is target minus tip, so the step goes along it"),
                (_damped(jacobian, error, 0.0), "that is the undamped step: add damping * I"),
                (
                    _damped(jacobian, error, damping**2),
                    "damping is lambda itself, do not square it",
                ),
                (
                    jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + damping, error),
                    "damping goes on the diagonal alone: damping * np.eye(len(jacobian))",
                ),
                (jacobian.T @ error, "the system (J J^T + damping I) is still to be solved"),
                (
                    jacobian.T @ (jacobian @ jacobian.T + damping * np.eye(rows)) @ error,
                    "multiplied by J J^T + damping I, where its inverse is needed: np.linalg.solve",
                ),
            ),
            "not the minimiser of |J dq - e|^2 + damping |dq|^2",
        )


@exercise("09.between_share")
def between_share(answer: Any) -> None:
    """1 - within / total."""
    expect_function(answer)
    rng = np.random.default_rng(90)
    for conditions, draws, spread in ((4, 3, 2.0), (6, 2, 0.3), (3, 5, 0.0)):
        means = 5 + spread * rng.normal(size=(conditions, 1, 2))
        paths = means + rng.normal(size=(conditions, draws, 2)) * (1.0, 0.5)
        value = number(answer(paths.copy()))
        rows = paths.reshape(-1, 2)
        within = paths.var(axis=1, ddof=1).sum(axis=-1).mean()
        total = rows.var(axis=0).sum()
        if np.isclose(value, 1 - within / rows.var(axis=0, ddof=1).sum(), rtol=1e-5):
            continue  # divides by rows - 1
        small = paths.var(axis=1).sum(axis=-1).mean()
        compare(
            value,
            1 - within / total,
            (
                (within / total, "that is the share within; the rest lies between"),
                (
                    1 - small / total,
                    "within a condition divide by draws - 1: var(..., ddof=1); the variance of "
                    "the conditions' means counts part of the variance within, too",
                ),
                (
                    1 - paths.var(axis=0, ddof=1).sum(axis=-1).mean() / total,
                    "that is the variance over conditions; within goes over the draws, axis 1",
                ),
                (1 - within / (rows**2).sum(axis=1).mean(), "the total is about the rows' mean"),
                (
                    1 - paths.var(axis=1, ddof=1).mean() / total,
                    "sum the variances of the d columns in both, average over conditions only",
                ),
            ),
            f"expected {1 - within / total:.4g} for paths of shape {paths.shape}, got {value:.4g}",
        )


def _damped(jacobian: Array, error: Array, damping: float) -> Array:
    square = jacobian @ jacobian.T + damping * np.eye(len(jacobian))
    result: Array = jacobian.T @ np.linalg.solve(square, error)
    return result
