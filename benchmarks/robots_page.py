"""Writes tables of own settings, other trainings and settled policies into two pages.

    python benchmarks/robots_page.py

reads data/results/own_settings_*.json and settled_*.json, and changes nothing else on the page of
the robots and on the how-to for choosing a policy.
"""

import re
from collections.abc import Iterable, Iterator
from itertools import groupby, product
from pathlib import Path
from typing import Any

from cells import RESULTS

from cotlearn.plots import label_of
from cotlearn.policies.comparison.stored import stored_comparison
from cotlearn.policies.methods import METHODS
from cotlearn.results import Values, read_json

DOCS = Path(__file__).resolve().parents[1] / "docs"
PAGE, HOW_TO = DOCS / "reference/one_step_on_robots.md", DOCS / "how_to/choose_a_policy.md"
#: Each task in words, and the table that counts the ways of its demonstrations.
TASKS = {
    "push_t": ("Push-T, planned", "push_t"),
    "push_t_pixels": ("Push-T from pixels", "push_t_pixels_data"),
    "push_t_human": ("Push-T, people", "push_t_human"),
    "arm_ring_receding": ("arm, planning again", "arm_ring_receding"),
}
#: What was settled after other trainings.
OTHERS = {
    "arm_ring_receding_12000": "arm, planning again, 12,000 steps",
    "arm_ring_receding_12000_rate_0.003_goal": "the same, goal's frame, rate .003",
}
#: What has another rate after twice the steps.
TRAINED = {name: words for name, (words, _) in TASKS.items()}
TRAINED["push_t_pixels_12000"] = "Push-T from pixels, 12,000 steps"
#: What a training can have another of, in that of the task: its files, and the columns.
LENGTHS = "steps", r"(_\d+)?", (0.25, 0.5, 1.0, 2.0)
RATES = "learning_rate", r"(_rate_[\d.]+)?", (1.0, 3.0)

#: Whole paths: what a network predicts, and its table; the names of other trainings end in these.
PATHS = {
    "between two rows": {"velocity": "arm_avoid", "path": "arm_avoid_data"},
    "past a pillar": {"velocity": "arm_ring", "path": "arm_ring_data"},
}
ENDINGS = "_3000", "", "_12000", "_rate_0.001", "_rate_0.003"

#: For the how-to: the training that most rows of a task have, and the names of all others.
OTHER = r"(_\d+)?(_rate_[\d.]+)?"
DEPLOYED = {
    "arm_ring_receding_rate_0.003_goal": rf"arm_ring_receding{OTHER}_goal",
    "push_t": rf"push_t{OTHER}",
    "push_t_human": rf"push_t_human{OTHER}",
    "push_t_pixels_12000": rf"push_t_pixels{OTHER}",
}
#: What another training has to gain on exploration starts to take the place of the usual one.
MARGIN = 0.03

#: The arm in the frame of the world, in that of the goal, and there with other trainings.
FRAMES = (
    *("", "_goal", "_12000_goal", "_3000_rate_0.003_goal"),
    *("_rate_0.003_goal", "_12000_rate_0.003_goal", "_rate_0.003_goal_velocity"),
)


def short(value: float, digits: int = 3) -> str:
    """A number in words: .95, and 1.00."""
    return f"{round(value, 6):.{digits}f}".removeprefix("0")


def listed(values: list[float]) -> str:
    """Values with commas between."""
    return ", ".join(f"{value:g}" for value in values)


def own_settings() -> Iterator[list[str]]:
    """Rows of the table of own settings."""
    for name, (task, counted) in TASKS.items():
        demonstrations = read_json(RESULTS / f"{counted}.json", "demonstrations")["demonstrations"]
        for (method, _), row in stored_comparison(f"own_settings_{name}").rows.items():
            strict = "success" if "success" in row else "success_95"
            low, high = (short(end, 2) for end in row[f"{strict}_interval"])
            yield [
                task,
                label_of(method),
                str(row["nfe"]),
                listed(row["execute_of_seeds"]),
                listed(row["temperature_of_seeds"]),
                f"{short(row[strict])} ({low} to {high})",
                ", ".join(short(each) for each in row[f"{strict}_of_seeds"]),
                short(row["coverage"], 2) if "coverage" in row else "",
                f"{row['mode_entropy'] / demonstrations['mode_entropy']:.0%}",
            ]


def trained(option: str, ending: str, columns: tuple[float, ...]) -> Iterator[list[str]]:
    """Rows of the table of trainings with another option; what exploration prefers is bold."""
    for name, task in TRAINED.items():
        usual, *others = (
            stored_comparison(path.stem)
            for path in sorted(RESULTS.glob(f"own_settings_{name}*.json"))
            if re.fullmatch(ending, path.stem.removeprefix(f"own_settings_{name}"))
        )
        of_task = usual.about["protocol"]["options"][option]
        tables = {
            round(table.about["protocol"]["options"][option] / of_task, 6): table.rows
            for table in (usual, *others)
        }
        for key, row in methods_of(tables.values()).items():
            found = {ratio: rows[key] for ratio, rows in tables.items() if key in rows}
            if set(found) != {1.0}:
                best = preferred(found) if len(found) > 1 else None
                cells = (told(found[k], bold=k == best) if k in found else "" for k in columns)
                yield [task, label_of(key[0]), str(row["nfe"]), *cells]


def methods_of(tables: Iterable[dict[Any, Values]]) -> dict[Any, Values]:
    """One row of each method and sampler that is in a table, in the order of the methods."""
    found = {key: row for rows in tables for key, row in rows.items()}
    return dict(sorted(found.items(), key=lambda item: list(METHODS).index(item[0][0])))


def frames() -> Iterator[list[str]]:
    """Rows of the table of the arm in the frame of the world and in that of the goal."""
    name = "arm_ring_receding"
    tables = [stored_comparison(f"own_settings_{name}{ending}").rows for ending in FRAMES]
    for key, row in methods_of(tables[1:]).items():
        cells = (told(rows[key], bold=False) if key in rows else "" for rows in tables)
        yield [label_of(key[0]), str(row["nfe"]), *cells]


def preferred(found: dict[float, Values]) -> float:
    """The ratio to the task's option with most successes, by networks that all have."""
    shared = set.intersection(*(set(row["seeds"]) for row in found.values()))

    return max(found, key=lambda ratio: explored([found[ratio]], shared))


def told(row: Values, *, bold: bool) -> str:
    """The successes of each network, and where there is one their mean coverage."""
    each = row["success_of_seeds" if "success" in row else "success_95_of_seeds"]
    covered = f" ({short(row['coverage'], 2)})" if "coverage" in row else ""
    return "**" * bold + ", ".join(short(value) for value in each) + "**" * bold + covered


def paths() -> Iterator[list[str]]:
    """Rows of the table of whole paths after other trainings."""
    for task, names in PATHS.items():
        for target, name in names.items():
            files = {ending: RESULTS / f"{name}{ending}.json" for ending in ENDINGS}
            tables = {k: stored_comparison(f.stem) for k, f in files.items() if f.is_file()}
            for method, nfe in product(METHODS, (1, 2, 16)):
                found = {ending: table.at(method, nfe) for ending, table in tables.items()}
                if any(row for ending, row in found.items() if ending):
                    rows = (found.get(ending) for ending in ENDINGS)
                    cells = (told(row, bold=False) if row else "" for row in rows)
                    yield [task, label_of(method), str(nfe), target, *cells]


def settled() -> Iterator[list[str]]:
    """Rows of the table of settled policies."""
    for name, task in ({name: task for name, (task, _) in TASKS.items()} | OTHERS).items():
        cells = read_json(RESULTS / f"settled_{name}.json", "cells")["cells"]
        for (method, sampler), row in stored_comparison(f"own_settings_{name}").rows.items():
            key = {"method": method, "sampler": sampler}
            each = [cell for cell in cells if key.items() <= cell["key"].items()]
            if each:
                each.sort(key=lambda cell: cell["key"]["seed"])
                found = {what: [cell[what] for cell in each] for what in each[0]}
                mean = {
                    what: short(sum(found[what]) / len(each)) for what in ("without", "success")
                }
                older = f"; older {listed(found['older'])}" if any(found["older"]) else ""
                arm = name.startswith("arm")
                yield [
                    task,
                    label_of(method),
                    str(row["nfe"]),
                    listed(found["execute"]),
                    listed(found["temperature"]),
                    listed(found["t"]) + older,
                    *mean.values(),
                    ", ".join(map(short, found["success"])),
                    "" if arm else short(sum(found["score"]) / len(each)),
                ]


def deployed() -> Iterator[list[str]]:
    """Rows of the how-to: successes at 1, 2 and 16 evaluations, in brackets the coverage."""
    for method in METHODS:
        cells = []
        for usual, pattern in DEPLOYED.items():
            found = (best_training(usual, pattern, method, nfe) for nfe in (1, 2, 16))
            cells.append(both_scores([both for both in found if both]))
        if any(cells):
            yield [label_of(method), *cells]


def best_training(usual: str, pattern: str, method: str, nfe: int) -> tuple[Values, str] | None:
    """The row of the training that exploration starts prefer, and a mark if it is another.

    Networks that both trainings have decide (`goals.md`, goal 136).
    """
    ours = stored_comparison(f"own_settings_{usual}").at(method, nfe)
    if not ours:
        return None
    best, most = (ours, ""), MARGIN
    for path in sorted(RESULTS.glob("own_settings_*.json")):
        name = path.stem.removeprefix("own_settings_")
        if name != usual and re.fullmatch(pattern, name):
            row = stored_comparison(path.stem).at(method, nfe)
            shared = set(row["seeds"]) & set(ours["seeds"]) if row else set()
            gain = round(explored([row], shared) - explored([ours], shared), 6) if row else 0
            if row and gain >= most:
                best, most = (row, "*"), gain
    return best


def explored(rows: list[Values], seeds: set[int]) -> float:
    """The successes on exploration starts, a mean over rows and networks."""
    each = [row["explored_of_seeds"][row["seeds"].index(seed)] for row in rows for seed in seeds]
    return sum(each) / len(each)


def both_scores(found: list[tuple[Values, str]]) -> str:
    """The success in each row with its mark, and where there is one the coverage."""
    won = [(row.get("success", row.get("success_95")), mark) for row, mark in found]
    told = ((short(v).rstrip("0") if 0.99 <= v < 0.9995 else short(v, 2)) + mark for v, mark in won)
    covered = [short(row["coverage"], 2) for row, _ in found if "coverage" in row]
    return ", ".join(told) + f"<br>({', '.join(covered)})" * bool(covered)


def from_last_plan() -> Iterator[list[str]]:
    """Rows of the how-to: success of settled policies at one evaluation, and mean coverage."""
    names = "arm_ring_receding", "push_t", "push_t_human", "push_t_pixels"
    found: dict[str, dict[str, list[Values]]] = {method: {} for method in METHODS}
    for name in names:
        rows = stored_comparison(f"own_settings_{name}").rows
        for cell in read_json(RESULTS / f"settled_{name}.json", "cells")["cells"]:
            method, _, sampler = cell["key"].values()
            if rows[method, sampler]["nfe"] == 1:
                found[method].setdefault(name, []).append(cell)
    for method, cells in found.items():
        if cells:
            yield [label_of(method), *(settled_scores(n, cells.get(n, [])) for n in names)]


def settled_scores(name: str, cells: list[Values]) -> str:
    """The mean success of some networks, and where a table has one their coverage."""
    scores = ("success",) if name.startswith("arm") else ("success", "score")
    means = [short(sum(cell[k] for cell in cells) / len(cells), 2) for k in scores if cells]
    return " ".join(f"({mean})" if i else mean for i, mean in enumerate(means))


def by_task(rows: Iterable[list[str]]) -> Iterator[list[str]]:
    """The rows without their task; it stands above its first row."""
    for task, group in groupby(rows, key=lambda row: row[0]):
        first, *others = (row[1:] for row in group)
        yield [f"**{task}**", *[""] * (len(first) - 1)]
        yield from (first, *others)


def replaced(path: Path, tables: dict[str, Iterable[list[str]]]) -> None:
    """Replaces the rows of a page's tables, each the first below a heading."""
    page = path.read_text("utf-8")
    for heading, rows in tables.items():
        begin = page.index("|---", page.index(f"## {heading}\n"))
        begin, end = page.index("\n", begin) + 1, page.index("\n\n", begin) + 1
        text = "".join(f"| {' | '.join(row)} |\n" for row in rows)
        page = page[:begin] + text + page[end:]
    path.write_text(page, "utf-8")


def main() -> None:
    """Replaces the rows of the tables."""
    tables = {
        "Own settings": by_task(own_settings()),
        "Length of training": by_task(trained(*LENGTHS)),
        "Whole paths": by_task(paths()),
        "Learning rate": by_task(trained(*RATES)),
        "Frame of the goal": frames(),
        "Settled": by_task(settled()),
    }
    replaced(PAGE, tables)
    how_to = {"What the stored tables say": deployed(), "From the last plan": from_last_plan()}
    replaced(HOW_TO, how_to)


if __name__ == "__main__":
    main()
