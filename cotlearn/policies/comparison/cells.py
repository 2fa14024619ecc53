"""The cells of a comparison: trains and rolls out what is missing."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from cotlearn.couplings import Independent
from cotlearn.metrics import mode_entropy
from cotlearn.policies.comparison import scores
from cotlearn.policies.comparison.choice import choose, is_open, seen_by
from cotlearn.policies.comparison.protocol import Protocol, machine, write_json
from cotlearn.policies.comparison.scores import evaluate, samplers
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.training import METHODS, Options, Trained, train
from cotlearn.robots.episodes import Episodes, split
from cotlearn.robots.experts.modes import demonstrated_modes
from cotlearn.robots.task import Task
from cotlearn.validation import check_choice, check_count

DEMONSTRATED = "demonstrations.json"  #: in the folder of the cells

Say = Callable[[str], None]


def bench(
    episodes: Episodes,
    *,
    folder: str | Path,
    methods: Sequence[str] = tuple(METHODS),
    seeds: Sequence[int] = (0, 1, 2),
    protocol: Protocol | None = None,
    weights: str | Path | None = None,
    progress: bool | None = None,
    say: Say = print,
) -> list[Path]:
    """Fills the cells that are missing, one after the other.

    An interrupted run goes on where it stopped: finished cells are skipped, and the training that
    was under way resumes from its checkpoint. Two runs can work side by side on other cells.

    Args:
        episodes: all demonstrations; some are held out.
        folder: of the cells, `<method>-<seed>.json`.
        methods: keys of `METHODS`.
        seeds: of the trainings.
        protocol: of all cells in the folder.
        weights: folder of the trained policies and checkpoints; `folder` / "weights" if None.
        progress: show bars; None: in terminals and notebooks.
        say: where a line about each cell goes.

    Returns:
        The files of the cells.

    Raises:
        ValueError: an unknown method, or a cell in the folder was made with another protocol.
    """
    folder, protocol = Path(folder), protocol or Protocol()
    place = folder / "weights" if weights is None else Path(weights)
    for method in methods:
        check_choice(method, "methods", tuple(METHODS))
    for seed in seeds:
        check_count(seed, "seeds", minimum=0)
    training, held = split(episodes, held_out=protocol.held_out, train=protocol.train_episodes)
    record = protocol.record(episodes)
    cells = [folder / f"{method}-{seed}.json" for seed in seeds for method in methods]
    missing = [cell for cell in cells if not _done(cell, record)]
    say(f"{len(cells)} cells, {len(cells) - len(missing)} done already")
    for cell in missing:
        method, _, number = cell.stem.rpartition("-")
        values = _cell(method, int(number), protocol, training, held, record, place, progress, say)
        write_json(cell, {"protocol": record, **values, **machine()})
        score = episodes.task.score
        means = {name: round(s["summary"][score], 3) for name, s in values["samplers"].items()}
        say(f"{cell.stem}: trained in {values['training']['seconds']:.0f} s; {score} {means}")
    _demonstrate(folder / DEMONSTRATED, episodes.task, progress, say)
    return cells


def measure_latency(
    folder: str | Path, *, weights: str | Path | None = None, say: Say = print
) -> None:
    """Measures the latency of every finished cell again: on a quiet machine, one after the other.

    Args:
        folder: of the cells.
        weights: folder of the trained policies; `folder` / "weights" if None.
        say: where a line about each cell goes.
    """
    folder = Path(folder)
    place = folder / "weights" if weights is None else Path(weights)
    for path in sorted(folder.glob("*-*.json")):
        cell = json.loads(path.read_text(encoding="utf-8"))
        policy, _ = _stored(place / f"{path.stem}.safetensors", cell["protocol"])
        if policy is None:
            say(f"{path.stem}: no weights in {place}")
            continue
        for sampler in samplers(policy):
            seconds = policy.with_sampler(sampler).latency()
            cell["samplers"][sampler.name]["latency_ms"] = 1000 * seconds
        write_json(path, cell)
        say(f"{path.stem}: latency measured")


def _demonstrate(path: Path, task: Task, progress: bool | None, say: Say) -> None:
    """The modes of the demonstrator from the starts from which policies' modes are counted."""
    if path.is_file():
        return
    say("demonstrations: counting modes")
    modes = demonstrated_modes(
        task,
        range(scores.MODE_SEED, scores.MODE_SEED + scores.MODE_STARTS),
        draws=scores.MODE_DRAWS,
        progress=progress,
    )
    write_json(path, {"mode_entropy": mode_entropy(modes), "modes": modes.tolist()})


def _done(cell: Path, record: dict[str, Any]) -> bool:
    if not cell.is_file():
        return False
    try:
        stored = json.loads(cell.read_text(encoding="utf-8"))["protocol"]
    except (ValueError, KeyError) as error:
        raise ValueError(f"{cell} is damaged: delete it to make it again ({error})") from error
    if stored != record:
        other = sorted(key for key in record if stored.get(key) != record[key])
        raise ValueError(f"{cell} was made with another protocol ({', '.join(other)})")
    return True


def _cell(
    method: str,
    seed: int,
    protocol: Protocol,
    training: Episodes,
    held: Episodes,
    record: dict[str, Any],
    place: Path,
    progress: bool | None,
    say: Say,
) -> dict[str, Any]:
    name = f"{method}-{seed}"
    options, chosen = protocol.options, None
    if is_open(method, options):
        chosen = _chosen(method, training, options, record, place)
        options = replace(options, **{chosen["option"]: chosen["value"]})
    policy, about = _stored(place / f"{name}.safetensors", record)
    if policy is None:
        say(f"{name}: training")
        teacher = None
        if method == "reflow":
            teacher = _stored_teacher(place / f"independent-{seed}.safetensors", record)
        checkpoint = place / f"{name}.training.safetensors"
        cpu = time.process_time()
        trained = train(
            method,
            training,
            seed=seed,
            options=options,
            teacher=teacher,
            checkpoint=checkpoint,
            progress=progress,
        )
        policy = trained.policy
        about = {
            "seconds": trained.seconds,
            "cpu_seconds_of_last_run": time.process_time() - cpu,
            "parameters": trained.parameters,
            "loss": [round(float(value), 5) for value in trained.history["loss"][9::10]],
        }
        policy.save(place / f"{name}.safetensors", about={"protocol": record, "training": about})
        for file in place.glob(f"*{name}.training.safetensors"):
            file.unlink()
    data = policy.windows.dataset(held, label=options.fitting(held).label)
    found = {}
    for sampler in samplers(policy):
        drawn = policy.with_sampler(sampler)
        found[sampler.name] = evaluate(drawn, data, episodes=protocol.episodes, progress=progress)
    extra = {} if chosen is None else {"chosen": chosen}
    return {"method": method, "seed": seed, "training": about, "samplers": found, **extra}


def _chosen(
    method: str, training: Episodes, options: Options, record: dict[str, Any], place: Path
) -> dict[str, Any]:
    """What the frontier chooses for all seeds of a method, computed once."""
    file = place / f"{method}.chosen.json"
    if file.is_file():
        stored: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if stored.pop("protocol") == record:
            return stored
    windows = options.fitting(training).windows(training)
    chosen = choose(method, seen_by(training, options), options, windows=windows)
    write_json(file, {**chosen, "protocol": record})
    return chosen


def _stored(path: Path, record: dict[str, Any]) -> tuple[ChunkPolicy | None, dict[str, Any]]:
    """A policy of this very protocol that was trained before, and what is known of it."""
    if not path.is_file():
        return None, {}
    policy, about = ChunkPolicy.load_with_about(path)
    if about.get("protocol") != record:
        raise ValueError(f"{path} was trained with another protocol: give another folder")
    return policy, about["training"]


def _stored_teacher(path: Path, record: dict[str, Any]) -> Trained | None:
    policy, about = _stored(path, record)
    if policy is None:
        return None
    return Trained(policy, {}, about["seconds"], about["parameters"], Independent())
