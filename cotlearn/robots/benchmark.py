"""The comparison on Push-T: one file for each (method, seed), and a summary of all of them."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import os
import platform
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cotlearn.couplings import ConditionalOT, Independent
from cotlearn.couplings.base import generator_for
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import frontier
from cotlearn.metrics import bootstrap_interval, energy_score, paired_bootstrap, wilson_interval
from cotlearn.robots.episodes import Episodes, Windows, split
from cotlearn.robots.policies import (
    ChunkPolicy,
    DDIMSampler,
    DDPMSampler,
    FlowSampler,
    MeanSampler,
    Sampler,
)
from cotlearn.robots.rollout import rollout
from cotlearn.robots.training import METHODS, Options, Trained, train
from cotlearn.storage import atomic_path
from cotlearn.validation import check_choice, check_count

REFERENCE = ("independent", "euler-16")  #: what all others are compared to
FACTORS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1000.0)  #: condition weights, see `choose_weight`
FRONTIER_ROWS = 4096  #: pairs looked at for each weight
SCORED_STATES, SCORED_SAMPLES = 1000, 8  #: of the energy score
THRESHOLDS = (0.90, 0.95)

Say = Callable[[str], None]


@dataclass(frozen=True)
class Protocol:
    """What all cells of a comparison share.

    Attributes:
        options: of every training.
        train_episodes: to train on; all that are not held out if None.
        held_out: episodes kept for the energy score.
        episodes: paired rollouts of every policy.
    """

    options: Options = field(default_factory=Options)
    train_episodes: int | None = None
    held_out: int = 200
    episodes: int = 200

    def __post_init__(self) -> None:
        check_count(self.held_out, "held_out")
        check_count(self.episodes, "episodes", minimum=2)
        if self.train_episodes is not None:
            check_count(self.train_episodes, "train_episodes")


def samplers(policy: ChunkPolicy) -> list[Sampler]:
    """The ways in which a policy is drawn from, in the family of its own sampler."""
    own = policy.sampler
    if isinstance(own, MeanSampler):
        return [own]
    if isinstance(own, DDPMSampler):
        spacings = ("leading", "trailing")
        few = [DDIMSampler(n, own.levels, s, own.clip) for n in (4, 16) for s in spacings]
        return [own, *few]
    return [*(FlowSampler(nfe) for nfe in (1, 2, 4, 16)), FlowSampler(2, "midpoint")]


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
    record = {**asdict(protocol), "data": describe(episodes)}
    cells = [folder / f"{method}-{seed}.json" for seed in seeds for method in methods]
    missing = [cell for cell in cells if not _done(cell, record)]
    say(f"{len(cells)} cells, {len(cells) - len(missing)} done already")
    for cell in missing:
        method, _, number = cell.stem.rpartition("-")
        values = _cell(method, int(number), protocol, training, held, record, place, progress, say)
        write_json(cell, {"protocol": record, **values, **_machine()})
        scores = {
            name: round(s["summary"]["coverage"], 3) for name, s in values["samplers"].items()
        }
        say(f"{cell.stem}: trained in {values['training']['seconds']:.0f} s; coverage {scores}")
    return cells


def choose_weight(data: Dataset, options: Options, *, seed: int = 0) -> dict[str, Any]:
    """COT's condition weight by the frontier, before any training and without any rollout.

    Among multiples of the ratio of sample to condition variance, the weight with the smallest
    predicted one-step error whose prior skew is not significant; if all are, the least skewed one.

    Returns:
        "condition_weight", "reason", and the points of the frontier.
    """
    assert data.c is not None
    spread = float(data.c.var(dim=0).sum())
    ratio = (float(data.x1.var(dim=0).sum()) + data.dim) / spread if spread else 1.0
    couplings = {f"{factor:g}": ConditionalOT(factor * ratio) for factor in FACTORS}
    found = frontier(
        data.x1,
        data.c,
        {"independent": Independent(), **couplings},
        batch_size=options.ot_batch_size,
        rows=FRONTIER_ROWS,
        seed=seed,
    )
    points = [point for point in found if point.name in couplings]
    clean = [point for point in points if not point.flagged]
    if clean:
        best = min(clean, key=lambda point: point.one_step_error)
        reason = "smallest predicted one-step error without significant skew"
    else:
        best = min(points, key=lambda point: point.skew)
        reason = "every weight skews the prior significantly; this one least"
    return {
        "condition_weight": float(best.name) * ratio,
        "reason": reason,
        "frontier": [
            {
                "factor": point.name,
                "skew": point.skew,
                "flagged": point.flagged,
                "one_step_variance": point.one_step_variance,
                "one_step_error": point.one_step_error,
                "candidates": point.candidates,
            }
            for point in found
        ],
    }


def with_weight(method: str, training: Episodes, options: Options) -> Options:
    """The options with COT's condition weight chosen by the frontier, where that is open."""
    if not _needs_weight(method, options):
        return options
    chosen = choose_weight(_dataset(training, options), options)
    return replace(options, condition_weight=chosen["condition_weight"])


def evaluate(
    policy: ChunkPolicy, held: Dataset, *, episodes: int, progress: bool | None = None
) -> dict[str, Any]:
    """Rollouts, energy score and latency of one policy, JSON-compatible."""
    done = rollout(policy, episodes=episodes, progress=progress)
    return {
        "nfe": policy.sampler.nfe,
        "summary": done.summary(),
        "energy_score": held_out_score(policy, held),
        "latency_ms": 1000 * policy.latency(),
        "seconds_of_policy": done.seconds,
        "chunks": done.chunks,
        "coverage": [round(float(value), 4) for value in done.coverage],
        "steps": done.steps.tolist(),
    }


def held_out_score(policy: ChunkPolicy, held: Dataset, *, seed: int = 0) -> float:
    """The energy score of chunks at held-out states, in the units that the network works in."""
    assert held.c is not None
    rng = generator_for(seed, 0, purpose=17)
    rows = torch.randperm(len(held), generator=rng)[:SCORED_STATES]
    c, truth = held.c[rows], held.x1[rows]
    draws: list[Tensor] = []
    for _ in range(SCORED_SAMPLES):
        noise = policy.noise(len(rows), rng)
        draws.append(policy.sampler(policy.network, noise, c))
    return energy_score(torch.stack(draws), truth)


def summarise(folder: str | Path, path: str | Path) -> dict[str, Any]:
    """Writes one file about all cells of a folder: means, every seed, intervals, comparisons.

    Args:
        folder: of the cells.
        path: the file to write.

    Returns:
        What was written.

    Raises:
        ValueError: there is no cell, or they were made with different protocols.
    """
    files = sorted(Path(folder).glob("*-*.json"))
    cells = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    if not cells:
        raise ValueError(f"{folder} holds no cells yet: run cotlearn bench push-t")
    for file, cell in zip(files, cells, strict=True):
        if cell["protocol"] != cells[0]["protocol"]:
            raise ValueError(f"{file} was made with another protocol than {files[0]}")
    rows = [_row(cells, method, name) for method in METHODS for name in _names(cells, method)]
    reference = next((r for r in rows if (r["method"], r["sampler"]) == REFERENCE), None)
    if reference is not None:
        for row in rows:
            row["against_reference"] = _compare(cells, row, reference)
    trained = {
        method: _training([cell for cell in cells if cell["method"] == method])
        for method in METHODS
        if _names(cells, method)
    }
    summary = {
        "question": "Push-T: how good are policies of each coupling at few evaluations?",
        "command": "cotlearn bench push-t",
        "protocol": cells[0]["protocol"],
        "reference": dict(zip(("method", "sampler"), REFERENCE, strict=True)),
        "rows": rows,
        "training": trained,
        **{key: cells[0][key] for key in ("versions", "machine")},
    }
    write_json(Path(path), summary)
    return summary


def describe(episodes: Episodes) -> dict[str, Any]:
    """What identifies the demonstrations."""
    digest = hashlib.sha256()
    for array in (episodes.state, episodes.action, episodes.ends):
        digest.update(np.ascontiguousarray(array).tobytes())
    return {
        "name": episodes.name,
        "episodes": len(episodes),
        "rows": len(episodes.state),
        "sha256": digest.hexdigest(),
    }


def write_json(path: Path, value: Any) -> None:
    """Writes a file atomically, innermost lists of numbers on one line."""
    text = json.dumps(value, indent=1, allow_nan=False)
    text = re.sub(r"\[[^\[\]{}\"]*\]", lambda found: " ".join(found[0].split()), text)
    with atomic_path(path) as part:
        part.write_text(text + "\n", encoding="utf-8")


def _done(cell: Path, record: dict[str, Any]) -> bool:
    if not cell.is_file():
        return False
    try:
        stored = json.loads(cell.read_text(encoding="utf-8"))["protocol"]
    except (ValueError, KeyError) as error:
        raise ValueError(f"{cell} is damaged: delete it to make it again ({error})") from error
    expected = json.loads(json.dumps(record))
    if stored != expected:
        other = sorted(key for key in expected if stored.get(key) != expected[key])
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
    if _needs_weight(method, options):
        chosen = _chosen_weight(training, options, record, place)
        options = replace(options, condition_weight=chosen["condition_weight"])
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
    data = policy.windows.dataset(held, label=_label(held, options))
    scores = {}
    for sampler in samplers(policy):
        drawn = policy.with_sampler(sampler)
        scores[sampler.name] = evaluate(drawn, data, episodes=protocol.episodes, progress=progress)
    extra = {} if chosen is None else {"chosen_weight": chosen}
    return {"method": method, "seed": seed, "training": about, "samplers": scores, **extra}


def _needs_weight(method: str, options: Options) -> bool:
    return method == "conditional_ot" and options.condition_weight is None


def _dataset(training: Episodes, options: Options) -> Dataset:
    """The windows that a training would see."""
    label = _label(training, options)
    windows = Windows.fit(
        training,
        observe=options.observe,
        predict=options.predict,
        frame=options.frame,
        label=label,
        scale=options.scale,
    )
    return windows.dataset(training, label=label)


def _label(episodes: Episodes, options: Options) -> str:
    return "action" if episodes.intention is None else options.label


def _chosen_weight(
    training: Episodes, options: Options, record: dict[str, Any], place: Path
) -> dict[str, Any]:
    """The weight for all seeds, computed once."""
    file = place / "condition_weight.json"
    if file.is_file():
        stored: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        if stored.pop("protocol") == json.loads(json.dumps(record)):
            return stored
    chosen = choose_weight(_dataset(training, options), options)
    write_json(file, {**chosen, "protocol": record})
    return chosen


def _stored(path: Path, record: dict[str, Any]) -> tuple[ChunkPolicy | None, dict[str, Any]]:
    """A policy of this very protocol that was trained before, and what is known of it."""
    if not path.is_file():
        return None, {}
    policy, about = ChunkPolicy.load_with_about(path)
    if about.get("protocol") != json.loads(json.dumps(record)):
        raise ValueError(f"{path} was trained with another protocol: give another folder")
    return policy, about["training"]


def _stored_teacher(path: Path, record: dict[str, Any]) -> Trained | None:
    policy, about = _stored(path, record)
    if policy is None:
        return None
    return Trained(policy, {}, about["seconds"], about["parameters"])


def _names(cells: list[dict[str, Any]], method: str) -> list[str]:
    mine = [cell for cell in cells if cell["method"] == method]
    return list(mine[0]["samplers"]) if mine else []


def _scores(cells: list[dict[str, Any]], method: str, sampler: str) -> dict[int, Any]:
    """seed -> what this cell says of this sampler."""
    mine = [cell for cell in cells if cell["method"] == method]
    return {cell["seed"]: cell["samplers"][sampler] for cell in mine}


def _row(cells: list[dict[str, Any]], method: str, sampler: str) -> dict[str, Any]:
    scores = _scores(cells, method, sampler)
    coverage = np.array([score["coverage"] for score in scores.values()])
    row: dict[str, Any] = {
        "method": method,
        "sampler": sampler,
        "nfe": next(iter(scores.values()))["nfe"],
        "seeds": list(scores),
        "coverage": float(coverage.mean()),
        "coverage_of_seeds": coverage.mean(axis=1).round(4).tolist(),
        "coverage_interval": bootstrap_interval(coverage.mean(axis=0)),
    }
    for threshold in THRESHOLDS:
        name = f"success_{100 * threshold:.0f}"
        wins = (coverage > threshold).sum(axis=1)
        row[name] = float((coverage > threshold).mean())
        row[f"{name}_of_seeds"] = [
            {
                "value": int(k) / coverage.shape[1],
                "wilson": wilson_interval(int(k), coverage.shape[1]),
            }
            for k in wins
        ]
    for name in ("energy_score", "latency_ms"):
        values = [score[name] for score in scores.values()]
        row[name], row[f"{name}_of_seeds"] = float(np.mean(values)), values
    for name in ("steps", "jerk"):
        row[name] = float(np.mean([score["summary"][name] for score in scores.values()]))
    return row


def _compare(
    cells: list[dict[str, Any]], row: dict[str, Any], reference: dict[str, Any]
) -> dict[str, Any] | None:
    """Differences over the seeds that both have, paired by seed and episode."""
    mine = _scores(cells, row["method"], row["sampler"])
    theirs = _scores(cells, reference["method"], reference["sampler"])
    shared = sorted(set(mine) & set(theirs))
    if not shared:
        return None
    a, b = (np.array([s[seed]["coverage"] for seed in shared]) for s in (mine, theirs))
    result: dict[str, Any] = {"seeds": shared, "coverage": paired_bootstrap(a, b)}
    for threshold in THRESHOLDS:
        mine_won, theirs_won = (np.asarray(x > threshold, dtype=float) for x in (a, b))
        result[f"success_{100 * threshold:.0f}"] = paired_bootstrap(mine_won, theirs_won)
    return result


def _training(cells: list[dict[str, Any]]) -> dict[str, Any]:
    each = [cell["training"] for cell in cells]
    chosen = next((cell["chosen_weight"] for cell in cells if "chosen_weight" in cell), None)
    return {
        "seconds": [round(one["seconds"], 1) for one in each],
        "parameters": each[0]["parameters"],
        **({} if chosen is None else {"chosen_weight": chosen}),
    }


def _machine() -> dict[str, Any]:
    return {
        "versions": {
            "python": platform.python_version(),
            **{n: importlib.metadata.version(n) for n in ("torch", "numpy", "scipy", "pymunk")},
        },
        "machine": f"one of {os.cpu_count()} CPU cores of a shared server, {platform.machine()}, "
        f"{torch.get_num_threads()} thread",
    }
