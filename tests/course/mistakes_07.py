"""Wrong answers to the exercises of notebook 07, words of their hints, right ones."""

import numpy as np


def turn(points, angle):
    cos, sin = np.cos(angle), np.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def entropy(p):
    p = p[p > 0]
    return -(p * np.log(p)).sum()


def naive(p):
    with np.errstate(all="ignore"):
        return np.exp(-(p * np.log(p)).sum())


MISTAKES = [
    ("07.perplexity", entropy, "exp of it"),
    ("07.perplexity", lambda p: np.exp(-entropy(p)), "minus sign"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / np.log(2)), "log2"),
    ("07.perplexity", lambda p: 2 ** entropy(p), "2 ** goes with log2"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / len(p)), "not its mean"),
    ("07.perplexity", lambda p: np.exp(entropy(p) / np.log(len(p))), "log k"),
    ("07.perplexity", naive, "leave the zeros out"),
    ("07.perplexity", lambda p: (p > 0).sum(), "rare ones"),
    ("07.perplexity", lambda p: 1 / (p**2).sum(), "another count"),
    ("07.perplexity", lambda p: np.exp(-np.log(p[p > 0]).sum()), "weighted by its p"),
    ("07.perplexity", lambda p: 7.0, "expected 2.2"),
    ("07.perplexity", lambda p: p, "one number"),
    ("07.perplexity", 2.0, "expected a function"),
    ("07.to_body", lambda x, pose: x - pose[:2], "not turned"),
    ("07.to_body", lambda x, pose: turn(x - pose[:2], pose[2]), "the wrong way"),
    ("07.to_body", lambda x, pose: turn(x, -pose[2]) - pose[:2], "then turn"),
    ("07.to_body", lambda x, pose: turn(x, -pose[2]), "place first"),
    ("07.to_body", lambda x, pose: turn(x, pose[2]) + pose[:2], "to the world"),
    ("07.to_body", lambda x, pose: turn(pose[:2] - x, -pose[2]), "point minus place"),
    ("07.to_body", lambda x, pose: x * 0 + 9, "expected [["),
    ("07.to_body", lambda x, pose: x[0], "shape (3, 2)"),
    ("07.to_body", lambda x, pose: "here", "array of points"),
    ("07.to_body", "here", "expected a function"),
]


RIGHT = [
    ("07.perplexity", lambda p: 2 ** -(p * np.log2(np.maximum(p, 1e-300))).sum()),
    ("07.to_body", lambda x, pose: turn(x - pose[:2], -pose[2])),
]
