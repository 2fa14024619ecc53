"""The checks of homework 4: a policy for a task with a twist."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from cotlearn.homework.checks.common import (
    Array,
    array,
    compare,
    expect_function,
    number,
)
from cotlearn.homework.registry import NotYet, exercise

GOAL = (256.0, 256.0, math.pi / 4)  #: of the task that the policy knows
SIZE = 512.0


def _turn(points: Array, angle: float) -> Array:
    cos, sin = math.cos(angle), math.sin(angle)
    return points @ np.array([[cos, sin], [-sin, cos]])


def _retarget(
    states: Array,
    goal: tuple[float, ...],
    *,
    turn: float = 1.0,
    about: tuple[float, float] | None = None,
    angle: float = 1.0,
    agent: bool = True,
) -> Array:
    """States seen so that `goal` is the usual goal, and with other options the mistakes in it."""
    d = GOAL[2] - goal[2]
    middle = np.array(goal[:2] if about is None else about)
    to = np.array(GOAL[:2]) if about is None else middle + np.array(GOAL[:2]) - goal[:2]
    place = _turn(states[..., 2:4] - middle, turn * d) + to
    hand = _turn(states[..., :2] - middle, turn * d) + to if agent else states[..., :2]
    return np.concatenate([hand, place, states[..., 4:] + angle * d], axis=-1)


def _round(states: Array) -> Array:
    """Angles as points of a circle: whole turns make no difference."""
    angle = states[..., 4:]
    return np.concatenate([states[..., :4], 100 * np.cos(angle), 100 * np.sin(angle)], axis=-1)


def _states(g: np.random.Generator, *shape: int) -> Array:
    places = g.uniform(60, 450, (*shape, 4))
    return np.concatenate([places, g.uniform(-3, 3, (*shape, 1))], axis=-1)


@exercise("hw4.retarget")
def retarget(answer: Any, seed: int = 0) -> None:
    """The rigid motion that brings a new goal to the usual one, applied to states."""
    expect_function(answer)
    g = np.random.default_rng(seed)
    for goal in ((300.0, 220.0, math.pi / 4), (320.0, 230.0, -0.9), (256.0, 256.0, 2.0)):
        states = _states(g, 4, 2)
        got = array(answer(states.copy(), goal), (4, 2, 5), "the states")
        right = _retarget(states, goal)
        shifted = states.copy()
        shifted[..., :4] += np.tile(np.array(GOAL[:2]) - goal[:2], 2)
        mistakes = [
            (states, "nothing has moved: the new goal must become the usual one"),
            (
                np.concatenate([shifted[..., :4], right[..., 4:]], axis=-1),
                "moved and not turned: turn the places about the goal by GOAL[2] - goal[2]",
            ),
            (shifted, "moved and not turned: the goal's angle differs, too"),
            (
                _retarget(states, goal, turn=-1.0),
                "the places turn the wrong way: by GOAL[2] - goal[2]",
            ),
            (
                _retarget(states, goal, turn=-1.0, angle=-1.0),
                "turned the wrong way: by GOAL[2] - goal[2], not goal[2] - GOAL[2]",
            ),
            (
                _retarget(states, goal, angle=0.0),
                "the T's own angle turns with the rest: add GOAL[2] - goal[2] to it",
            ),
            (
                _retarget(states, goal, angle=-1.0),
                "the T's angle turns as the places do: add GOAL[2] - goal[2], do not subtract",
            ),
            (
                _retarget(states, goal, about=(0.0, 0.0)),
                "turn about the goal: subtract goal's place, turn, then add GOAL's",
            ),
            (
                _retarget(states, goal, about=(GOAL[0], GOAL[1])),
                "turn about the new goal's place, not about the old one's",
            ),
            (
                _retarget(states, goal, agent=False),
                "the agent moves too: the first two numbers are a place like the next two",
            ),
        ]
        compare(
            _round(got),
            _round(right),
            [(_round(wrong), hint) for wrong, hint in mistakes],
            "a T that lies on the new goal must be seen on the usual one; try it with "
            "states = [[0, 0, *goal]]",
        )


def _back(actions: Array, goal: tuple[float, ...], *, turn: float = -1.0) -> Array:
    d = GOAL[2] - goal[2]
    return _turn(actions - np.array(GOAL[:2]), turn * d) + np.array(goal[:2])


@exercise("hw4.give_back")
def give_back(answer: Any, seed: int = 0) -> None:
    """The inverse motion, applied to actions, cut to the world."""
    expect_function(answer)
    g = np.random.default_rng(seed)
    goal = (320.0, 230.0, -0.9)
    inside = np.array(GOAL[:2]) + g.uniform(-80, 80, (3, 4, 2))
    got = array(answer(inside.copy(), goal), (3, 4, 2), "the actions")
    zeros = np.concatenate([inside, inside, np.zeros((3, 4, 1))], axis=-1)
    mistakes = [
        (inside, "nothing has moved: the policy speaks of its own goal, not of the new one"),
        (
            _retarget(zeros, goal)[..., :2],
            "that is the way in, once more; the way back is its inverse",
        ),
        (_back(inside, goal, turn=1.0), "turn back by minus the angle of the way in"),
        (
            inside - np.array(GOAL[:2]) + goal[:2],
            "moved back, and not turned back: by goal[2] - GOAL[2]",
        ),
        (
            _turn(inside - np.array(goal[:2]), goal[2] - GOAL[2]) + np.array(GOAL[:2]),
            "subtract GOAL's place, turn back, then add goal's: you have them swapped",
        ),
    ]
    compare(got, _back(inside, goal), mistakes, "retarget, then give_back, must change nothing")
    corner = np.array([[[500.0, 8.0], [4.0, 500.0]]])
    outside = array(answer(corner.copy(), goal), (1, 2, 2), "the actions")
    if not np.allclose(outside, _back(corner, goal).clip(0, SIZE)):
        raise NotYet("an action outside the world must be cut to [0, 512]: use clip")


def _clearance(paths: Array, centre: Array, *, clamp: bool = True) -> Array:
    a, b = paths[:, :-1], paths[:, 1:]
    along = b - a
    share = ((centre - a) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    share = share.clip(0, 1) if clamp else share
    near = a + share[..., None] * along
    return np.asarray(np.linalg.norm(near - centre, axis=-1).min(1))


@exercise("hw4.clearance")
def clearance(answer: Any, seed: int = 0) -> None:
    """The smallest distance from a point to each of several polylines."""
    expect_function(answer)
    g = np.random.default_rng(seed)
    for _ in range(3):
        paths, centre = g.uniform(0, 300, (6, 3, 2)), g.uniform(100, 200, 2)
        got = array(answer(paths.copy(), centre.copy()), (6,), "the clearances")
        right = _clearance(paths, centre)
        points = np.linalg.norm(paths - centre, axis=-1)
        mistakes = [
            (
                points.min(1),
                "the path can pass close by *between* its points: measure the distance to segments",
            ),
            (
                _clearance(paths, centre, clamp=False),
                "a segment ends: clip the share along it to [0, 1], or you measure to the line",
            ),
            (points[:, -1], "that is the distance of the last point only"),
            (right**2, "that is the squared distance"),
            (
                np.linalg.norm(
                    paths[:, :-1] + (paths[:, 1:] - paths[:, :-1]) / 2 - centre, axis=-1
                ).min(1),
                "the middle of a segment need not be its nearest point",
            ),
            (points.mean(1), "the smallest distance is asked for, not the mean"),
        ]
        compare(got, right, mistakes, "it is not the smallest distance from centre to the segments")
    still = np.full((1, 3, 2), 100.0)
    found = answer(still, np.array([100.0, 130.0]))
    if not np.allclose(array(found, (1,), "the clearance of a path that stands still"), 30):
        raise NotYet("a path that stands still has segments of length 0: mind the division")


@exercise("hw4.choose")
def choose(answer: Any, seed: int = 0) -> None:
    """The first chunk that is clear enough, else the clearest."""
    expect_function(answer)
    g = np.random.default_rng(seed)
    for _ in range(4):
        values = np.array([10.0, 12.0, 60.0, 90.0, 45.0]) + g.uniform(0, 5, 5)
        found = answer(values.copy(), 40.0)
        if isinstance(found, bool | np.bool_):
            raise NotYet("return a place in the list, not True or False")
        found = number(found)
        if found == 2:
            continue
        if found == 3:
            raise NotYet(
                "the clearest chunk is not what the policy would do: the first that is clear "
                "enough keeps its distribution"
            )
        if found in (0, 1):
            raise NotYet(f"chunk {found:g} comes too close: its clearance is below what is needed")
        if found in values:
            raise NotYet("return the place of the chunk, not its clearance")
        raise NotYet(f"the first clearance of at least 40 is number 2 (from 0), got {found:g}")
    for none in (np.array([10.0, 25.0, 17.0]), np.array([31.0, 3.0, 8.0, 5.0])):
        found = number(answer(none.copy(), 40.0))
        if found != none.argmax():
            raise NotYet("where no chunk is clear enough, take the clearest of them")
