"""Typical wrong answers to homework 3, and words of the hint that each must get."""

import torch


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
