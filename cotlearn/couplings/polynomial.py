"""The simplest regression for `Centred`: a polynomial of the condition, in closed form."""

from __future__ import annotations

import torch
from torch import Tensor

from cotlearn.validation import check_condition, check_matrix, check_same_rows

_ROWS_FOR_EACH = 5  #: rows for each feature, below which a fit would remember them
_RIDGE = 1.0  #: in squares of a feature of unit variance: as much as one row


class PolynomialMean:
    """What a polynomial of c foretells of x1, by least squares: a mean for `Centred`.

    No training and no network: `Centred(StratifiedOT(64), PolynomialMean().fit(x1, c))`. What it
    takes off is what `linear_skew` of the same degree looks for, so naive OT about it passes that
    test. A network foretells more where data are many, and remembers them where they are few.

    Args:
        degree: 1 for the columns of c and a constant, 2 for their squares and products as well.

    Attributes:
        degree: as given.
        weights: (p, d) of the features, once fitted; else None.

    Raises:
        ValueError: another degree; in `fit` fewer than 5 rows for each feature (of k columns and
            degree 2 there are 1 + k (k + 3) / 2), or values that are not finite.
    """

    def __init__(self, degree: int = 2) -> None:
        if degree not in (1, 2):
            raise ValueError(f"degree must be 1 or 2, got {degree!r}")
        self.degree = degree
        self.weights: Tensor | None = None

    def fit(self, x1: Tensor, c: Tensor) -> PolynomialMean:
        """Fits it to data x1 (n, d) with their conditions c (n, k), and returns it."""
        check_matrix(x1, "x1")
        c = check_condition(c)
        check_same_rows(c, "c", x1, "x1")
        columns = c.double()
        self._centre = columns.mean(dim=0)
        spread = columns.std(dim=0, correction=0)
        self._scale = torch.where(spread > 0, spread, torch.ones_like(spread))
        features = self._features(c)
        if len(c) < _ROWS_FOR_EACH * features.shape[1]:
            raise ValueError(
                f"x1 and c need at least {_ROWS_FOR_EACH * features.shape[1]} rows for the "
                f"{features.shape[1]} features of degree {self.degree}, got {len(c)}"
            )
        ridge = _RIDGE * torch.eye(features.shape[1]).to(features)
        ridge[0, 0] = 0  # of the constant
        products = features.T @ features + ridge
        self.weights = torch.linalg.solve(products, features.T @ x1.double())
        return self

    def __call__(self, c: Tensor) -> Tensor:
        """The mean (B, d) for conditions c (B, k), of the dtype of c.

        Raises:
            ValueError: not fitted yet, or c with another number of columns.
        """
        if self.weights is None:
            raise ValueError("the mean must be fitted before it is asked: call fit(x1, c)")
        c = check_condition(c)
        if c.shape[1] != len(self._centre):
            raise ValueError(f"c must have {len(self._centre)} columns, got {c.shape[1]}")
        return (self._features(c) @ self.weights.to(c.device)).to(c.dtype)

    def _features(self, c: Tensor) -> Tensor:
        z = (c.double() - self._centre.to(c.device)) / self._scale.to(c.device)
        return torch.cat([torch.ones_like(z[:, :1]), polynomial(z, self.degree)], dim=1)

    def __repr__(self) -> str:
        return f"PolynomialMean({self.degree})"


def polynomial(z: Tensor, degree: int) -> Tensor:
    """The columns of z (n, k), for degree 2 with their squares and products, (n, k (k + 3) / 2)."""
    products = [z[:, [i]] * z[:, i:] for i in range(z.shape[1])] if degree == 2 else []
    return torch.cat([z, *products], dim=1)
