"""The checks of notebook 14."""

from typing import Any

import numpy as np
import torch

from cotlearn.course.checking import NotYet, exercise

from .common import Array, Case, Cases, array, call, table

TAILS = 0.025, 0.975


@table("14.look_up")
def look_up(g: torch.Generator) -> Cases:
    """The chunk of the nearest condition on file."""
    for m, n, k in ((4, 9, 3), (1, 6, 2)):
        c, seen = torch.randn(m, k, generator=g), torch.randn(n, k, generator=g)
        chunks = torch.randn(n, 5, generator=g)
        far = torch.cdist(c, seen)
        product = c @ seen.T
        of_file = far.argmin(dim=0).remainder(m)
        wrong = {
            "those are the chunks of the farthest conditions": chunks[far.argmax(dim=1)],
            "look for the nearest of the conditions on file, for each new one": chunks[of_file][:m],
            "compare conditions by distance, not by inner products": chunks[product.argmax(1)],
            "a look-up returns one chunk on file, not the mean of all": chunks.mean(0).expand(m, 5),
        }
        yield Case((c, seen, chunks), chunks[far.argmin(dim=1)], wrong, what="the chunks")


@exercise("14.interval")
def interval(answer: Any) -> None:
    """The 95 % interval of a mean difference: networks and episodes are drawn anew, both."""
    rng = np.random.default_rng(14)
    for networks, n, spread in ((3, 40, 0.02), (4, 120, 0.25)):  # episodes count more, networks do
        able = 0.5 + spread * np.linspace(-1, 1, networks)[:, None]
        hard = rng.uniform(-0.6, 0.6, n)
        ours = (rng.random((networks, n)) < able + hard).astype(float)
        theirs = (rng.random((networks, n)) < 0.4 + hard).astype(float)
        given = ours.copy(), theirs.copy()
        low, high = array(call(answer, *given), (2,), "the interval")
        if not (np.array_equal(given[0], ours) and np.array_equal(given[1], theirs)):
            raise NotYet("the answer changed its inputs: work on a copy")
        _judge(float(low), float(high), ours, theirs)


def _judge(low: float, high: float, ours: Array, theirs: Array) -> None:
    apart = ours - theirs
    wanted = _ends(apart)
    width, middle = wanted[1] - wanted[0], apart.mean()
    if abs(low - wanted[0]) < 0.12 * width and abs(high - wanted[1]) < 0.12 * width:
        return
    if low > high:
        raise NotYet("the lower end comes first")
    if abs(low + wanted[1]) < 0.12 * width and abs(high + wanted[0]) < 0.12 * width:
        raise NotYet("take ours minus theirs, not theirs minus ours")
    own = np.subtract(*(_ends(x) for x in (ours, theirs)))
    kinds = {
        "that draws episodes alone: draw the networks anew, too": _ends(apart, networks=False),
        "that draws networks alone: draw the episodes anew, too": _ends(apart, episodes=False),
        "that is where single differences lie: take the mean in each draw": np.quantile(
            apart, TAILS
        ),
        "both methods have the same episodes: draw them once for both": middle
        + np.array([-0.5, 0.5]) * np.hypot(*(np.diff(_ends(x))[0] for x in (ours, theirs))),
        "take the quantiles of the differences, not differences of quantiles": own,
    }
    for hint, (left, right) in kinds.items():
        if abs(low - left) < 0.06 * width and abs(high - right) < 0.06 * width:
            raise NotYet(hint)
    got = f"got {low:.3f} to {high:.3f}, expected about {wanted[0]:.3f} to {wanted[1]:.3f}"
    raise NotYet(f"{got}: the 2.5 % and 97.5 % quantiles of 2,000 means")


def _ends(apart: Array, *, networks: bool = True, episodes: bool = True) -> Array:
    """The ends of a bootstrap interval of the mean (m, n)."""
    rng, (m, n), means = np.random.default_rng(0), apart.shape, []
    for _ in range(4000):
        rows = rng.integers(m, size=m) if networks else np.arange(m)
        columns = rng.integers(n, size=n) if episodes else np.arange(n)
        means.append(apart[np.ix_(rows, columns)].mean())
    return np.quantile(means, TAILS)


@table("14.balance")
def balance(g: torch.Generator) -> Cases:
    """The mean over forks of the share of episodes that take the rarer way there."""
    for forks, draws in ((2, 8), (5, 12)):
        left = torch.rand(forks, draws, generator=g) < torch.linspace(0.1, 0.9, forks)[:, None]
        share = left.double().mean(dim=1)
        rarer = torch.minimum(share, 1 - share)
        pooled = torch.minimum(share.mean(), 1 - share.mean())
        wrong = {
            "a policy that always goes left at one fork and right at the next would look balanced: "
            "take the rarer way at each fork, then the mean": pooled,
            "that is the share of the more frequent way": 1 - rarer.mean(),
            "that is the share that goes left": share.mean(),
            "that is the smallest fork: take the mean over forks": rarer.min(),
        }
        yield Case((left,), rarer.mean(), wrong)
