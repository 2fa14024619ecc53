"""Wrong answers to the exercises of notebooks 13 and 14, words of their hints, right ones."""

import numpy as np
import torch

from cotlearn.metrics import paired_bootstrap


def end(x, t, r, a):
    return x * (torch.tensor(a) * (r - t)).exp()


def mean_velocity(x, t, r, a):
    return (end(x, t, r, a) - x) / (r - t)


def halves(first, second, t, s, r):
    return ((s - t) * first + (r - s) * second) / (r - t)


def near(distance, rows, h):
    return (-distance / h).softmax(dim=1) @ rows


def move(y, data, h, *, sign=1.0, power=1.0):
    pull = near(sign * torch.cdist(y, data) ** power, data, h)
    apart = torch.where(torch.eye(len(y)) > 0, torch.inf, sign * torch.cdist(y, y) ** power)
    return pull - near(apart, y, h)


def by_loops(y, data, h):
    moved = []
    for i in range(len(y)):
        rest = torch.cat([y[:i], y[i + 1 :]])
        pull, push = (near(torch.cdist(y[i : i + 1], z), z, h) for z in (data, rest))
        moved.append((pull - push)[0])
    return torch.stack(moved)


MISTAKES = [
    ("13.mean_velocity", lambda x, t, r, a: a * x, "the velocity at t"),
    ("13.mean_velocity", lambda x, t, r, a: (r - t) * mean_velocity(x, t, r, a), "divide it by"),
    ("13.mean_velocity", end, "subtract x"),
    ("13.mean_velocity", lambda x, t, r, a: r * mean_velocity(x, 0, r, a) / (r - t), "starts at t"),
    ("13.mean_velocity", lambda x, t, r, a: a * (x + end(x, t, r, a)) / 2, "mean of both ends"),
    ("13.mean_velocity", lambda x, t, r, a: mean_velocity(x, t, 3 * t, a), "expected"),
    ("13.mean_velocity", lambda x, t, r, a: x.mean(), "shape"),
    ("13.mean_velocity", 2.0, "expected a function"),
    ("13.halves", lambda a, b, t, s, r: (a + b) / 2, "not equally long"),
    ("13.halves", lambda a, b, t, s, r: (s - t) * a + (r - s) * b, "the whole time"),
    ("13.halves", lambda a, b, t, s, r: halves(b, a, t, s, r), "the second r - s"),
    ("13.halves", lambda a, b, t, s, r: halves(a, b, t, s, 1), "ends at r"),
    ("13.halves", lambda a, b, t, s, r: (r - t) / r * halves(a, b, t, s, r), "by the end r"),
    ("13.halves", lambda a, b, t, s, r: a + b, "expected"),
    (
        "13.drift",
        lambda y, x, h: near(torch.cdist(y, x), x, h) - near(torch.cdist(y, y), y, h),
        "itself",
    ),
    ("13.drift", lambda y, x, h: near(torch.cdist(y, x), x, h) - y, "not the sample"),
    ("13.drift", lambda y, x, h: -move(y, x, h), "data minus samples"),
    ("13.drift", lambda y, x, h: move(y, x, h, sign=-1.0), "a minus before"),
    ("13.drift", lambda y, x, h: (x.mean(0) - y.mean(0)).expand(len(y), 2), "by their nearness"),
    ("13.drift", lambda y, x, h: move(y, x, 1.0), "divide the distances by h"),
    ("13.drift", lambda y, x, h: move(y, x, h, power=2.0), "not its square"),
    ("13.drift", lambda y, x, h: near(torch.cdist(y, x), x, h), "subtract that of"),
    ("13.drift", lambda y, x, h: 2 * move(y, x, h), "expected"),
    ("13.drift", lambda y, x, h: y.mean(), "shape"),
    ("13.drift", 2.0, "expected a function"),
]

RIGHT = [("13.mean_velocity", mean_velocity), ("13.halves", halves)]
RIGHT += [("13.drift", move), ("13.drift", by_loops)]


def look_up(c, seen, chunks):
    return chunks[torch.cdist(c, seen).argmin(dim=1)]


def farthest(c, seen, chunks):
    return chunks[torch.cdist(c, seen).argmax(dim=1)]


def of_file(c, seen, chunks):
    return chunks[torch.cdist(c, seen).argmin(dim=0).remainder(len(c))][: len(c)]


def one_by_one(c, seen, chunks):
    return torch.stack([chunks[(seen - one).square().sum(dim=1).argmin()] for one in c])


def interval(ours, theirs, *, networks=True, episodes=True, paired=True, draws=2000, seed=3):
    rng, (m, n) = np.random.default_rng(seed), ours.shape
    means = []
    for _ in range(draws):
        rows = rng.integers(m, size=m) if networks else slice(None)
        columns = rng.integers(n, size=n) if episodes else slice(None)
        one = ours[rows][:, columns]
        if not paired:
            rows, columns = rng.integers(m, size=m), rng.integers(n, size=n)
        means.append(one.mean() - theirs[rows][:, columns].mean())
    return np.quantile(means, [0.025, 0.975])


def with_library(ours, theirs):
    return paired_bootstrap(ours, theirs)[1:]


def smaller(left):
    share = left.double().mean(dim=1)
    return torch.minimum(share, 1 - share)


def balance(left):
    return float(smaller(left).mean())


def pooled(left):
    share = float(left.double().mean())
    return min(share, 1 - share)


MISTAKES += [
    ("14.look_up", farthest, "farthest"),
    ("14.look_up", of_file, "for each new one"),
    ("14.look_up", lambda c, seen, chunks: chunks[(c @ seen.T).argmax(dim=1)], "inner products"),
    ("14.look_up", lambda c, seen, chunks: chunks.mean(0).expand(len(c), -1), "not the mean"),
    ("14.look_up", lambda c, seen, chunks: torch.cdist(c, seen).argmin(dim=1), "shape"),
    ("14.look_up", 5, "expected a function"),
    ("14.interval", lambda a, b: interval(a, b, networks=False), "draws episodes alone"),
    ("14.interval", lambda a, b: interval(a, b, episodes=False), "draws networks alone"),
    ("14.interval", lambda a, b: interval(a, b, paired=False), "draw them once for both"),
    ("14.interval", lambda a, b: interval(b, a), "ours minus theirs"),
    ("14.interval", lambda a, b: interval(a, b)[::-1], "the lower end comes first"),
    ("14.interval", lambda a, b: np.quantile(a - b, [0.025, 0.975]), "the mean in each draw"),
    ("14.interval", lambda a, b: (a - b).mean(), "must have shape"),
    ("14.interval", lambda a, b: 2 * interval(a, b), "expected about"),
    ("14.interval", lambda a, b: (a.sort(axis=1), interval(a, b))[1], "changed its inputs"),
    ("14.interval", 5, "expected a function"),
    ("14.balance", pooled, "would look balanced"),
    ("14.balance", lambda left: 1 - balance(left), "the more frequent way"),
    ("14.balance", lambda left: float(left.double().mean()), "that goes left"),
    ("14.balance", lambda left: float(smaller(left).min()), "the smallest fork"),
    ("14.balance", lambda left: 0.5, "expected"),
    ("14.balance", 0.4, "expected a function"),
]

RIGHT += [
    ("14.look_up", look_up),
    ("14.look_up", one_by_one),
    ("14.interval", interval),
    ("14.interval", with_library),
    ("14.balance", balance),
    ("14.balance", lambda left: sum(min(r.sum(), (~r).sum()) / len(r) for r in left) / len(left)),
]
