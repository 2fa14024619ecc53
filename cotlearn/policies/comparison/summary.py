"""One file about all cells of a comparison: means, every seed, intervals, differences."""

from pathlib import Path
from typing import Any

import numpy as np

from cotlearn.metrics import paired_bootstrap, wilson_interval
from cotlearn.policies.comparison.cells import COOLED, DEMONSTRATED, read_record
from cotlearn.policies.methods import METHODS
from cotlearn.policies.rollout import with_derived
from cotlearn.results import read_json, write_json
from cotlearn.robots.registry import find_task

REFERENCE = ("independent", "euler-16")  #: what all others are compared to

Cells = dict[int, dict[str, Any]]  #: of one method, by seed


def summarise(folder: Path, path: Path, *, command: str) -> dict[str, Any]:
    """Writes one file about all cells of a folder: means, every seed, intervals, comparisons.

    Args:
        folder: of the cells.
        path: the file to write.
        command: that made the cells.

    Returns:
        What was written.

    Raises:
        ValueError: there is no cell, or they were made with different protocols.
    """
    files = {file: read_json(file, "protocol") for file in sorted(folder.glob("*-*.json"))}
    if not files:
        raise ValueError(f"{folder} holds no cells yet: run cotlearn bench")
    first = next(iter(files.values()))
    task = first["protocol"]["task"]
    for file, cell in files.items():
        if read_record(cell["protocol"]) != read_record(first["protocol"]):
            raise ValueError(f"{file} was made with another protocol than {next(iter(files))}")
        for found in cell["samplers"].values():
            arrays = {name: np.array(values) for name, values in found["outcomes"].items()}
            found["outcomes"] = with_derived(find_task(task), arrays)
    cells: dict[str, Cells] = {}
    for method in METHODS:
        if mine := [cell for cell in files.values() if cell["method"] == method]:
            cells[method] = {cell["seed"]: cell for cell in mine}
    rows = []
    for method, of_seed in cells.items():
        for name in next(iter(of_seed.values()))["samplers"]:
            row = _row(of_seed, method, name)
            if any(REFERENCE[1] in one["samplers"] for one in cells.get(REFERENCE[0], {}).values()):
                row["against_reference"] = _compare(of_seed, name, cells[REFERENCE[0]])
            rows.append(row)
    demonstrated = folder / DEMONSTRATED
    entropy = read_json(demonstrated)["mode_entropy"] if demonstrated.is_file() else None
    summary = {
        "question": f"{task}: how good are policies of each coupling at few evaluations?",
        "command": command,
        "protocol": first["protocol"],
        "reference": dict(zip(("method", "sampler"), REFERENCE, strict=True)),
        "demonstrations": {} if entropy is None else {"mode_entropy": entropy},
        "rows": rows,
        "training": {method: _training(list(mine.values())) for method, mine in cells.items()},
        **{key: first[key] for key in ("versions", "machine")},
    }
    write_json(path, summary)
    return summary


def _row(cells: Cells, method: str, sampler: str) -> dict[str, Any]:
    """Means, values of seeds, intervals: Wilson's of one network, bootstrapped of the mean."""
    scores = [cell["samplers"][sampler] for cell in cells.values()]
    row: dict[str, Any] = {"method": method, "sampler": sampler, "nfe": scores[0]["nfe"]}
    row["seeds"] = list(cells)
    for name in scores[0]["outcomes"]:
        values = np.array([score["outcomes"][name] for score in scores])
        row[name], *row[f"{name}_interval"] = paired_bootstrap(values, np.zeros_like(values))
        row[f"{name}_of_seeds"] = values.mean(axis=1).round(4).tolist()
        if np.isin(values, (0, 1)).all():
            row[f"{name}_wilson"] = [wilson_interval(int(v.sum()), len(v)) for v in values]
    for name in [name for name in ("execute", "temperature") if name in scores[0]]:
        row[f"{name}_of_seeds"] = [score[name] for score in scores]
    if "execute" in scores[0]:  # with own settings
        row["explored_of_seeds"] = [max(s["tried"]["temperature"].values())[0] for s in scores]
    for name in ("energy_score", "mode_entropy", "latency_ms"):
        each = [score[name] for score in scores]
        row[name], row[f"{name}_of_seeds"] = float(np.mean(each)), each
    means = [score["summary"] for score in scores]
    return row | {name: float(np.mean([one[name] for one in means])) for name in ("steps", "jerk")}


def _compare(cells: Cells, sampler: str, reference: Cells) -> dict[str, Any] | None:
    """Differences to the reference over the seeds that both have, paired by seed and episode.

    A sampler at its temperature is compared with the reference at its own.
    """
    shared = sorted(set(cells) & set(reference))
    if not shared:
        return None
    mine = [cells[seed]["samplers"][sampler]["outcomes"] for seed in shared]
    other = REFERENCE[1] + COOLED * sampler.endswith(COOLED)
    theirs = [reference[seed]["samplers"][other]["outcomes"] for seed in shared]
    differences: dict[str, Any] = {"seeds": shared}
    for name in mine[0]:
        first, second = (np.array([one[name] for one in each]) for each in (mine, theirs))
        differences[name] = paired_bootstrap(first, second)
    return differences


def _training(cells: list[dict[str, Any]]) -> dict[str, Any]:
    each = [cell["training"] for cell in cells]
    times = ("seconds", "cpu_seconds_of_last_run")
    found: dict[str, Any] = {name: [round(one[name], 1) for one in each] for name in times}
    found["parameters"] = each[0]["parameters"]
    chosen = [cell["chosen"] for cell in cells if "chosen" in cell]
    return {**found, "chosen": chosen[0]} if chosen else found
