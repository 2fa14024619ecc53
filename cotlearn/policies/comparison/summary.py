"""One file about all cells of a comparison: means, every seed, intervals, differences."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.metrics import paired_bootstrap, wilson_interval
from cotlearn.policies.comparison.cells import DEMONSTRATED
from cotlearn.policies.comparison.protocol import write_json
from cotlearn.policies.rollout import with_thresholds
from cotlearn.policies.training import METHODS
from cotlearn.robots.registry import find_task
from cotlearn.robots.task import Array

REFERENCE = ("independent", "euler-16")  #: what all others are compared to

Cell = dict[str, Any]


def summarise(
    folder: str | Path, path: str | Path, *, command: str | None = None
) -> dict[str, Any]:
    """Writes one file about all cells of a folder: means, every seed, intervals, comparisons.

    Args:
        folder: of the cells.
        path: the file to write.
        command: that made the cells; `cotlearn bench` and the task if None.

    Returns:
        What was written.

    Raises:
        ValueError: there is no cell, or they were made with different protocols.
    """
    files = sorted(Path(folder).glob("*-*.json"))
    cells = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    if not cells:
        raise ValueError(f"{folder} holds no cells yet: run cotlearn bench")
    for file, cell in zip(files, cells, strict=True):
        if cell["protocol"] != cells[0]["protocol"]:
            raise ValueError(f"{file} was made with another protocol than {files[0]}")
    rows = [_row(cells, method, name) for method in METHODS for name in _names(cells, method)]
    if any((row["method"], row["sampler"]) == REFERENCE for row in rows):
        for row in rows:
            row["against_reference"] = _compare(cells, row["method"], row["sampler"])
    trained = {
        method: _training([cell for cell in cells if cell["method"] == method])
        for method in METHODS
        if _names(cells, method)
    }
    name = cells[0]["protocol"]["task"]
    summary = {
        "question": f"{name}: how good are policies of each coupling at few evaluations?",
        "command": command or f"cotlearn bench {name}",
        "protocol": cells[0]["protocol"],
        "reference": dict(zip(("method", "sampler"), REFERENCE, strict=True)),
        "demonstrations": _demonstrations(Path(folder) / DEMONSTRATED),
        "rows": rows,
        "training": trained,
        **{key: cells[0][key] for key in ("versions", "machine")},
    }
    write_json(Path(path), summary)
    return summary


def _demonstrations(path: Path) -> dict[str, Any]:
    """How many ways the demonstrator has, to compare "mode_entropy" of the rows to."""
    if not path.is_file():
        return {}
    return {"mode_entropy": json.loads(path.read_text(encoding="utf-8"))["mode_entropy"]}


def _names(cells: list[Cell], method: str) -> list[str]:
    mine = [cell for cell in cells if cell["method"] == method]
    return list(mine[0]["samplers"]) if mine else []


def _scores(cells: list[Cell], method: str, sampler: str) -> dict[int, Any]:
    """seed -> what this cell says of this sampler."""
    mine = [cell for cell in cells if cell["method"] == method]
    return {cell["seed"]: cell["samplers"][sampler] for cell in mine}


def _outcomes(cells: list[Cell], method: str, sampler: str) -> dict[str, dict[int, Array]]:
    """outcome -> seed -> (episodes,)."""
    task = find_task(cells[0]["protocol"]["task"])
    result: dict[str, dict[int, Array]] = {}
    for seed, score in _scores(cells, method, sampler).items():
        found = {name: np.array(values) for name, values in score["outcomes"].items()}
        for name, values in with_thresholds(task, found).items():
            result.setdefault(name, {})[seed] = values
    return result


def _row(cells: list[Cell], method: str, sampler: str) -> dict[str, Any]:
    """Means, the value of every seed, and intervals.

    Wilson's for the successes of one network, a bootstrap over seeds and episodes for the mean.
    """
    scores = _scores(cells, method, sampler)
    nfe = next(iter(scores.values()))["nfe"]
    row: dict[str, Any] = {"method": method, "sampler": sampler, "nfe": nfe, "seeds": list(scores)}
    for name, of_seed in _outcomes(cells, method, sampler).items():
        values = np.array(list(of_seed.values()))
        row[name], *interval = paired_bootstrap(values, np.zeros_like(values))
        row[f"{name}_interval"] = interval
        row[f"{name}_of_seeds"] = values.mean(axis=1).round(4).tolist()
        if np.isin(values, (0, 1)).all():
            row[f"{name}_wilson"] = [wilson_interval(int(v.sum()), len(v)) for v in values]
    for name in ("energy_score", "mode_entropy", "latency_ms"):
        each = [score[name] for score in scores.values()]
        row[name], row[f"{name}_of_seeds"] = float(np.mean(each)), each
    for name in ("steps", "jerk"):
        row[name] = float(np.mean([score["summary"][name] for score in scores.values()]))
    return row


def _compare(cells: list[Cell], method: str, sampler: str) -> dict[str, Any] | None:
    """Differences to the reference over the seeds that both have, paired by seed and episode."""
    mine, theirs = _outcomes(cells, method, sampler), _outcomes(cells, *REFERENCE)
    shared = sorted(set(_scores(cells, method, sampler)) & set(_scores(cells, *REFERENCE)))
    if not shared:
        return None
    differences: dict[str, Any] = {}
    for name in mine:
        first, second = (np.array([one[name][k] for k in shared]) for one in (mine, theirs))
        differences[name] = paired_bootstrap(first, second)
    return {"seeds": shared, **differences}


def _training(cells: list[Cell]) -> dict[str, Any]:
    each = [cell["training"] for cell in cells]
    chosen = next((cell["chosen"] for cell in cells if "chosen" in cell), None)
    return {
        "seconds": [round(one["seconds"], 1) for one in each],
        "cpu_seconds_of_last_run": [round(one["cpu_seconds_of_last_run"], 1) for one in each],
        "parameters": each[0]["parameters"],
        **({} if chosen is None else {"chosen": chosen}),
    }
