"""Which coupling for these data? Read off the frontier, with the reason in words."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.diagnostics.frontier import Frontier, FrontierPoint, frontier
from cotlearn.diagnostics.spread import BetweenWithin, between_within
from cotlearn.validation import check_condition, check_count, check_matrix, check_same_rows

USEFUL = 0.8  #: a coupling must cut the predicted one-step error of independent to this share
NARROW = 0.02  #: below this share of variance within conditions there is nothing to straighten
LABELS_UP_TO = 64  #: so many distinct conditions are treated as labels
GOOD_STRATUM = 32  #: rows of a cluster that leave enough to choose from


@dataclass(frozen=True)
class Recommendation:
    """A coupling, why, and the evidence.

    Attributes:
        name: its name on the frontier.
        coupling: ready for `fit`.
        reason: one paragraph.
        frontier: all candidates.
        spread: variance between and within conditions.
    """

    name: str
    coupling: Coupling
    reason: str
    frontier: Frontier
    spread: BetweenWithin


def recommend(
    x1: Tensor,
    c: Tensor,
    *,
    batch_size: int = 256,
    rows: int = 4096,
    seed: int = 0,
    progress: bool | None = None,
) -> Recommendation:
    """Pick a coupling and its weight for data x1 (N, d) with conditions c (N, k).

    Candidates are independent pairs, naive OT, COT over a range of weights, and stratified OT. The
    one with the smallest predicted one-step error is taken if its prior skew is not significant,
    or among the others the best without significant skew; and only if that is below
    0.8 times what independent pairs leave, which otherwise are recommended.

    Args:
        x1: the training data, at least 200 rows.
        c: conditions; standardise or `combine` several first.
        batch_size: rows of an OT batch.
        rows: pairs looked at for each candidate.
        seed: of everything.
        progress: show a bar; None: in terminals and notebooks.
    """
    check_matrix(x1, "x1")
    c = check_condition(c)
    check_same_rows(c, "c", x1, "x1")
    check_count(batch_size, "batch_size", minimum=2)
    couplings = candidates(x1, c)
    found = frontier(
        x1, c, couplings, batch_size=batch_size, rows=rows, seed=seed, progress=progress
    )
    spread = between_within(x1, c, seed=seed)
    best, reason = _choose(found, spread)
    return Recommendation(best.name, couplings[best.name], reason, found, spread)


def candidates(x1: Tensor, c: Tensor) -> dict[str, Coupling]:
    """The couplings that `recommend` compares on these data.

    Weights of COT are multiples of the ratio of sample to condition variance, which makes both
    terms of the cost equal: 1, 10, 100 and 1000 times.
    """
    distinct = len(torch.unique(c, dim=0))
    chosen: dict[str, Coupling] = {"independent": Independent(), "naive OT": MinibatchOT()}
    spread = float(c.var(dim=0).sum())
    if spread > 0:
        ratio = float(x1.var(dim=0).sum() + x1.shape[1]) / spread
        for factor in (1, 10, 100, 1000):
            chosen[f"COT x {factor}"] = ConditionalOT(factor * ratio)
    if distinct <= LABELS_UP_TO:
        chosen["COT per label"] = ConditionalOT(math.inf)
        chosen["stratified by label"] = StratifiedOT()
    else:
        for rows in (GOOD_STRATUM, 4 * GOOD_STRATUM):
            clusters = len(x1) * 3 // 4 // rows
            if clusters > 1:
                chosen[f"stratified, {rows} rows"] = StratifiedOT(clusters)
    return chosen


def _choose(found: Frontier, spread: BetweenWithin) -> tuple[FrontierPoint, str]:
    independent, naive = found["independent"], found["naive OT"]
    clean = [p for p in found if not p.flagged and p.name != "independent"]
    best = min(clean, key=lambda p: p.one_step_error, default=independent)
    facts = (
        f"{100 * spread.between_share:.0f} % of the variance of the data lies between conditions. "
        f"Naive OT {'skews' if naive.flagged else 'does not visibly skew'} the prior (statistic "
        f"{naive.skew:.2f}). Independent pairs leave a one-step variance of "
        f"{independent.one_step_variance:.3g} and a predicted one-step error of "
        f"{independent.one_step_error:.3g}. "
    )
    if spread.within <= NARROW * spread.total:
        return independent, facts + (
            "Use independent pairs: given the condition the data hardly vary, so that no coupling "
            "has anything to straighten, and a regression would do as well."
        )
    if best.one_step_error > USEFUL * independent.one_step_error:
        return independent, facts + (
            "Use independent pairs: no coupling without significant skew cuts the predicted "
            f"one-step error to {USEFUL:.0%} of that (the best, {best.name}, leaves "
            f"{best.one_step_error:.3g}); conditions have too few neighbours, or the data too "
            "little spread within a condition. More data or a coarser condition may change this."
        )
    return best, facts + (
        f"Use {best.name}: it cuts the one-step variance to {best.one_step_variance:.3g} and the "
        f"predicted one-step error to {best.one_step_error:.3g}, with no significant skew "
        f"({best.skew:.3f}) and about {best.candidates:.0f} candidates for each noise row."
    )
