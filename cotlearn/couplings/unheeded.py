"""Warnings of columns of the condition that pairing does not heed, so that they skew the noise."""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from cotlearn.couplings.distances import Array, Index, heeded

NEARLY_ALL = 0.99  #: share of the condition cost of one column that causes a warning
UNHEEDED = 0.05  #: squared difference in pairs, as a share of that in random pairs, that does so
UNRESOLVED, RESOLVED = 0.6, 0.2  #: shares of variance inside clusters: lost, and not


def ruling_column(c: Tensor) -> int | None:
    """The column of c (n, k) with 99 % of the squared distances of its rows, if others vary."""
    if c.shape[1] < 2:
        return None
    values = c.detach().double()
    varying = int((values != values[0]).any(dim=0).sum())
    values = values / values.abs().max().clamp(min=1e-300)
    variance = (values - values.mean(dim=0)).square().mean(dim=0)
    most = int(variance.argmax())
    others = torch.cat([variance[:most], variance[most + 1 :]])  # the total would round them away
    rules = float(others.sum()) < (1 - NEARLY_ALL) / NEARLY_ALL * float(variance[most])
    return most if varying > 1 and rules else None


def warn_if_one_column_rules(c: Tensor) -> None:
    """Warn if nearly all of the condition cost comes from one column of several."""
    column = ruling_column(c)
    if column is not None:
        warnings.warn(
            f"column {column} of c carries nearly all of the condition cost, so that noise may "
            "depend on the other columns: bring them to like units (ConditionalOT() does), or "
            "`combine` them",
            stacklevel=5,
        )


def warn_if_unheeded(c: Array, noise_row: Index, data_row: Index) -> None:
    """Warn if pairs do not heed a column of the condition.

    A rule that weighs the condition against the sample leaves pairs a thousandth of the squared
    difference of random pairs, in 1 to 30 columns and 32 to 1,024 rows. A column with far more is
    outweighed by the others, as a label by 64 copies of a sensor, which no unit can repair.

    Args:
        c: (B, k), the conditions.
        noise_row: (B,), the row of c of each noise row.
        data_row: (B,), that of its partner.
    """
    share = heeded(c, noise_row, data_row)
    worst = int(share.argmax())
    if share[worst] > UNHEEDED:
        warnings.warn(
            f"column {worst} of c is hardly heeded: noise is paired across its values, because "
            "the other columns outweigh it, and depends on it; leave out columns that say the "
            'same, or `combine` them with weights for ConditionalOT("balanced")',
            stacklevel=5,
        )


def warn_if_unresolved(c: Tensor, label: Tensor) -> None:
    """Warn if clusters tell apart most columns of c (n, k), but hardly one of them.

    Args:
        c: (n, k), as the clusters see them.
        label: (n,), the cluster of each row.
    """
    values, label = c.detach().double(), label.to(c.device)
    sums = values.new_zeros(int(label.max()) + 1, values.shape[1]).index_add(0, label, values)
    means = sums / torch.bincount(label).clamp(min=1)[:, None]
    spread = values.var(dim=0, unbiased=False)
    inside = (values - means[label]).square().mean(dim=0)[spread > 0] / spread[spread > 0]
    if len(inside) and inside.median() < RESOLVED and inside.max() > UNRESOLVED:
        worst = int((spread > 0).nonzero()[inside.argmax()])
        warnings.warn(
            f"column {worst} of c is not told apart by the clusters, because the others outweigh "
            "it, so that noise depends on it: raise the number of clusters, leave out columns that "
            "say the same, or `combine` them with weights for KMeansCondition(..., "
            "standardise=False)",
            stacklevel=4,
        )
