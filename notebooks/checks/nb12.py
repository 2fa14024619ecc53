"""The checks of notebook 12."""

import math
from typing import Any

import numpy as np
import torch

from cotlearn.course.checking import NotYet, exercise
from cotlearn.diagnostics import linear_skew

from .common import Case, Cases, call, number, table

ENOUGH = 134  #: rows, of which a quarter is held out


@table("12.decide")
def decide() -> Cases:
    """The best coupling without skew if it beats independent pairs by two standard errors."""
    for sure, gains, right in (
        (9.0, {"naive OT": 0.3, "COT": -0.1, "strata": 0.2}, "strata"),
        (9.0, {"naive OT": 0.3, "COT": 0.02, "strata": 0.05}, "strata"),
        (2.2, {"naive OT": 0.3, "COT": 0.02, "strata": -0.05}, "COT"),
        (2.2, {"naive OT": 3.0, "COT": -0.1, "strata": 0.2}, "strata"),
        (1.8, {"naive OT": 0.3, "COT": 0.02, "strata": -0.1}, "independent"),
        (1.8, {"naive OT": 3.0, "COT": 0.2, "strata": -0.1}, "independent"),
        (9.0, {"naive OT": 0.3, "COT": -0.2}, "independent"),
        (0.1, {"COT": 1e-300}, "independent"),  # equal scores: ahead by nothing
    ):
        yield _decision(gains, right, sure)


def _decision(gains: dict[str, float], right: str, sure: float) -> Case:
    """Scores whose best clean gain is `sure` standard errors; smaller gains are surer."""
    row = np.random.default_rng(12).gamma(4.0, 0.25, size=100)  # what every coupling finds hard
    clean = {name: gain for name, gain in gains.items() if name != "naive OT"}
    noise = 10 / sure / abs(max(clean.values())) * np.resize([1.0, -1.0], 100)
    scores = {k: row - gain + gain**2 * noise for k, gain in gains.items()} | {"independent": row}
    clean["independent"] = 0
    wrong: dict[str, Any] = {"naive OT is flagged: leave it out first": "naive OT"}
    if (worst := min(clean, key=clean.__getitem__)) not in (right, "independent"):
        wrong["small scores are good"] = worst
    for name in clean:
        if name != right and 0 < clean[name] < clean.get(right, 0):
            wrong[f"{name} is better than independent pairs, but {right} is better still"] = name
    if right == "independent":
        hint = f"the best is ahead by {sure} standard errors, not by two: stay with 'independent'"
        return Case((scores, {"naive OT"}), right, wrong, hint)
    hint = f"{right} is the best without a flag, and ahead by {sure} standard errors"
    wrong[f"{hint} of the differences row by row, std / sqrt(n)"] = "independent"
    return Case((scores, {"naive OT"}), right, wrong)


@exercise("12.own_data")
def own_data(answer: Any) -> None:
    """Two arrays with equally many rows that can be examined."""
    from cotlearn.report import from_arrays  # late: it takes a second

    pair = call(answer)
    if not isinstance(pair, tuple | list) or len(pair) != 2:
        raise NotYet(f"return two arrays, x1 and c, got {type(pair).__name__}")
    try:
        rows = from_arrays(*pair)
    except (TypeError, ValueError) as error:
        raise NotYet(str(error)) from None
    assert rows.data.c is not None
    x1, c = rows.data.x1.numpy(), rows.data.c.numpy()
    if len(x1) < ENOUGH:
        raise NotYet(f"that is {len(x1)} rows; the trial needs {ENOUGH}")
    if not x1.std(axis=0).any():
        raise NotYet("x1 does not vary: there is nothing to generate")
    if not c.std(axis=0).any():
        raise NotYet("c is the same in all rows: it tells nothing")
    told = [(i, j) for i, a in enumerate(x1.T) for j, b in enumerate(c.T) if _is_line(a, b)]
    if told:
        i, j = told[0]
        raise NotYet(f"column {j} of c tells column {i} of x1: generate what is not known")


def _is_line(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether one column is the other in another unit."""
    return bool(a.std() and b.std() and abs(np.corrcoef(a, b)[0, 1]) > 1 - 1e-6)


@table("12.episodes_needed", seed=12)
def episodes_needed(g: torch.Generator) -> Cases:
    """How many paired episodes make two standard errors of the difference at most a margin."""
    for n, flipped, margin in ((200, 0.3, 0.04), (600, 0.5, 0.1), (80, 0.2, 0.03)):
        theirs = (torch.rand(n, generator=g) < 0.6).double()
        ours = torch.where(torch.rand(n, generator=g) < flipped, 1 - theirs, theirs)
        ours[: n // 8] = 1.0
        a, b = ours.numpy(), theirs.numpy()
        exact = (2 * (a - b).std() / margin) ** 2
        apart = "take the standard deviation of the differences, ours - theirs"
        wrong = {
            "two standard errors, not one": math.ceil(exact / 4),
            f"{apart}: in the same episodes the two are not independent": (
                math.ceil(4 * (a.var() + b.var()) / margin**2)
            ),
            f"{apart}, not of ours alone": math.ceil(4 * a.var() / margin**2),
            f"{apart}: the mean of their squares, minus the square of their mean, is its square": (
                math.ceil(4 * np.square(a - b).mean() / margin**2)
            ),
            "the standard error falls with the root of n, so square": math.ceil(math.sqrt(exact)),
            "round up: an episode is played whole": math.floor(exact),
            "a whole number: round up": exact,
        }
        other = math.ceil((2 * (a - b).std(ddof=1) / margin) ** 2)
        hint = f"2 std(ours - theirs) / sqrt(n) must be at most {margin:g}: solve that for n"
        yield Case(
            (a, b, margin), math.ceil(exact), wrong, hint, also=(other,), read=number, tolerance=0
        )


@table("12.kept", seed=12)
def kept(g: torch.Generator) -> Cases:
    """The share of paired rows with the label of the row that they equal."""
    for n, wrong_rows in ((8, 0), (8, 2), (6, 6)):
        x1, y = torch.randn(n, 3, generator=g), torch.arange(n) % 3
        rows = torch.randperm(n, generator=g)[: n - 1]
        labels = y[rows].clone()
        labels[:wrong_rows] = (labels[:wrong_rows] + 1) % 3
        right = float((labels == y[rows]).float().mean())
        wrong = {
            "rows are in another order: look each one up in x1": _same_places(y, labels),
            "that is the share of rows that lost their label": 1 - right,
            "return the share, not the number": float((labels == y[rows]).sum()),
        }
        yield Case((x1, y, x1[rows], labels), right, wrong, read=number, what="the share")


def _same_places(y: torch.Tensor, labels: torch.Tensor) -> float:
    return float((y[: len(labels)] == labels).float().mean())


@table("12.diagnosis", seed=12)
def diagnosis(g: torch.Generator) -> Cases:
    """What the condition tells of noise and data, by two thresholds."""
    c = torch.eye(4)[torch.randint(4, (2048,), generator=g)]
    x1 = 2 * c + torch.randn(2048, 4, generator=g)
    plain, most = float(linear_skew(x1, c).explained), 0.1
    x0, order = torch.randn(2048, 4, generator=g), torch.randperm(2048, generator=g)
    some = torch.where(torch.arange(2048) < 600, order.sort().indices, torch.arange(2048))
    told = x0 + 0.5 * c - 0.125
    near = x0 + 0.25 * c - 0.0625
    for pairs, limit, right in (
        ((told, x1, c), most, "skew"),
        ((x0, x1, c), most, "nothing"),
        ((x0, x1[order], c), most, "labels"),
        ((x0, x1[some], c), most, "labels"),
        ((told, x1[some], c), most, "both"),
        ((near, x1, c), most, "nothing"),
        ((near, x1, c), most / 5, "skew"),
        ((x0[order], x1[order], c[order]), most, "nothing"),
    ):
        noise, data = (float(linear_skew(x, pairs[2]).explained) for x in pairs[:2])
        words = f"{4 * noise:.2f} columns of the noise are told (most: {limit:g}), and {data:.0%} "
        hint = f"{words}of the data ({plain:.0%} without a plan): {right!r}"
        yield Case((*pairs, plain, limit), right, {}, hint)
