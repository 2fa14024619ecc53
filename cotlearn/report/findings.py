"""The contents of a report: the diagnosis, the recommendation, and trained models."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings import Coupling, Independent
from cotlearn.couplings.units import TamedStandardiser
from cotlearn.datasets import Dataset, Standardiser
from cotlearn.diagnostics import Recommendation, recommend
from cotlearn.flows import VelocityMLP, fit, integrate
from cotlearn.metrics import energy_scores
from cotlearn.report.model import FewStepModel
from cotlearn.report.sources import Rows
from cotlearn.validation import check_count, check_has, check_seed, counted

TRAININGS = ("independent", "recommended")  #: words in the names of their checkpoints
FEWEST, FEWEST_OUT = 100, 20  #: rows to train on, and held out
MOST = 20_000  #: rows that are trained on; more are left out at random
NFE = (1, 2, 4, 16)
IN_WORDS = {2: "two", 4: "four", 16: "sixteen"}
DRAWS, TEST_ROWS = 16, 1000  #: samples for each of so many held-out conditions
NETWORK = {"width": 128, "depth": 3}
BATCH = 256
NEAR = 0.01  #: scores that differ by less count as equal


@dataclass(frozen=True)
class Trial:
    """One coupling, trained and scored on held-out rows.

    Attributes:
        name: "independent", or the recommended coupling's name on the frontier.
        coupling: `Coupling.name`, for its colour.
        scores: (NFE, n) energy score of each held-out row in standard units; small is good.
        spread: (NFE,) variance of the samples of one condition, summed over columns, mean over
            conditions.
        drawn: (NFE, n, d) one sample for the condition of each held-out row, in standard units.
        model: what was trained.
    """

    name: str
    coupling: str
    scores: Tensor
    spread: Tensor
    drawn: Tensor
    model: FewStepModel

    def at(self, nfe: int) -> float:
        """The mean score at `nfe` evaluations."""
        return float(self.scores[NFE.index(nfe)].mean())


@dataclass(frozen=True)
class Findings:
    """The contents of the page.

    Attributes:
        rows: the data.
        train: training rows, standardised.
        test: held-out rows, standardised.
        advice: the result of `recommend`.
        trials: independent pairs, then the coupling of `advice` if it is another.
        settings: seed, steps and sizes; JSON-compatible.
    """

    rows: Rows
    train: Dataset
    test: Dataset
    advice: Recommendation
    trials: tuple[Trial, ...]
    settings: dict[str, Any]

    @property
    def chosen(self) -> Trial:
        """The recommended coupling's trial if one evaluation gained by it, else independent's."""
        gain, error = self.gain(1)
        return self.trials[-1 if gain > 2 * error else 0]

    @property
    def model(self) -> FewStepModel:
        """The model of the chosen trial."""
        return self.chosen.model

    def gain(self, nfe: int) -> tuple[float, float]:
        """Independent's score less the recommended one's at `nfe`, and its standard error."""
        gain = (self.trials[0].scores - self.trials[-1].scores)[NFE.index(nfe)]
        return float(gain.mean()), float(gain.std()) / len(gain) ** 0.5

    @property
    def needed(self) -> int | None:
        """The evaluations with which independent pairs come within 1 % of what was chosen."""
        free, tried = self.trials[0], self.trials[-1]
        target = free.at(NFE[-1]) if self.chosen is free else tried.at(1)
        return next((n for n in NFE if free.at(n) <= target * (1 + NEAR)), None)

    @property
    def coupling(self) -> Coupling:
        """The coupling to use, without rows of these data."""
        return Independent() if self.chosen is self.trials[0] else self.advice.coupling

    def headline(self) -> str:
        """What one step becomes, the gain in percent, and the coupling to use."""
        free, tried = self.trials[0], self.trials[-1]
        gain, error = (100 * value / free.at(1) for value in self.gain(1))
        if tried is free:
            if self.advice.regression_wins:
                few = "Too few rows to learn how the data vary: take more, or fewer columns of c."
                rule = "Use a regression: given the condition the data hardly vary."
                return few if self.advice.too_few_rows else rule
            return "No gain shown: use independent pairs."
        ends = (f"{round(end, 1) + 0:.1f}" for end in (gain - 2 * error, gain + 2 * error))
        interval = f"(95 % interval {' to '.join(ends)})"
        if self.chosen is tried:
            steps = IN_WORDS.get(self.needed or 0)
            like = f"as good as {steps} with independent pairs, and " if steps else ""
            if not self.needed:
                like = f"better than {IN_WORDS[NFE[-1]]} with independent pairs, and "
            other = "one with them" if like else "with independent pairs"
            return (
                f"One step becomes {like}{gain:.1f} % better than {other} {interval}: "
                f"use {tried.name}{self._or_another()}."
            )
        found = f"{_signed(gain)} {interval}"
        word = "A loss" if gain < -2 * error else "No gain shown"
        return f"{word}, {found}, at one evaluation with {tried.name}: use independent pairs."

    def _or_another(self) -> str:
        """The couplings that were as good before the training, in brackets."""
        others = ", ".join(self.advice.within_chance)
        return f" (or, within chance as good: {others})" if others else ""

    def verdict(self) -> str:
        """One paragraph: what the trained models say about the recommendation."""
        free, tried = self.trials[0], self.trials[-1]
        needed = self.needed
        own = (
            f"Independent pairs have an error of {free.at(1):.3g} at one evaluation and of "
            f"{free.at(NFE[-1]):.3g} at {NFE[-1]}. In one step their samples "
            f"{_spread_in_words(free.spread[0] / self.advice.spread.within)}. "
        )
        if self.chosen is free:
            come = "s come" if needed != 1 else " comes"
            near = f"{needed} evaluation{come} within 1 % of {NFE[-1]}."
            own += "Fewer evaluations are worse by over 1 %." if needed == NFE[-1] else near
        if tried is free:
            return own
        probes = self.advice.frontier[tried.name], self.advice.frontier["independent"]
        foreseen = 100 - 100 * probes[0].one_step_score / probes[1].one_step_score
        gain, error = self.gain(1)
        first = f"Before the training a small test network foresaw {_signed(foreseen)} for "
        first += f"{tried.name}; the training "
        if abs(gain) > 2 * error:
            first += f"shows a {'gain, too' if gain > 0 else 'loss'}"
        else:
            least = 200 * error / free.at(1)
            first += f"shows neither gain nor loss: {len(self.test)} held-out rows show only "
            first += f"gains above {least:.1f} %"
        if self.chosen is tried:
            words = {None: f"do not reach that with {NFE[-1]}", 1: "reach that with one, too"}
            need = words.get(needed, f"come within 1 % of that with {needed}")
            own += (
                f"{tried.name} has {tried.at(1):.3g} at one; independent pairs {need}. Samples of "
            )
            spread = tried.spread[0] / self.advice.spread.within
            own += f"{tried.name} {_spread_in_words(spread)}."
        late, late_error = self.gain(NFE[-1])
        ahead = tried.name if late > 0 else "independent"
        better = f"{ahead} is better by {abs(late):.2g}"
        cost = better if abs(late) > 2 * late_error else "no difference shown"
        return f"{first}. {own} At {NFE[-1]} evaluations: {cost}."


def _signed(percent: float) -> str:
    """A gain in percent with its sign, never -0.0."""
    return f"{round(percent, 1) + 0:+.1f} %"


def _spread_in_words(share: Tensor) -> str:
    """What samples whose variance is this share of the data's have; infinite where those have none.

    The data's variance within a condition is estimated from above: what a regression leaves of it.
    """
    percent = 100 * float(share)
    if math.isinf(percent):
        return "vary within a condition, where the data do not"
    if percent < 100.5:
        return f"have about {percent:.0f} % of the variance within a condition that the data have"
    return (
        f"are spread more widely within a condition than the data: {percent:.0f} % of the variance"
    )


def split(rows: Rows, *, seed: int = 0) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Split rows by group: three quarters of the groups for training, the others held out.

    Raises:
        ValueError: too few rows or groups.
    """
    name, n, groups = rows.data.name, len(rows.data), int(rows.group.max()) + 1
    if groups < 4:
        raise ValueError(
            f"{name} has {counted(groups, 'group')}: at least 4 are needed to split; equal rows "
            "are in one, unless group is given"
        )
    rng = np.random.default_rng(check_seed(seed))
    out = np.isin(rows.group, rng.permutation(groups)[: groups // 4])
    inside, outside = (rng.permutation(np.flatnonzero(part)) for part in (~out, out))
    if len(inside) < FEWEST or len(outside) < FEWEST_OUT:
        whole = "" if groups < n else "; 134 rows are enough"
        raise ValueError(
            f"{name} has {n} rows, {len(inside)} to train on and {len(outside)} held out; "
            f"at least {FEWEST} and {FEWEST_OUT} are needed{whole}"
        )
    return inside[:MOST], outside[:TEST_ROWS]


def _scales_of(x1: Tensor, name: str) -> Standardiser:
    """The scales of x1 (n, d).

    Raises:
        ValueError: no column varies.
    """
    scales = Standardiser.fit(x1)
    if not scales.std.any():
        raise ValueError(f"{name}: x1 does not vary, there is nothing to learn")
    return scales


def examine(
    rows: Rows,
    *,
    steps: int = 2000,
    probe_steps: int = 500,
    pairs: int = 2048,
    seed: int = 0,
    checkpoints: Path | None = None,
    say: Callable[[str], object] = lambda text: None,
) -> Findings:
    """Diagnose the data, recommend a coupling, train with it and with independent pairs, score.

    Values of a condition that are far from all others, as -9999 for a missing one, are drawn near
    (`OwnUnits`): else the networks could not tell the others apart.

    Args:
        rows: of `read_data` or `from_arrays`; at least 100 to train on and 20 to hold out.
        steps: of each of the two trainings.
        probe_steps: as in `recommend`.
        pairs: rows of pairs that `recommend` looks at.
        seed: of everything.
        checkpoints: the beginning of a file name; trainings that were stopped resume from there.
        say: called with a sentence at the beginning of each stage.

    Raises:
        ValueError: too few rows, or data that do not vary.
    """
    seed = check_seed(seed)
    check_count(steps, "steps")
    check_has(rows, "rows", "rows, as read_data returns them", "data", "group")
    data = rows.data
    _scales_of(data.x1, data.name)  # before the split, in which equal rows are few groups
    inside, outside = split(rows, seed=seed)
    assert data.c is not None  # `Rows` have conditions
    if rows.labels and (unseen := (data.c[inside] == 0).all(dim=0)).any():
        names = [label for label, new in zip(rows.labels, unseen.tolist(), strict=True) if new]
        note = f"Held out alone, in groups of their own, and so never trained: {', '.join(names)}."
        rows = replace(rows, notes=(*rows.notes, note))
    x = _scales_of(data.x1[inside], data.name)
    c = TamedStandardiser.fit(data.c[inside])
    x1, condition = x(data.x1), c(data.c)
    train, test = (Dataset(x1[part], condition[part], data.name) for part in (inside, outside))
    options: dict[str, Any] = {"rows": pairs, "probe_steps": probe_steps, "seed": seed}
    say(f"tests and up to two trainings of {steps} steps: about {1 + steps // 2000} min")
    say(f"comparing couplings on {len(inside)} rows ...")
    advice = recommend(train.x1, condition[inside], groups=rows.group[inside], **options)
    couplings: dict[str, Coupling] = {"independent": Independent(), advice.name: advice.coupling}
    g = torch.Generator().manual_seed(seed)
    noise = torch.randn(DRAWS, *test.x1.shape, generator=g)  # the same for every network
    trials = []
    for name, coupling in couplings.items():
        about = {"coupling": repr(coupling), "data": rows.about, "network": NETWORK, "steps": steps}
        word = TRAININGS[name != "independent"]
        plain = VelocityMLP(train.dim, train.condition_dim, seed=seed, **NETWORK)
        file = checkpoints and f"{checkpoints}.{word}.training.safetensors"
        options = {"steps": steps, "batch_size": BATCH, "seed": seed}
        say(f"training with {name}, {steps} steps ...")
        network = fit(plain, train, coupling, **options, checkpoint=file).network
        say(f"testing it on {len(outside)} held-out rows ...")
        made = [torch.stack([integrate(network, z, test.c, nfe=n).x1 for z in noise]) for n in NFE]
        scores = torch.stack([energy_scores(drawn, test.x1) for drawn in made])
        spread = torch.stack([drawn.var(dim=0).sum(dim=1).mean() for drawn in made])
        first = torch.stack([drawn[0] for drawn in made])
        model = FewStepModel(network, x, c, about)
        trials.append(Trial(name, coupling.name, scores, spread, first, model))
    settings = {"seed": seed, "steps": steps, "probe_steps": probe_steps, "pairs": pairs}
    return Findings(rows, train, test, advice, tuple(trials), settings)
