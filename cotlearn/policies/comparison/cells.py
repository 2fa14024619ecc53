"""The cells of a comparison: trains and rolls out what is missing."""

import hashlib
import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from cotlearn.datasets import Dataset
from cotlearn.metrics import mode_entropy
from cotlearn.policies.comparison import scores
from cotlearn.policies.comparison.choice import choose
from cotlearn.policies.methods import find_method
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import COUNTED, EXPLORATION, REPORTED
from cotlearn.policies.training import Options, train
from cotlearn.results import Folder, Say, Values, machine, read_json, write_json
from cotlearn.robots.episodes import Episodes, split
from cotlearn.robots.experts.modes import demonstrated_modes
from cotlearn.validation import check_count

DEMONSTRATED = "demonstrations.json"  #: in the folder of the cells
COOLED = " at its temperature"  #: suffix of a sampler's name at its chosen temperature


@dataclass(frozen=True)
class Protocol:
    """What all cells of a comparison share.

    Attributes:
        options: of every training.
        train_episodes: to train on; all that are not held out if None.
        held_out: episodes kept for the energy score.
        episodes: paired rollouts of every policy.
        first_start: seed of the first start of a rollout.
        temperatures: that are tried beside 1, see `scores.choose_temperature`.
    """

    options: Options = field(default_factory=Options)
    train_episodes: int | None = None
    held_out: int = 200
    episodes: int = 200
    first_start: int = REPORTED
    temperatures: tuple[float, ...] = (0.2, 0.4, 0.6, 0.8)

    def record(self, episodes: Episodes) -> Values:
        """The protocol and what identifies the demonstrations, as JSON gives it back."""
        digest = hashlib.sha256()
        for array in (episodes.state, episodes.action, episodes.ends):
            digest.update(np.ascontiguousarray(array).tobytes())
        sizes = {"episodes": len(episodes), "rows": len(episodes.state)}
        data = {"name": episodes.name, **sizes, "sha256": digest.hexdigest()}
        record: Values = {**asdict(self), "task": episodes.task.name, "data": data}
        return dict(json.loads(json.dumps(record)))


def read_record(record: Values) -> Values:
    """A stored record of a protocol, under the names of today."""
    before = {"first_start": EXPLORATION, "temperatures": []}
    return {**before, **record, "options": asdict(Options.from_stored(record["options"]))}


@dataclass(frozen=True)
class _Bench:
    """What the cells of one run have in common."""

    training: Episodes
    held: Episodes
    protocol: Protocol
    record: Values
    weights: Path
    say: Say
    choices: dict[str, Values | None] = field(default_factory=dict)

    def cell(self, name: str) -> Values:
        """Trains a policy, unless its weights are there, and scores it."""
        method, _, seed = name.rpartition("-")
        if method not in self.choices:
            self.choices[method] = choose(method, self.training, self.protocol.options)
        chosen = self.choices[method]
        policy = self.stored(name) or self.train(name, method, int(seed), chosen)
        data = policy.windows.dataset(self.held, label=self.protocol.options.label)
        found: Values = {}
        for sampler in policy.sampler.variants:
            found |= self.score(policy.with_sampler(sampler), data)
        about, score = policy.about["training"], self.training.task.score
        means = {name: round(one["summary"][score], 3) for name, one in found.items()}
        self.say(f"{name}: trained in {about['seconds']:.0f} s; {score} {means}")
        values = {"method": method, "seed": int(seed), "training": about, "samplers": found}
        return {**values, **({"chosen": chosen} if chosen else {}), **machine("pymunk", "mujoco")}

    def score(self, policy: ChunkPolicy, held: Dataset) -> Values:
        """The scores of a policy with its sampler, as trained and at the temperature it chooses."""
        name, protocol = policy.sampler.name, self.protocol
        starts = range(protocol.first_start, protocol.first_start + protocol.episodes)
        found = {name: scores.evaluate(policy, held, starts=starts)}
        if protocol.temperatures and policy.sampler.random:
            chosen, tried = scores.choose_temperature(policy, protocol.temperatures)
            cooled = replace(policy, temperature=chosen)
            same = chosen == policy.temperature
            again = found[name] if same else scores.evaluate(cooled, held, starts=starts)
            found[f"{name}{COOLED}"] = {**again, "temperature": chosen, "tried": tried}
        return found

    def train(self, name: str, method: str, seed: int, chosen: Values | None) -> ChunkPolicy:
        """Trains a policy and keeps its weights, with what is known of the training."""
        self.say(f"{name}: training")
        options = self.protocol.options
        if chosen:
            options = replace(options, **{chosen["option"]: chosen["value"]})
        cpu, checkpoint = time.process_time(), self.weights / f"{name}.training.safetensors"
        trained = train(method, self.training, seed=seed, options=options, checkpoint=checkpoint)
        about = {
            "seconds": trained.seconds,
            "cpu_seconds_of_last_run": time.process_time() - cpu,
            "parameters": trained.parameters,
            "loss": [round(float(value), 5) for value in trained.history["loss"][9::10]],
        }
        trained.policy.about = {"protocol": self.record, "training": about}
        trained.policy.save(self.weights / f"{name}.safetensors")
        for file in trained.checkpoints:
            file.unlink()
        return trained.policy

    def stored(self, name: str) -> ChunkPolicy | None:
        """A policy of the same protocol that was trained before."""
        path = self.weights / f"{name}.safetensors"
        if not path.is_file():
            return None
        policy = ChunkPolicy.load(path)
        if read_record(policy.about["protocol"]) != self.record:
            raise ValueError(f"{path} was trained with another protocol: give another folder")
        return policy

    def demonstrate(self, path: Path) -> None:
        """Stores the demonstrator's modes at the starts from which policies' are counted."""
        if path.is_file():
            return
        self.say("demonstrations: counting modes")
        starts = range(COUNTED, COUNTED + scores.MODE_STARTS)
        modes = demonstrated_modes(self.training.task, starts, draws=scores.MODE_DRAWS)
        write_json(path, {"mode_entropy": mode_entropy(modes), "modes": modes.tolist()})


def bench(
    episodes: Episodes,
    *,
    folder: Path,
    weights: Path,
    methods: Sequence[str],
    seeds: Sequence[int],
    protocol: Protocol,
    executor: str = "local",
    say: Say = print,
) -> None:
    """Fills the cells that are missing.

    An interrupted run goes on where it stopped: finished cells are skipped, and the training that
    was under way resumes from its checkpoint. Two runs can work side by side on other cells.

    Args:
        episodes: all demonstrations; some are held out.
        folder: of the cells, `<method>-<seed>.json`.
        weights: folder of the trained policies and checkpoints, on the machine of each worker.
        methods: names in `METHODS`.
        seeds: of the trainings.
        protocol: of all cells in the folder.
        executor: of the cells, see `cotlearn.results.Store.fill`.
        say: where a line about each cell goes.

    Raises:
        ValueError: an unknown method or executor, or a cell in the folder was made with another
            protocol.
    """
    rows = [find_method(method) for method in methods]
    training, held = split(episodes, held_out=protocol.held_out, train=protocol.train_episodes)
    record = protocol.record(episodes)
    told = say if executor == "local" else print  # a terminal cannot be sent
    work = _Bench(training, held, protocol, record, weights.resolve(), told)
    seeds = [check_count(seed, "seeds", minimum=0) for seed in seeds]
    names = [f"{row.name}-{seed}" for seed in seeds for row in rows]
    Folder(folder, record, read=read_record).fill(names, work.cell, executor=executor, say=say)
    work.demonstrate(folder / DEMONSTRATED)


def measure_latency(folder: Path, *, weights: Path, say: Say = print) -> None:
    """Measures the latency of every finished cell again: on a quiet machine, one after the other.

    Args:
        folder: of the cells.
        weights: folder of the trained policies.
        say: where a line about each cell goes.
    """
    for path in sorted(folder.glob("*-*.json")):
        cell, trained = read_json(path), weights / f"{path.stem}.safetensors"
        if not trained.is_file():
            say(f"{path.stem}: no weights in {weights}")
            continue
        policy = ChunkPolicy.load(trained)
        for sampler in policy.sampler.variants:
            seconds = policy.with_sampler(sampler).latency()
            cell["samplers"][sampler.name]["latency_ms"] = 1000 * seconds
        write_json(path, cell)
        say(f"{path.stem}: latency measured")
