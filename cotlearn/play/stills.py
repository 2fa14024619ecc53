"""What a page shows where no script runs: still pictures of its panels, as SVG, below 60 kB."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from cotlearn.couplings import ConditionalOT
from cotlearn.mixtures import petals
from cotlearn.play import film, networks
from cotlearn.plots.push_t import BLOCK, GOAL_AREA
from cotlearn.plots.style import CONDITION_COLORS, LOOKS
from cotlearn.policies.results import study
from cotlearn.robots.push_t.geometry import corners

SIDE = 400  #: of the square in which a picture has its coordinates
ROWS = 512
WEIGHT = 10.0  #: of the condition, beside naive OT
SHOWN = ("minibatch_ot", "residual")  #: robots, if the replays have them
EVERY = 8  #: steps between two outlines of the T
BARS = 8


class Still(NamedTuple):
    """A picture: its words, which are also its text for those who cannot see it, and the SVG."""

    words: str
    svg: str


def of_panel(name: str, shown: Mapping[str, Any]) -> list[Still]:
    """The still pictures of a panel, from what it shows; none for a task that cannot be drawn."""
    if name == "robots":
        return robots(shown["tasks"])
    return {"pairs": pairs, "samples": samples, "results": results}[name]()


def pairs() -> list[Still]:
    """The noise that each condition meets, by naive and by conditional OT."""
    generator = torch.Generator().manual_seed(0)
    x1, c = petals().sample(ROWS, generator)
    x0 = torch.randn(ROWS, 2, generator=generator)
    found = []
    for weight, words in ((0.0, "Naive OT"), (WEIGHT, f"Conditional OT, w = {WEIGHT:g}")):
        met = ConditionalOT(weight)(x0, x1, c, generator)
        assert met.c is not None
        title = f"{words}: the noise that each condition (a colour) met"
        found.append(Still(title, _square(_by_condition(met.x0, met.c, 3.3))))
    return found


def samples() -> list[Still]:
    """Samples at one evaluation, of networks trained with naive and with conditional pairs."""
    generator = torch.Generator().manual_seed(1)
    data = petals()
    truth, c = data.sample(ROWS, generator)
    x0 = torch.randn(ROWS, 2, generator=generator)
    limit = float(truth.abs().max()) + 0.3
    found = []
    for name, words in (("0", "naive OT"), (f"{WEIGHT:g}", f"conditional OT, w = {WEIGHT:g}")):
        network = networks.empty(data)
        parts = networks.shipped()["petals"][name]
        network.load_state_dict(dict(zip(network.state_dict(), parts, strict=True)))
        with torch.no_grad():
            drawn = x0 + network(torch.zeros(ROWS), x0, c)
        body = f'<g opacity="0.15">{_by_condition(truth, c, limit, 16)}</g>'
        title = f"One evaluation, trained with {words}: samples on the truth (faint)"
        found.append(Still(title, _square(body + _by_condition(drawn, c, limit))))
    return found


def robots(tasks: Mapping[str, Any]) -> list[Still]:
    """The T on its way, from faint to strong, in the first start of each policy."""
    if "push-t" not in tasks:
        return []
    scene, runs = tasks["push-t"]["scene"], tasks["push-t"]["runs"]
    found = []
    for name in [name for name in SHOWN if name in runs] or list(runs):
        nfe, run = next(iter(runs[name].items()))
        poses = film.unpacked(run, scene)[0, : run["steps"][0] + 1, 2:]
        poses = np.vstack([poses[:-1:EVERY], poses[-1:]])
        scale = SIDE / scene["size"]
        body = _area(corners(np.array(scene["goal"])) * scale, f'fill="{GOAL_AREA}"')
        for at, pose in enumerate(poses):
            look = f'fill="none" stroke="{BLOCK}" opacity="{(at + 2) / (len(poses) + 1):.2f}"'
            body += _area(corners(pose) * scale, f'{look} stroke-width="2"')
        label = LOOKS[name].label if name in LOOKS else name
        count = "1 evaluation" if nfe == "1" else f"{nfe} evaluations"
        title = f"{label}, {count}; {run['outcomes'][0]['words']}"
        found.append(Still(title, _square(body)))
    return found


def results() -> list[Still]:
    """Success of the best methods on Push-T at one evaluation, as bars."""
    rows = study(task="push-t", evaluations=1)
    best = rows[rows["course"] == 1].groupby("method")["success"].mean()
    bars = ""
    for at, (name, share) in enumerate(best.sort_values(ascending=False)[:BARS].items()):
        look = LOOKS[str(name)]
        y = 10 + at * (SIDE - 10) / BARS
        bars += f'<rect y="{y + 20:.0f}" width="{share * SIDE:.0f}" height="14" '
        bars += f'fill="{look.color}"/><text y="{y + 14:.0f}" font-size="15" fill="currentColor">'
        bars += f"{look.label}: {share:.0%}</text>"
    return [Still("Push-T, one evaluation: success of the best methods", _square(bars))]


def _by_condition(points: Tensor, c: Tensor, limit: float, width: int = 7) -> str:
    """Dots at points (n, 2), coloured by labels c (n, k); the square shows -limit to limit."""
    places = (points.double().numpy() * [1, -1] / limit + 1) * SIDE / 2
    labels = c.argmax(dim=1).numpy()
    parts = []
    for label in np.unique(labels):
        path = "".join(f"M{x:.0f} {y:.0f}h0" for x, y in places[labels == label])
        color = CONDITION_COLORS[label % len(CONDITION_COLORS)]
        parts.append(f'<path d="{path}" stroke="{color}" stroke-width="{width}"/>')
    return f'<g stroke-linecap="round">{"".join(parts)}</g>'


def _area(corner: ArrayLike, look: str) -> str:
    """A polygon with corners (n, 2)."""
    places: NDArray[np.float64] = np.asarray(corner, dtype=np.float64)
    return f'<polygon points="{" ".join(f"{x:.0f},{y:.0f}" for x, y in places)}" {look}/>'


def _square(body: str) -> str:
    return f'<svg viewBox="0 0 {SIDE} {SIDE}" aria-hidden="true">{body}</svg>'
