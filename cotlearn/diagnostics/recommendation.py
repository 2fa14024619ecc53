"""Recommends a coupling for given data from the frontier, with the reason in words."""

import math
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Coupling, Independent, MinibatchOT, StratifiedOT
from cotlearn.couplings.unheeded import ruling_column
from cotlearn.couplings.units import OwnUnits
from cotlearn.diagnostics.frontier import Frontier, FrontierPoint, frontier
from cotlearn.diagnostics.groups import held_out, numbered
from cotlearn.diagnostics.probe import regression_scores
from cotlearn.diagnostics.skew import check_conditioned
from cotlearn.diagnostics.spread import BetweenWithin, between_within
from cotlearn.validation import check_count, check_seed

CHANCE = 0.025  #: probability that chance alone recommends a coupling, over all candidates
USEFUL = 0.01  #: least improvement, as a share of the score of independent pairs
MOST_ROWS = 20_000  #: rows that are compared; more would take minutes
NARROW = 0.02  #: share of variance within conditions below which there is nothing to straighten
LABELS_UP_TO = 64  #: most distinct conditions that are treated as labels
GOOD_STRATUM = 32  #: rows of a cluster that are enough candidates
WIDE = 0.3  #: share of the variance within a condition from which data do vary there
TOO_FEW = (
    "But the data may still vary within conditions, where a regression answers with "
    "means, which may lie between modes: the rows are too few to learn more. Take more of them, or "
    "fewer columns of c."
)
NARROW_DATA = (
    "Given the condition the data hardly vary, so that no coupling has anything to straighten. A "
    "flow that you train all the same should have independent pairs."
)
CONSTANT = (
    "The condition does not vary, so that naive OT is plain minibatch OT, without a condition, and "
    "has nothing to skew. "
)


@dataclass(frozen=True)
class Recommendation:
    """A recommended coupling, the reason and the evidence.

    Attributes:
        name: the coupling's name on the frontier.
        coupling: the coupling, ready for `fit`; independent pairs if a regression wins.
        reason: one paragraph.
        frontier: the points of all couplings.
        spread: variance between and within conditions.
        regression_score: mean energy score of a regression on the frontier's held-out rows.
        regression_wins: whether no coupling comes within chance of the regression.
    """

    name: str
    coupling: Coupling
    reason: str
    frontier: Frontier
    spread: BetweenWithin
    regression_score: float
    regression_wins: bool

    @property
    def within_chance(self) -> list[str]:
        """The couplings that cannot be told from the recommended one: another seed may name them.

        Empty if independent pairs are recommended.
        """
        best = self.frontier[self.name]
        return [] if best.name == "independent" else _close_to(best, self.frontier)

    @property
    def too_few_rows(self) -> bool:
        """Whether a regression wins though 30 % of the variance or more may lie within c."""
        return self.regression_wins and self.spread.between_share < 1 - WIDE


def recommend(
    x1: Tensor,
    c: Tensor,
    *,
    groups: Any = None,
    probe_steps: int = 500,
    seed: int = 0,
    **options: Any,
) -> Recommendation:
    """Pick a coupling and its weight for data x1 (N, d) with conditions c (N, k).

    Candidates are independent pairs, naive OT, COT over a range of weights, and stratified OT with
    and without residuals (if c does not vary, only the first two, and the reason says so);
    candidates with significant skew are excluded. So is everything if a regression of x1 on c
    scores better, by as much: then use that. Where it explains 98 % of the variance, nothing is
    left to straighten: use independent pairs. Else the winner is the one whose probe (see
    `one_step_scores`) has the best energy score on held-out rows, if it beats the probe of
    independent pairs by 1 % and by more than chance; otherwise it is independent pairs.
    Chance is the margin that the best candidate reaches in one of 40 trials when none is better
    (Bonferroni): 2.8 standard errors for ten candidates.

    Of more than 20,000 rows, so many are drawn and compared, with as many rows in a cluster as the
    recommended coupling then has.

    Distances are measured from x1 to standard normal noise, so scale x1 to about unit variance.

    Args:
        x1: (N, d), the training data, N at least 100.
        c: (N, k), conditions; standardise them, or `combine` several, first.
        groups: (N,), rows with the same value are held out together. Rows of one episode repeat one
            another: give their episode, else what is read off them counts as known.
        probe_steps: gradient steps of each candidate's probe.
        seed: of the held-out rows, the pairs and the probes.
        options: more of `frontier`: batch_size, rows, repetitions, progress.

    Raises:
        ValueError: too few rows, or an option out of range.
    """
    c = check_conditioned(x1, "x1", c)
    check_count(probe_steps, "probe_steps")
    couplings = candidates(x1, c)
    group = numbered(groups, len(x1))
    if len(x1) > MOST_ROWS:
        rng = torch.Generator().manual_seed(seed := check_seed(seed))
        rows = torch.randperm(len(x1), generator=rng)[:MOST_ROWS]
        x1, c, group = x1[rows], c[rows], numbered(group[rows], MOST_ROWS)
    tried = candidates(x1, c)
    tried = {name: tried[name] for name in couplings if name in tried}
    options |= {"groups": group, "seed": seed}
    found = frontier(x1, c, tried, probe_steps=probe_steps, **options)
    spread = between_within(x1, c, groups=group, seed=seed)
    train, test = held_out(x1, c, seed, group)
    alone = regression_scores(train, test, steps=probe_steps, seed=seed)
    best, wins, reason = _choose(found, spread, alone)
    reason = reason if _varies(c) else CONSTANT + reason
    score = float(alone.mean())
    return Recommendation(best.name, couplings[best.name], reason, found, spread, score, wins)


def candidates(x1: Tensor, c: Tensor) -> dict[str, Coupling]:
    """The couplings, by name, that `recommend` compares on data x1 (N, d) with conditions c (N, k).

    COT's weights are 0.1, 1, 10 and 100 times the ratio of sample to condition variance, at which
    the condition's term of random pairs is twice the sample's (labels: 0.1 and 1 times). In many
    dimensions all conditions are about equally far apart, and the small weights are useful.
    If one column of c has nearly all of its variance, or a few rows lie far from all others, COT
    sees the columns in units of their own (`OwnUnits`).
    If c does not vary, no coupling can look at it: independent pairs and naive OT are left.
    """
    if not _varies(c):
        return {"independent": Independent(), "naive OT": MinibatchOT()}
    labels = len(torch.unique(c, dim=0)) <= LABELS_UP_TO
    chosen: dict[str, Coupling] = {"independent": Independent(), "naive OT": MinibatchOT()}
    units = OwnUnits.fit(c)
    even = ruling_column(c) is None and units.tamed(c) is c
    seen = None if even else units  # else one column, or a few rows, would be all of the cost
    spread = float((c if seen is None else seen(c)).double().var(dim=0).sum())
    if spread > 0:
        ratio = float(x1.double().var(dim=0).sum() + x1.shape[1]) / spread
        for factor in (0.1, 1) if labels else (0.1, 1, 10, 100):
            chosen[f"COT x {factor}"] = ConditionalOT(factor * ratio, condition=seen)
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


def _varies(c: Tensor) -> bool:
    return bool((c != c[0]).any())


def _close_to(best: FrontierPoint, found: Frontier) -> list[str]:
    """The names of the unskewed points whose probe scores within chance of the best."""
    clean = [p for p in found if not p.flagged and p.name != "independent"]
    sure = beyond_chance(found["independent"], of=max(1, len(clean)))
    gains = {p.name: gain_over(best, p) for p in clean if p.name != best.name}
    return [name for name, (gain, error) in gains.items() if gain <= sure * error]


def _choose(
    found: Frontier, spread: BetweenWithin, alone: Tensor
) -> tuple[FrontierPoint, bool, str]:
    """The point to use, whether a regression wins, which scored `alone` (n,), and the reason."""
    independent, naive = found["independent"], found["naive OT"]
    clean = [p for p in found if not p.flagged and p.name != "independent"]
    best = min(clean, key=lambda p: p.one_step_score, default=independent)
    facts = (
        f"At least {min(99, 100 * spread.between_share):.0f} % of the variance of the data lies "
        "between conditions. "
        f"Naive OT {'skews' if naive.flagged else 'does not visibly skew'} the prior (statistic "
        f"{naive.skew:.2f}). In one step a small network trained on independent pairs scores "
        f"{independent.one_step_score:.3g} on held-out rows (energy score, small is good). "
    )
    ahead = min((best, independent), key=lambda p: p.one_step_score)
    behind, error = _gain(ahead.scores, alone)
    sure = beyond_chance(independent, of=max(1, len(clean)))
    if behind > max(sure * error, USEFUL * ahead.one_step_score):
        facts += (
            f"Use a regression: its predictions score {float(alone.mean()):.3g}, better than every "
            f"coupling without significant skew (the best, {ahead.name}, "
            f"{ahead.one_step_score:.3g}). "
        )
        facts += TOO_FEW if spread.between_share < 1 - WIDE else NARROW_DATA
        return independent, True, facts
    if spread.within <= NARROW * spread.total:
        facts += (
            "Use independent pairs: given the condition the data hardly vary, so that no coupling "
            "has anything to straighten, and a regression would do about as well (its predictions "
            f"score {float(alone.mean()):.3g})."
        )
        return independent, False, facts
    gain, error = gain_over(best, independent)
    if gain <= max(sure * error, USEFUL * independent.one_step_score):
        facts += (
            "Use independent pairs: no coupling without significant skew is better by more than "
            f"chance and 1 % (the best, {best.name}, by {gain:.3g}, standard error {error:.2g}). "
            "Conditions have too few neighbours, the data too little spread within a condition, "
            "or the rows are too few to tell. More data or a coarser condition may change this. "
            "What helps one evaluation without near conditions: to train a second flow on pairs of "
            "the first (reflow), or mean velocities (MeanFlow, a shortcut model)."
        )
        return independent, False, facts
    reason = facts + (
        f"Use {best.name}: the same network scores {best.one_step_score:.3g}, better by "
        f"{gain:.3g} (standard error {error:.2g}), with no significant skew ({best.skew:.3f}). "
    )
    close = _close_to(best, found)
    alike = f"Within chance of it: {', '.join(close)}."
    reason += alike if close else "All others without significant skew score worse."
    skewed = [p.name for p in found if p.flagged and p.one_step_score < best.one_step_score]
    if skewed:
        reason += f" Left out for their skew, with a better score: {', '.join(skewed)}."
    if best.linear_skew is not None and best.linear_skew.flagged:
        reason += (
            f" A regression on the condition explains {100 * best.linear_skew.explained:.1f} % of "
            "its noise: where you can afford many evaluations, compare with independent pairs."
        )
    return best, False, reason


def gain_over(point: FrontierPoint, other: FrontierPoint) -> tuple[float, float]:
    """Mean improvement of a point's scores over another's on the same rows, and its standard error.

    Both points need `scores`, so the frontier must have been made with probe_steps above 0.
    """
    return _gain(other.scores, point.scores)


def _gain(before: Any, after: Any) -> tuple[float, float]:
    """Mean of before - after, two sets of scores (n,), and its standard error."""
    gain = before - after
    return float(gain.mean()), float(gain.std()) / math.sqrt(len(gain))


def beyond_chance(point: FrontierPoint, *, of: int) -> float:
    """Standard errors that the best of `of` points exceeds by chance with probability `CHANCE`.

    This is the quantile of Student's distribution for the point's number of scores, at the level
    `CHANCE` / `of`.
    """
    rows = len(point.scores)  # type: ignore[arg-type]
    from scipy import stats  # late: it takes a second

    return float(stats.t.ppf(1 - CHANCE / of, max(1, rows - 1)))
