"""Typical wrong answers to homework 4, and words of the hint that each must get."""

import numpy as np

from cotlearn.robots.push_t import GOAL


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


MISTAKES = [
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
