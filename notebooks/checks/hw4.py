"""The checks of homework 4: a policy for a task with a twist."""

import functools
import math
from typing import Any

import numpy as np
from torch import Generator

from cotlearn.course.checking import NotYet
from cotlearn.robots.push_t import GOAL

from .common import Array, Case, Cases, array, number, table, turned

SIZE = 512.0


@table("hw4.retarget")
def retarget(g: Generator) -> Cases:
    """States after the rigid motion that moves the new goal to the usual one."""
    rng = np.random.default_rng(g.initial_seed())
    for goal in ((300.0, 220.0, math.pi / 4), (320.0, 230.0, -0.9), (256.0, 256.0, 2.0)):
        places = rng.uniform(60, 450, (4, 2, 4))
        states = np.concatenate([places, rng.uniform(-3, 3, (4, 2, 1))], axis=-1)
        seen = functools.partial(_retarget, states, goal)
        unturned = seen(turn=0)
        wrong = {
            "nothing has moved: the new goal must become the usual one": states,
            "moved and not turned: turn the places about the goal by GOAL[2] - goal[2]": unturned,
            "moved and not turned: the goal's angle differs, too": seen(turn=0, angle=0),
            "the places turn the wrong way: by GOAL[2] - goal[2]": seen(turn=-1),
            "turned by goal[2] - GOAL[2], the wrong way": seen(turn=-1, angle=-1),
            "the T's own angle turns with the rest: add GOAL[2] - goal[2] to it": seen(angle=0),
            "the T's angle turns as the places do: add, do not subtract": seen(angle=-1),
            "turn about the goal: subtract its place, turn, then add GOAL's": seen(about=(0, 0)),
            "turn about the new goal's place, not about the old one's": seen(about=GOAL[:2]),
            "the agent moves too: its two numbers are a place like the T's": seen(agent=False),
        }
        hint = "a T on the new goal must be seen on the usual one; try states = [[0, 0, *goal]]"
        on_a_circle = {words: _round(value) for words, value in wrong.items()}
        yield Case((states, goal), _round(seen()), on_a_circle, hint, read=_read_states)


def _retarget(
    states: Array,
    goal: Any,
    *,
    turn: float = 1,
    angle: float = 1,
    about: Any = None,
    agent: bool = True,
) -> Array:
    """States moved so that `goal` becomes the usual goal; the options reproduce mistakes."""
    difference = GOAL[2] - goal[2]
    middle = np.array(goal[:2] if about is None else about)
    to = middle + np.array(GOAL[:2]) - goal[:2]
    hand = turned(states[..., :2] - middle, turn * difference) + to
    place = turned(states[..., 2:4] - middle, turn * difference) + to
    if not agent:
        hand = states[..., :2]
    return np.concatenate([hand, place, states[..., 4:] + angle * difference], axis=-1)


def _read_states(value: Any) -> Array:
    return _round(array(value, (4, 2, 5), "the states"))


def _round(states: Array) -> Array:
    """Replaces angles by points on a circle, so that full turns make no difference."""
    angle = states[..., 4:]
    return np.concatenate([states[..., :4], 100 * np.cos(angle), 100 * np.sin(angle)], axis=-1)


@table("hw4.give_back")
def give_back(g: Generator) -> Cases:
    """Actions after the inverse motion, clipped to the world."""
    rng = np.random.default_rng(g.initial_seed())
    goal = (320.0, 230.0, -0.9)
    place, usual = np.array(goal[:2]), np.array(GOAL[:2])
    inside = usual + rng.uniform(-80, 80, (3, 4, 2))
    back = functools.partial(_give_back, inside, goal)
    swapped = back(1, place, usual)
    wrong = {
        "nothing has moved: the policy speaks of its own goal, not of the new one": inside,
        "that is retarget once more; what is needed is its inverse": back(-1, place, usual),
        "turn back by minus the angle of retarget": back(-1),
        "moved back, and not turned back: by goal[2] - GOAL[2]": back(0),
        "subtract GOAL's place, turn back, then add goal's: you have them swapped": swapped,
    }
    hint = "retarget, then give_back, must change nothing"
    yield Case((inside, goal), back(), wrong, hint, "the actions")

    corner = np.array([[[500.0, 8.0], [4.0, 500.0]]])
    cut = _give_back(corner, goal).clip(0, SIZE)
    hint = "an action outside the world must be cut to [0, 512]: use clip"
    yield Case((corner, goal), cut, {}, hint, "the actions")


def _give_back(
    actions: Array, goal: Any, turn: float = 1, begin: Any = GOAL[:2], end: Any = None
) -> Array:
    """Actions from the usual goal back to `goal`; the options reproduce mistakes."""
    end = goal[:2] if end is None else end
    return turned(actions - np.array(begin), turn * (goal[2] - GOAL[2])) + np.array(end)


@table("hw4.clearance")
def clearance(g: Generator) -> Cases:
    """The distance from a point to each of several polylines."""
    rng = np.random.default_rng(g.initial_seed())
    for _ in range(3):
        paths, centre = rng.uniform(0, 300, (6, 3, 2)), rng.uniform(100, 200, 2)
        right = _to_segments(paths, centre).min(1)
        points = _distance(paths, centre)
        middles = _distance((paths[:, :-1] + paths[:, 1:]) / 2, centre)
        lines = _to_segments(paths, centre, clamp=False).min(1)
        wrong = {
            "the path can pass close by *between* its points: measure to segments": points.min(1),
            "a segment ends: clip the share along it to [0, 1], or you measure to the line": lines,
            "that is the distance of the last point only": points[:, -1],
            "that is the squared distance": right**2,
            "the middle of a segment need not be its nearest point": middles.min(1),
            "the smallest distance is asked for, not the mean": points.mean(1),
        }
        hint = "it is not the smallest distance from centre to the segments"
        yield Case((paths, centre), right, wrong, hint, "the clearances")

    still = np.full((1, 3, 2), 100.0)
    what = "the clearance of a path that stands still"
    hint = "a path that stands still has segments of length 0: mind the division"
    yield Case((still, np.array([100.0, 130.0])), np.array([30.0]), {}, hint, what)


def _distance(points: Array, centre: Array) -> Array:
    return np.asarray(np.linalg.norm(points - centre, axis=-1))


def _to_segments(paths: Array, centre: Array, *, clamp: bool = True) -> Array:
    """The distance to each segment of each path, or to the line through it."""
    start, along = paths[:, :-1], np.diff(paths, axis=1)
    share = ((centre - start) * along).sum(-1) / np.maximum((along**2).sum(-1), 1e-12)
    if clamp:
        share = share.clip(0, 1)
    return _distance(start + share[..., None] * along, centre)


@table("hw4.choose")
def choose(g: Generator) -> Cases:
    """The first chunk with enough clearance; if there is none, the one with the most."""
    rng = np.random.default_rng(g.initial_seed())
    close = "that chunk comes too close: its clearance is below what is needed"
    for _ in range(4):
        values = np.array([10.0, 12.0, 60.0, 90.0, 45.0]) + rng.uniform(0, 5, 5)
        wrong = {
            "the clearest chunk is not what the policy would do: take the first clear enough": 3,
            close: lambda found: found in (0, 1),
            "return the place of the chunk, not its clearance": values.__contains__,
        }
        hint = "the first clearance of at least 40 is number 2 (from 0)"
        yield Case((values, 40.0), 2, wrong, hint, read=_place)
    values = np.array([10.0, 40.0, 60.0, 90.0]) + rng.integers(0, 5)
    hint = "at least means >=: a clearance that equals what is needed is enough"
    yield Case((values, values[1]), 1, {}, hint, read=_place)
    for none in (np.array([10.0, 25.0, 17.0]), np.array([31.0, 3.0, 8.0, 5.0])):
        hint = "where no chunk is clear enough, take the clearest of them"
        yield Case((none, 40.0), none.argmax(), {}, hint, read=_place)


def _place(found: Any) -> float:
    if isinstance(found, bool | np.bool_):
        raise NotYet("return a place in the list, not True or False")
    return number(found)
