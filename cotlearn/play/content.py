"""What the panels show, from the library and the files that are shipped."""

from __future__ import annotations

from typing import Any

import matplotlib.pyplot as plt
import torch
from matplotlib.colors import to_hex

from cotlearn.mixtures import spread_conditions
from cotlearn.play import networks
from cotlearn.play.packing import numbers
from cotlearn.plots import style
from cotlearn.plots.push_t import BLOCK, GOAL_AREA
from cotlearn.policies.results import study

TABLE = 257  #: conditions at which the means of a continuous mixture are listed, odd
SHADES = 33  #: of the colour map of numbers
#: Columns of `data/results/study.csv` that the panel *results* shows.
COLUMNS = (
    *("task", "regime", "method", "seed", "evaluations", "success", "coverage", "collision"),
    *("setting", "sampler", "actions", "temperature", "episodes", "latency_ms", "course"),
)
TITLES = {"petals": "petals", "moving_modes": "moving modes", "rotating_pair": "rotating pair"}


def common() -> dict[str, Any]:
    """What several panels need: the colours of the course, and the mixtures."""
    return {"style": colours(), "mixtures": {name: mixture(name) for name in networks.DATA}}


def colours() -> dict[str, Any]:
    """The colours of `cotlearn.plots.style`, for scripts."""
    colour_map = plt.get_cmap(style.CONDITION_MAP)
    return {
        "looks": {
            name: {"label": look.label, "color": look.color} for name, look in style.LOOKS.items()
        },
        "block": BLOCK,
        "goalArea": GOAL_AREA,
        "conditions": list(style.CONDITION_COLORS),
        "map": [to_hex(colour_map(i / (SHADES - 1))) for i in range(SHADES)],
    }


def mixture(name: str) -> dict[str, Any]:
    """A mixture as a table: the means (conditions, modes, 2) and the standard deviation.

    Conditions are the labels, or numbers from -1 to 1 that are evenly spaced, between which the
    browser interpolates.
    """
    data = networks.DATA[name]()
    labelled = len(data.conditions()) == data.condition_dim
    c = torch.eye(data.condition_dim) if labelled else ends_included(TABLE)
    parts = data.components(c)
    return {
        "title": TITLES[name],
        "labelled": labelled,
        "means": parts.means.double().numpy().round(5).tolist(),
        "std": round(float(parts.stds.flatten()[0]), 6),
    }


def ends_included(n: int) -> torch.Tensor:
    """n conditions evenly spaced from -1 to 1, both included, (n, 1)."""
    inner = spread_conditions(n)
    return inner * n / (n - 1)


def samples() -> dict[str, Any]:
    """The networks of the panel *samples*: their sizes, and weights in float32."""
    weights = {
        name: {
            coupling: numbers(torch.cat([part.flatten() for part in parts]))
            for coupling, parts in found.items()
        }
        for name, found in networks.shipped().items()
    }
    hidden = [networks.WIDTH] * networks.DEPTH
    sizes = {
        name: [1 + data.dim + data.condition_dim, *hidden, data.dim]
        for name, data in ((name, make()) for name, make in networks.DATA.items())
    }
    return {"networks": {"weights": weights, "sizes": sizes}}


def results() -> dict[str, Any]:
    """The table of the panel *results*, by columns; texts are numbers of a list of words."""
    rows = study()
    columns: dict[str, Any] = {}
    for name in COLUMNS:
        column = rows[name]
        if column.dtype.kind in "iuf":
            values = [None if value != value else value for value in column.tolist()]
            columns[name] = {"values": values}
        else:
            words = sorted(column.dropna().unique().tolist())
            place = {word: number for number, word in enumerate(words)}
            columns[name] = {"words": words, "values": [place.get(v, -1) for v in column]}
    return {"columns": columns}
