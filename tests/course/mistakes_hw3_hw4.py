"""Wrong answers to the exercises of homework 3 and 4, words of their hints, right ones."""

import numpy as np
import torch

from cotlearn.robots.push_t import GOAL


def root(cov):
    values, vectors = torch.linalg.eigh(cov)
    return vectors @ torch.diag(values.sqrt()) @ vectors.T


def newton(gradient, hessian, x, t, *, steps=30, sign=-1, keep=None):
    keep = 1 - t if keep is None else keep
    z, one = x, torch.eye(x.shape[1], dtype=x.dtype)
    for _ in range(steps):
        residual = keep * z + t * gradient(z) - x
        z = z + sign * torch.linalg.solve(keep * one + t * hessian(z), residual)
    return z


def start(invert, x0, x1, t):
    return invert((1 - t) * x0 + t * x1, t)


def field(gradient, *given):
    return gradient(start(*given)) - start(*given)


def off(gradient, invert, x0, x1, t, *, sign=1):
    return field(gradient, invert, x0, x1, t) - sign * (x1 - x0)


MISTAKES = [
    ("hw3.gaussian_map", lambda m, s, x: m + x @ torch.linalg.cholesky(s).T, "symmetric root"),
    ("hw3.gaussian_map", lambda m, s, x: m + x @ torch.linalg.cholesky(s), "not symmetric"),
    ("hw3.gaussian_map", lambda m, s, x: m + x @ s, "take the root of S"),
    ("hw3.gaussian_map", lambda m, s, x: x @ root(s), "mean is missing"),
    ("hw3.gaussian_map", lambda m, s, x: m + x @ s.sqrt(), "root of each entry"),
    ("hw3.gaussian_map", lambda m, s, x: m + x * s.diagonal().sqrt(), "use all of S"),
    ("hw3.gaussian_map", lambda m, s, x: (m + x) @ root(s), "added after the root"),
    ("hw3.gaussian_map", lambda m, s, x: m + root(s) @ x, "raised RuntimeError"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, 1 - t), "are swapped"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, t, steps=1), "one Newton step"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, t, steps=2), "take more steps"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, t, steps=3), "take more steps"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, 1.0), "(1 - t) z is missing"),
    ("hw3.invert", lambda g, h, x, t: newton(g, h, x, t, sign=1, steps=4), "sign of the step"),
    ("hw3.invert", lambda g, h, x, t: (1 - t) * x + t * g(x), "goes forward, from z to x"),
    ("hw3.invert", lambda g, h, x, t: g(x), "goes forward; the z"),
    ("hw3.invert", lambda g, h, x, t: x, "that is x itself"),
    ("hw3.ofm_loss", lambda g, *a: (start(*a) - a[1]).square().sum(1), "divided by t²"),
    ("hw3.ofm_loss", lambda g, i, a, b, t: (g(a) - b).square().sum(1), "not that of x0"),
    ("hw3.ofm_loss", lambda *a: off(*a, sign=-1).square().sum(1), "not x0 - x1"),
    (
        "hw3.ofm_loss",
        lambda g, i, a, b, t: off(g, i, b, a, t, sign=-1).square().sum(1),
        "ends are swapped",
    ),
    ("hw3.ofm_loss", lambda *a: off(*a).square().mean(1), "do not average"),
    ("hw3.ofm_loss", lambda *a: off(*a).square().mean(), "each row"),
    ("hw3.ofm_loss", lambda *a: off(*a).square().sum(1) / 2, "no 1/2"),
    ("hw3.ofm_loss", lambda *a: off(*a).square().sum(1).detach(), "no gradient reaches"),
    ("hw3.ofm_loss", torch.no_grad()(lambda *a: off(*a).square().sum(1)), "drop no_grad"),
    (
        "hw3.ofm_loss",
        lambda g, *a: off(lambda z: g(z).detach(), *a).square().sum(1),
        "no gradient reaches the potential",
    ),
    ("hw3.ofm_loss", lambda *a: off(*a).norm(dim=1), "its square"),
    ("hw3.l2_uvp", lambda f, t, s: (f - t).square().sum(1).mean() / s.trace(), "in percent"),
    ("hw3.l2_uvp", lambda f, t, s: 100 * (f - t).square().mean() / s.trace(), "mean over rows"),
    ("hw3.l2_uvp", lambda f, t, s: 100 * (f - t).square().sum(1).mean(), "by the variance"),
    ("hw3.l2_uvp", lambda f, t, s: 100 * (f - t).square().sum() / s.trace(), "not the total"),
    ("hw3.l2_uvp", lambda f, t, s: 100 * (f - t).norm(dim=1).mean() / s.trace(), "square the"),
    ("hw3.l2_uvp", lambda f, t, s: 100 * (f - t).square().sum(1) / s.trace(), "one number"),
]


def turned(points, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def seen(states, goal, *, turn=1, angle=1, about=None, agent=True):
    delta = GOAL[2] - goal[2]
    about = goal[:2] if about is None else about
    shift = np.array(about) + np.array(GOAL[:2]) - goal[:2]
    hand = turned(states[..., :2] - about, turn * delta) + shift
    place = turned(states[..., 2:4] - about, turn * delta) + shift
    hand = hand if agent else states[..., :2]
    return np.concatenate([hand, place, states[..., 4:] + angle * delta], axis=-1)


def back(actions, goal, *, turn=-1, begin=GOAL[:2], end=None):
    return turned(actions - begin, turn * (GOAL[2] - goal[2])) + (goal[:2] if end is None else end)


def near(paths, centre, *, clamp=True, least=1e-9):
    a, way = paths[:, :-1], np.diff(paths, axis=1)
    with np.errstate(all="ignore"):  # of an agent that rests
        share = ((centre - a) * way).sum(-1) / np.maximum((way**2).sum(-1), least)
    share = share.clip(0, 1) if clamp else share
    return np.linalg.norm(a + share[..., None] * way - centre, axis=-1)


def corners(paths, centre):
    return np.linalg.norm(paths - centre, axis=-1)


MISTAKES += [
    ("hw4.retarget", lambda s, g: s, "nothing has moved"),
    ("hw4.retarget", lambda s, g: seen(s, g, turn=0), "not turned"),
    ("hw4.retarget", lambda s, g: seen(s, g, turn=-1, angle=-1), "wrong way"),
    ("hw4.retarget", lambda s, g: seen(s, g, turn=-1), "the places turn"),
    ("hw4.retarget", lambda s, g: seen(s, g, angle=0), "the T's own angle"),
    ("hw4.retarget", lambda s, g: seen(s, g, angle=-1), "do not subtract"),
    ("hw4.retarget", lambda s, g: seen(s, g, about=(0, 0)), "turn about the goal"),
    ("hw4.retarget", lambda s, g: seen(s, g, agent=False), "the agent moves too"),
    ("hw4.retarget", lambda s, g: seen(s, g)[..., :4], "must have shape"),
    ("hw4.give_back", lambda a, g: a, "nothing has moved"),
    ("hw4.give_back", back, "cut to [0, 512]"),
    ("hw4.give_back", lambda a, g: back(a, g, turn=1).clip(0, 512), "turn back by minus"),
    ("hw4.give_back", lambda a, g: seen(a[..., [0, 1, 0, 1, 0]], g)[..., :2], "its inverse"),
    ("hw4.give_back", lambda a, g: (a - GOAL[:2] + g[:2]).clip(0, 512), "not turned back"),
    ("hw4.give_back", lambda a, g: back(a, g, begin=g[:2], end=GOAL[:2]).clip(0, 512), "swapped"),
    ("hw4.clearance", lambda p, q: corners(p, q).min(1), "between"),
    ("hw4.clearance", lambda p, q: near(p, q, clamp=False).min(1), "a segment ends"),
    ("hw4.clearance", lambda p, q: corners(p, q)[:, -1], "last point"),
    ("hw4.clearance", lambda p, q: near(p, q).min(1) ** 2, "squared"),
    ("hw4.clearance", lambda p, q: near(p, q), "must have shape"),
    ("hw4.clearance", lambda p, q: near(p, q).min(), "must have shape"),
    ("hw4.clearance", lambda p, q: near(p, q, least=0).min(1), "not all values are finite"),
    ("hw4.choose", lambda v, n: int(np.argmax(v)), "would do"),
    ("hw4.choose", lambda v, n: 0, "too close"),
    ("hw4.choose", lambda v, n: float(v[v >= n][0]) if (v >= n).any() else 0.0, "not its"),
    ("hw4.choose", lambda v, n: int(np.argmax(v >= n)), "clearest of them"),
    ("hw4.choose", lambda v, n: int(np.argmax(v > n) if (v > n).any() else v.argmax()), ">="),
    ("hw4.choose", lambda v, n: bool((v >= n).any()), "not True or False"),
]
