"""The challenge: a coupling of one's own, at a fixed network and budget, on four tasks.

Every task is drawn from a seed (flat ones are turned and mirrored), so that nobody knows the data
that count. The score at 1, 2 and 4 evaluations is the energy score of held-out conditions divided
by its floor: that of the truth itself, or, on the robot, of independent pairs at 64 evaluations.
"""

from __future__ import annotations

import runpy
import time
import traceback
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
from cotlearn.files import reading, write_text
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
KEYS = ["coupling", "score", "seed", "steps"]  #: the first columns of a leaderboard
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
    seed: int
    steps: int

    @property
    def score(self) -> float:
        """The mean; 1 is the floor, and less is better."""
        return sum(self.scores.values()) / len(self.scores)


def load(path: str | Path) -> Coupling:
    """The coupling named `coupling` in a Python file, which is run.

    Raises:
        FileNotFoundError: there is no such file.
        TypeError: it defines no coupling of this name.
        ValueError: it does not run, with whatever error.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"no file {path}")
    try:
        names = runpy.run_path(str(path))
    except Exception as error:  # whatever a stranger's code raises
        why = f"{type(error).__name__}: {error}"
        own = " (an entry is one file)" if isinstance(error, ImportError) else ""
        raise ValueError(f"{_where(path, error)} does not run: {why}{own}") from error
    if not isinstance(found := names.get("coupling"), Coupling):
        raise TypeError(f"{path} must define `coupling`, a Coupling; got {found!r}")
    return found


def attempt(path: str | Path, seed: int) -> None:
    """Train the coupling of a file for one step on each task, to find what is wrong in seconds.

    Raises:
        FileNotFoundError: there is no such file.
        TypeError: it defines no coupling.
        ValueError: a step fails, with whatever error.
    """
    flat = {name: _flat(name, seed).data for name in FLAT}
    for task, data in {**flat, ROBOT: _paths(seed)[0]}.items():
        coupling = load(path)
        try:
            trained(data, coupling, 1)
        except Exception as error:  # whatever a stranger's code raises
            why = f"{type(error).__name__}: {error}"
            where = _where(path, error)
            raise ValueError(f"{where} fails on the first batch of {task}: {why}") from error


def _where(path: str | Path, error: Exception) -> str:
    """The file with the last of its lines that an error passed, if there is one."""
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(path)]
    return f"line {lines[-1]} of {path}" if lines else str(path)


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
    return Entry(name, scores, time.perf_counter() - began, seed, steps)


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


def _paths(seed: int) -> tuple[Dataset, Dataset]:
    """Paths of the arm's demonstrations, to train on and held out; which these are is drawn."""
    episodes = read(find_data("arm_ring_demos.npz"))
    order = torch.randperm(len(episodes), generator=generator_for(seed, 9, _HIDDEN)).tolist()
    held, kept = (
        episodes.select(order[: len(order) // 5]),
        episodes.select(order[len(order) // 5 :]),
    )
    shape: dict[str, Any] = {"observe": 1, "predict": 40, "knots": 10, "open_loop": True}
    windows = Windows.fit(kept, frame="goal", **shape)
    return windows.dataset(kept), windows.dataset(held)


def _robot(seed: int, steps: int) -> Task:
    data, test = _paths(seed)
    assert test.c is not None
    network = trained(data, Independent(), steps)
    floor = scored(network, test.c, test.x1, PRECISE)
    return Task(ROBOT, data, test.c, test.x1, floor)


def setting(rows: pd.DataFrame) -> tuple[int, int] | None:
    """The seed and the number of steps of a leaderboard; None if it has no rows yet."""
    return (int(rows["seed"][0]), int(rows["steps"][0])) if len(rows) else None


def leaderboard(out: Path) -> pd.DataFrame:
    """The rows of a leaderboard; none if there is no file.

    Raises:
        ValueError: it is no leaderboard, or holds rows of several seeds or numbers of steps.
    """
    if not out.exists():
        return pd.DataFrame(columns=KEYS)
    kinds: Any = dict(zip(KEYS, (str, float, int, int), strict=True))
    with reading(out, "no leaderboard"):  # "007" and "NA" are names
        rows = pd.read_csv(out, dtype=kinds, keep_default_na=False, na_values=[""])
    if list(rows.columns[: len(KEYS)]) != KEYS:
        found = ", ".join(map(str, rows.columns))
        wanted = f"whose first columns are {', '.join(KEYS)}"
        raise ValueError(f"out must be a new file or a leaderboard, {wanted}; {out} has {found}")
    for key in ("seed", "steps"):
        if len(values := sorted(set(rows[key]))) > 1:
            raise ValueError(f"out must be of one {key}, but {out} holds rows of {values}")
    return rows


def board(out: Path, seed: int, steps: int) -> pd.DataFrame:
    """The rows of a leaderboard that may get rows of this seed and this number of steps.

    Raises:
        ValueError: it holds another seed or another number of steps; and see `leaderboard`.
    """
    rows = leaderboard(out)
    there = setting(rows)
    if there is not None and there != (seed, steps):
        raise ValueError(
            f"out must be a new file or a leaderboard of seed {seed} and {steps} steps; "
            f"{out} is of seed {there[0]} and {there[1]} steps"
        )
    return rows


def add(entry: Entry, out: Path) -> pd.DataFrame:
    """Put an entry into a leaderboard, in the place of one of its name; the best comes first.

    Args:
        entry: a row.
        out: the table, a CSV file; the page of the same name lies beside it.

    Raises:
        ValueError: see `board`.
    """
    rows = board(out, entry.seed, entry.steps)
    row = dict(zip(KEYS, (entry.name, entry.score, entry.seed, entry.steps), strict=True))
    row |= {f"{task}, {nfe}": value for (task, nfe), value in entry.scores.items()}
    row["seconds"] = entry.seconds
    new = pd.DataFrame([row]).round(4)  # as those that are stored, so that equals are equal
    others = rows[rows["coupling"] != entry.name]
    rows = pd.concat([others, new]) if len(others) else new
    rows = rows.sort_values("score", ignore_index=True, kind="stable")
    write_text(out, rows.to_csv(index=False))
    write_page(rows, out)
    return rows


def write_page(rows: pd.DataFrame, out: Path) -> Path:
    """Write the page of a leaderboard beside its table, and return its path."""
    path = out.with_suffix(".html")
    write_text(path, page(rows))
    return path


def page(rows: pd.DataFrame) -> str:
    """The leaderboard as a page of its own; names are text, whatever they hold."""
    shown = rows.drop(columns=["seed", "steps"])
    return jinja2.Template(_PAGE, autoescape=True).render(
        seed=rows["seed"][0],
        steps=rows["steps"][0],
        columns=list(shown.columns),
        rows=shown.values.tolist(),
        nfe=", ".join(map(str, NFE)),
    )


_PAGE = """<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Challenge: your own coupling</title>
<style>
body { font: 16px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 70rem; padding: 0 1rem; }
table { border-collapse: collapse; }
th, td { padding: .3rem .7rem; text-align: right; border-bottom: 1px solid #ccc; }
th:first-child, td:first-child { text-align: left; }
</style>
<h1>Challenge: your own coupling (seed {{ seed }}, {{ steps }} steps)</h1>
<p>Energy score divided by its floor, at {{ nfe }} evaluations: 1 is the floor, less is better.</p>
<div style="overflow-x: auto"><table>
<tr>{% for name in columns %}<th>{{ name }}</th>{% endfor %}</tr>
{% for row in rows %}<tr>{% for value in row %}<td>
{{- value if value is string else "%.3f" % value }}</td>{% endfor %}</tr>
{% endfor %}</table></div></html>
"""
