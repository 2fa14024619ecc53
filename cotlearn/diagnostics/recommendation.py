"""Which coupling for these data? Read off the frontier, with the reason in words."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.diagnostics.frontier import Frontier, FrontierPoint, frontier
from cotlearn.diagnostics.skew import check_conditioned
from cotlearn.diagnostics.spread import BetweenWithin, between_within
from cotlearn.validation import check_count

CHANCE = 0.025  #: how often luck alone may recommend a coupling, whatever the number of candidates
USEFUL = 0.01  #: and the share of their score that it must save
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
    probe_steps: int = 500,
    seed: int = 0,
    progress: bool | None = None,
) -> Recommendation:
    """Pick a coupling and its weight for data x1 (N, d) with conditions c (N, k).

    Candidates are independent pairs, naive OT, COT over a range of weights, and stratified OT, with
    and without residuals. Those with significant skew are out. Of the others the one is taken whose
    probe (see `one_step_scores`) has the best energy score on held-out rows, if it beats the probe
    of independent pairs by 1 % and by more than chance; otherwise independent pairs are. Chance is
    what the best of all candidates reaches in one of 40 trials where none is better (Bonferroni):
    2.8 standard errors for ten of them.

    The sample's distances count against standard normal noise, so bring x1 to about unit variance.

    Args:
        x1: the training data, at least 200 rows.
        c: conditions; standardise or `combine` several first.
        batch_size: rows of an OT batch.
        rows: pairs looked at for each candidate, three times.
        probe_steps: of training each candidate's probe.
        seed: of everything.
        progress: show a bar; None: in terminals and notebooks.
    """
    c = check_conditioned(x1, "x1", c)
    check_count(probe_steps, "probe_steps")
    couplings = candidates(x1, c)
    options: Any = {"batch_size": batch_size, "rows": rows, "probe_steps": probe_steps}
    found = frontier(x1, c, couplings, **options, seed=seed, progress=progress)
    spread = between_within(x1, c, seed=seed)
    best, reason = _choose(found, spread)
    return Recommendation(best.name, couplings[best.name], reason, found, spread)


def candidates(x1: Tensor, c: Tensor) -> dict[str, Coupling]:
    """The couplings that `recommend` compares on these data.

    Weights of COT are multiples of the ratio of sample to condition variance, which makes both
    terms of the cost equal: 0.1, 1, 10 and 100 times. In many dimensions all conditions are about
    equally far apart, and the small weights are the useful ones.
    """
    labels = len(torch.unique(c, dim=0)) <= LABELS_UP_TO
    chosen: dict[str, Coupling] = {"independent": Independent(), "naive OT": MinibatchOT()}
    spread = float(c.var(dim=0).sum())
    if spread > 0:
        ratio = float(x1.var(dim=0).sum() + x1.shape[1]) / spread
        for factor in (0.1, 1) if labels else (0.1, 1, 10, 100):
            chosen[f"COT x {factor}"] = ConditionalOT(factor * ratio)
    if labels:
        chosen["COT per label"] = ConditionalOT(math.inf)
        chosen["stratified by label"] = StratifiedOT()
        return chosen
    for rows in (GOOD_STRATUM, 4 * GOOD_STRATUM):
        clusters = len(x1) * 3 // 4 // rows
        if clusters > 1:
            chosen[f"stratified, {rows} rows"] = StratifiedOT(clusters)
            chosen[f"residuals, {rows} rows"] = StratifiedOT(clusters, residual=True)
    return chosen


def _choose(found: Frontier, spread: BetweenWithin) -> tuple[FrontierPoint, str]:
    independent, naive = found["independent"], found["naive OT"]
    clean = [p for p in found if not p.flagged and p.name != "independent"]
    best = min(clean, key=lambda p: p.one_step_score, default=independent)
    facts = (
        f"{100 * spread.between_share:.0f} % of the variance of the data lies between conditions. "
        f"Naive OT {'skews' if naive.flagged else 'does not visibly skew'} the prior (statistic "
        f"{naive.skew:.2f}). In one step a small network trained on independent pairs scores "
        f"{independent.one_step_score:.3g} on held-out rows (energy score, small is good). "
    )
    if spread.within <= NARROW * spread.total:
        return independent, facts + (
            "Use independent pairs: given the condition the data hardly vary, so that no coupling "
            "has anything to straighten, and a regression would do as well."
        )
    gain, error = gain_over(best, independent)
    sure = beyond_chance(best, of=max(1, len(clean)))
    if gain <= max(sure * error, USEFUL * independent.one_step_score):
        return independent, facts + (
            "Use independent pairs: no coupling without significant skew is better by more than "
            f"chance and 1 % (the best, {best.name}, by {gain:.3g}, standard error {error:.2g}). "
            "Conditions have too few neighbours, the data too little spread within a condition, "
            "or the rows are too few to tell. More data or a coarser condition may change this."
        )
    reason = facts + (
        f"Use {best.name}: the same network scores {best.one_step_score:.3g}, better by "
        f"{gain:.3g} (standard error {error:.2g}), with no significant skew ({best.skew:.3f}) and "
        f"about {best.candidates:.0f} candidates for each noise row. "
    )
    gains = {p.name: gain_over(best, p) for p in clean if p is not best}
    close = [name for name, (gain, error) in gains.items() if gain <= sure * error]
    reason += f"Not to be told from it: {', '.join(close)}." if close else "All others score worse."
    if best.linear_skew is not None and best.linear_skew.flagged:
        reason += (
            f" A regression on the condition explains {100 * best.linear_skew.explained:.1f} % of "
            "its noise: where you can afford many evaluations, compare with independent pairs."
        )
    return best, reason


def gain_over(point: FrontierPoint, other: FrontierPoint) -> tuple[float, float]:
    """By how much a point scores better than another on the same rows, and the standard error.

    Both have scores: the frontier was asked for `probe_steps`.
    """
    gain: Any = other.scores - point.scores  # type: ignore[operator]
    return float(gain.mean()), float(gain.std()) / math.sqrt(len(gain))


def beyond_chance(point: FrontierPoint, *, of: int) -> float:
    """Standard errors that the best of so many points reaches by luck with probability `CHANCE`.

    Student's quantile for the rows of the point's scores, the level divided by the number of
    points.
    """
    rows = len(point.scores)  # type: ignore[arg-type]
    from scipy import stats  # late: it takes a second

    return float(stats.t.ppf(1 - CHANCE / of, max(1, rows - 1)))
