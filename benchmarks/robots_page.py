"""Writes tables into the page of the robots: own settings, other trainings, settled.

    python benchmarks/robots_page.py

reads data/results/own_settings_*.json and settled_*.json, and changes nothing else on the page.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

from cells import RESULTS

from cotlearn.plots import label_of
from cotlearn.policies.comparison.stored import stored_comparison
from cotlearn.policies.methods import METHODS
from cotlearn.results import Values, read_json

PAGE = Path(__file__).resolve().parents[1] / "docs/reference/one_step_on_robots.md"
#: Each task in words, and the table that counts the ways of its demonstrations.
TASKS = {
    "push_t": ("Push-T, planned", "push_t"),
    "push_t_pixels": ("Push-T from pixels", "push_t_pixels_data"),
    "push_t_human": ("Push-T, people", "push_t_human"),
    "arm_ring_receding": ("arm, planning again", "arm_ring_receding"),
}
#: What was settled after twice the steps.
LONGER = "arm_ring_receding_12000", "arm, planning again, 12,000 steps"
#: What a training can have another of, in that of the task: its files, and the columns.
LENGTHS = "steps", r"(_\d+)?", (0.5, 1.0, 2.0)
RATES = "learning_rate", r"(_rate_[\d.]+)?", (1.0, 3.0)

#: The arm in the frame of the world, in that of the goal, and there with other trainings.
FRAMES = "", "_goal", "_12000_goal", "_rate_0.003_goal"


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
    for name, (task, _) in TASKS.items():
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
        yield [TASKS[name][0], label_of(key[0]), str(row["nfe"]), *cells]


def preferred(found: dict[float, Values]) -> float:
    """The ratio to the task's option with most successes, by networks that all have."""
    shared = set.intersection(*(set(row["seeds"]) for row in found.values()))

    def explored(ratio: float) -> float:
        row = found[ratio]
        each = zip(row["seeds"], row["explored_of_seeds"], strict=True)
        return sum(value for seed, value in each if seed in shared)

    return max(found, key=explored)


def told(row: Values, *, bold: bool) -> str:
    """The successes of each network, and where there is one their mean coverage."""
    each = row["success_of_seeds" if "success" in row else "success_95_of_seeds"]
    covered = f" ({short(row['coverage'], 2)})" if "coverage" in row else ""
    return "**" * bold + ", ".join(short(value) for value in each) + "**" * bold + covered


def settled() -> Iterator[list[str]]:
    """Rows of the table of settled policies."""
    for name, task in [*((name, task) for name, (task, _) in TASKS.items()), LONGER]:
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


def main() -> None:
    """Replaces the rows of the tables."""
    page = PAGE.read_text("utf-8")
    tables = {
        "Own settings": own_settings(),
        "Length of training": trained(*LENGTHS),
        "Learning rate": trained(*RATES),
        "Frame of the goal": frames(),
        "Settled": settled(),
    }
    for heading, rows in tables.items():
        begin = page.index("|---", page.index(f"## {heading}\n"))
        begin, end = page.index("\n", begin) + 1, page.index("\n\n", begin) + 1
        text = "".join(f"| {' | '.join(row)} |\n" for row in rows)
        page = page[:begin] + text + page[end:]
    PAGE.write_text(page, "utf-8")


if __name__ == "__main__":
    main()
