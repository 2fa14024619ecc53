"""Figures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

from array_cases.base import X0, X1, C, N, add
from array_cases.robots import JOINTS, PATHS, PUSHES, SCENES, STARTS
from cotlearn import plots
from cotlearn.robots import arm

# A figure may show a gap where a number is missing, so of figures it is only asked that they say
# what is wrong where they cannot be drawn.


def _drawn(draw: Callable[..., Any]) -> Callable[..., None]:
    """The function without its figure."""

    def call(**arrays: Any) -> None:
        try:
            draw(**arrays)
        finally:
            plt.close("all")

    return call


_way = np.cumsum(np.random.default_rng(0).normal(size=(5, N, 2)), axis=0)
_square = np.linspace(0, 1, 4)
for _name, _draw, _arrays in (
    ("scatter", plots.scatter, {"x": X0, "c": C, "x0": X1}),
    ("pair_lines", plots.pair_lines, {"x0": X0, "x1": X1, "c": C}),
    ("paired_source", plots.paired_source, {"x0": X0, "c": C}),
    ("source_given_condition", plots.source_given_condition, {"x0": X0, "c": C}),
    ("trajectories", plots.trajectories, {"path": _way, "c": C}),
    ("velocity_field", plots.velocity_field, {"points": X0, "velocity": X1}),
    ("net", plots.net, {"knots": np.random.default_rng(0).normal(size=(4, 4, 2))}),
    ("outlines", plots.outlines, {"curves": _way, "c": C, "truth": _way}),
    (
        "contours",
        plots.contours,
        {"across": _square, "up": _square, "height": np.outer(_square, _square)},
    ),
    ("image_grid", plots.image_grid, {"images": np.random.default_rng(0).uniform(size=(5, 64))}),
    ("push_t_state", plots.push_t_state, {"state": SCENES[0]}),
    ("push_t_episode", plots.push_t_episode, {"states": SCENES}),
    ("push_t_chunks", plots.push_t_chunks, {"state": SCENES[0], "chunks": PUSHES}),
    (
        "arm_paths",
        lambda paths, state, modes: plots.arm_paths(paths, state, modes=modes, labels=("a", "b")),
        {"paths": PATHS, "state": STARTS[0], "modes": np.array([0, 1, 0])},
    ),
    (
        "arm_paths_3d",
        lambda paths, state: plots.arm_paths_3d(paths, state),
        {"paths": PATHS, "state": STARTS[0]},
    ),
    (
        "arm_pose",
        lambda points, state: plots.arm_pose(points, state),
        {"points": arm.skeleton(JOINTS)[0], "state": STARTS[0]},
    ),
    (
        "strata_heatmap",
        lambda values: plots.strata_heatmap(values, rows=[1, 2], columns=[1, 2, 3]),
        {"values": np.ones((2, 3))},
    ),
    (
        "curves",
        lambda x, values: plots.curves(x, {"a": values}, xlabel="x", ylabel="y"),
        {"x": _square, "values": _square},
    ),
    (
        "error_against_nfe",
        lambda nfe, errors: plots.error_against_nfe(nfe, {"independent": errors}),
        {"nfe": np.array([1, 2, 4]), "errors": np.array([0.3, 0.2, 0.1])},
    ),
    (
        "histogram",
        lambda values: plots.histogram({"independent": values}, xlabel="x"),
        {"values": _square},
    ),
    ("picture_grid", plots.picture_grid, {"pictures": np.full((5, 8, 8, 3), 100.0)}),
    ("film", plots.film, {"images": np.full((2, 8, 8, 3), 100, dtype=np.uint8)}),
    (
        "training_curves",
        lambda step, loss: plots.training_curves({"a": {"step": step, "loss": loss}}),
        {"step": _square, "loss": _square},
    ),
    (
        "beside_published",
        lambda ours: plots.beside_published({"independent": ours}, {"independent": 2.0}),
        {"ours": _square + 1},
    ),
    ("animate", lambda paths, c: plots.animate({"a": paths}, c, limit=1), {"paths": _way, "c": C}),
    (
        "push_t_animation",
        lambda episodes: plots.push_t_animation({"a": episodes}),
        {"episodes": SCENES},
    ),
):
    add(f"plots.{_name}", _drawn(_draw), bare=tuple(_arrays), **_arrays)
