"""The challenge: a coupling of one's own, at a fixed network and budget, on four tasks.

Every task is drawn from a seed (flat ones are turned and mirrored), so that nobody knows the data
that count. The score at 1, 2 and 4 evaluations is the energy score of held-out conditions divided
by its floor: that of the truth itself, or, on the robot, of independent pairs at 64 evaluations.
"""

from __future__ import annotations

import runpy
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import pandas as pd
import torch
from torch import Tensor

from cotlearn import validation
from cotlearn.couplings import ConditionalOT, Independent, MinibatchOT, StratifiedOT
from cotlearn.couplings.base import Coupling
from cotlearn.course.assets import find_data
from cotlearn.datasets import Dataset
from cotlearn.files import write_text
from cotlearn.flows import fit, integrate
from cotlearn.flows.networks import ResidualMLP
from cotlearn.metrics import energy_score
from cotlearn.mixtures import ConditionalGaussianMixture, moving_modes, petals, rotating_pair
from cotlearn.policies.windows import Windows
from cotlearn.randomness import generator_for
from cotlearn.robots.episodes import read

NFE = (1, 2, 4)
STEPS, BATCH, WIDTH, BLOCKS, RATE = 1500, 256, 96, 2, 2e-3  #: the same for everyone
ROWS, HELD_OUT, DRAWS, PRECISE = 8192, 1024, 8, 64
FLAT: dict[str, Callable[[], ConditionalGaussianMixture]] = {
    "petals": petals,
    "moving_modes": moving_modes,
    "rotating_pair": rotating_pair,
}
ROBOT = "arm-ring"
COURSE: dict[str, Callable[[], Coupling]] = {
    "independent": Independent,
    "minibatch_ot": MinibatchOT,
    "conditional_ot": ConditionalOT,
    "stratified": lambda: StratifiedOT(64),
}
_HIDDEN, _SCORED = 40, 41  #: purposes of random numbers


@dataclass(frozen=True)
class Task:
    """Rows to train on, conditions that are held out, the truth there, and the floor."""

    name: str
    data: Dataset
    c: Tensor
    truth: Tensor
    floor: float


@dataclass(frozen=True)
class Entry:
    """A coupling's row: `score` is the mean of `scores`, task and evaluations -> score / floor."""

    name: str
    scores: dict[tuple[str, int], float]
    seconds: float

    @property
    def score(self) -> float:
        """The mean; 1 is the floor, and less is better."""
        return sum(self.scores.values()) / len(self.scores)


def load(path: str | Path) -> Coupling:
    """The coupling named `coupling` in a Python file, which is run.

    Raises:
        FileNotFoundError: there is no such file.
        TypeError: it defines no coupling of this name.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"no file {path}")
    names = runpy.run_path(str(path))
    if not isinstance(found := names.get("coupling"), Coupling):
        raise TypeError(f"{path} must define `coupling`, a Coupling; got {found!r}")
    return found


@cache
def tasks(seed: int, *, steps: int = STEPS) -> tuple[Task, ...]:
    """The tasks of a seed; the robot's floor is trained, so they are kept."""
    return (*(_flat(name, seed) for name in FLAT), _robot(seed, steps))


def compete(name: str, make: Callable[[], Coupling], seed: int, *, steps: int = STEPS) -> Entry:
    """Train a fresh coupling on each task, and score it.

    Args:
        name: of the row.
        make: returns the coupling; it is called once for each task.
        seed: of the tasks.
        steps: gradient steps; the leaderboard's number for everything that counts.
    """
    validation.check_count(steps, "steps")
    scores, began = {}, time.perf_counter()
    for task in tasks(validation.check_seed(seed), steps=steps):
        network = trained(task.data, make(), steps)
        for nfe in NFE:
            scores[task.name, nfe] = scored(network, task.c, task.truth, nfe) / task.floor
    return Entry(name, scores, time.perf_counter() - began)


def trained(data: Dataset, coupling: Coupling, steps: int) -> Any:
    """The network of everyone, trained on these rows."""
    network = ResidualMLP(data.dim, data.condition_dim, width=WIDTH, blocks=BLOCKS, seed=0)
    options: dict[str, Any] = {"steps": steps, "batch_size": BATCH, "learning_rate": RATE}
    return fit(network, data, coupling, progress=False, **options).network


def scored(network: Any, c: Tensor, truth: Tensor, nfe: int) -> float:
    """The energy score of samples from the same noise for everyone."""
    noise = torch.randn(DRAWS, *truth.shape, generator=generator_for(0, 0, _SCORED))
    return energy_score(torch.stack([integrate(network, x, c, nfe=nfe).x1 for x in noise]), truth)


def _flat(name: str, seed: int) -> Task:
    mixture, rng = FLAT[name](), generator_for(seed, sorted(FLAT).index(name), _HIDDEN)
    turn = torch.linalg.qr(torch.randn(2, 2, generator=rng))[0]
    x1, c = mixture.sample(ROWS, rng)
    truth, held = mixture.sample(HELD_OUT, rng)
    draws = torch.stack([mixture.sample_given(held, rng) for _ in range(DRAWS)])
    floor = energy_score(draws @ turn, truth @ turn)
    return Task(name, Dataset(x1 @ turn, c, name=name), held, truth @ turn, floor)


def _robot(seed: int, steps: int) -> Task:
    """Paths of the arm's demonstrations; which of them are held out is drawn."""
    episodes = read(find_data("arm_ring_demos.npz"))
    order = torch.randperm(len(episodes), generator=generator_for(seed, 9, _HIDDEN)).tolist()
    held, kept = (
        episodes.select(order[: len(order) // 5]),
        episodes.select(order[len(order) // 5 :]),
    )
    shape: dict[str, Any] = {"observe": 1, "predict": 40, "knots": 10, "open_loop": True}
    windows = Windows.fit(kept, frame="goal", **shape)
    data, test = windows.dataset(kept), windows.dataset(held)
    assert test.c is not None
    network = trained(data, Independent(), steps)
    floor = scored(network, test.c, test.x1, PRECISE)
    return Task(ROBOT, data, test.c, test.x1, floor)


def add(entry: Entry, table: Path) -> pd.DataFrame:
    """Put an entry into a leaderboard, in the place of one of its name; the best comes first."""
    rows = pd.read_csv(table) if table.exists() else pd.DataFrame()
    row = {"coupling": entry.name, "score": entry.score}
    row |= {f"{task}, {nfe}": value for (task, nfe), value in entry.scores.items()}
    row["seconds"] = entry.seconds
    if len(rows):
        rows = rows[rows["coupling"] != entry.name]
    rows = pd.concat([rows, pd.DataFrame([row])]).sort_values("score", ignore_index=True)
    write_text(table, rows.round(4).to_csv(index=False))
    write_text(table.with_suffix(".html"), page(rows))
    return rows


def page(rows: pd.DataFrame) -> str:
    """The leaderboard as a page of its own; names are text, whatever they hold."""
    return jinja2.Template(_PAGE, autoescape=True).render(
        columns=list(rows.columns), rows=rows.values.tolist(), nfe=", ".join(map(str, NFE))
    )


_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Challenge: your own coupling</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { padding: .3rem .7rem; text-align: right; border-bottom: 1px solid #ccc; }
th:first-child, td:first-child { text-align: left; }
</style>
<h1>Challenge: your own coupling</h1>
<p>Energy score divided by its floor, at {{ nfe }} evaluations: 1 is the floor, less is better.</p>
<div style="overflow-x: auto"><table>
<tr>{% for name in columns %}<th>{{ name }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for value in row %}<td>
{{- value if value is string else "%.3f" % value }}</td>{% endfor %}</tr>
{% endfor %}</table></div></html>
"""
