"""Train and roll out policies, and append what comes out to the two tables of `policies.results`.

A cell is one method with one seed. Its episodes go into the table of episodes if it keeps to the
course's protocol, and one row a sampler goes into the study in any case.
"""

from __future__ import annotations

import contextlib
import gzip
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from filelock import FileLock

from cotlearn.files import atomic_path
from cotlearn.metrics import mode_entropy
from cotlearn.policies.choice import with_choice
from cotlearn.policies.methods import Method, find_method
from cotlearn.policies.options import Options
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.results import EVALUATIONS, read_rows
from cotlearn.policies.rollout import REPORTED, Rollouts, rollout
from cotlearn.policies.samplers import Sampler
from cotlearn.policies.scores import held_out_score, mode_draws
from cotlearn.policies.settings import Setting
from cotlearn.policies.training import train
from cotlearn.robots.episodes import Episodes, split
from cotlearn.robots.registry import find_task
from cotlearn.validation import check_choice, check_count, check_seed

if TYPE_CHECKING:
    from pandas import DataFrame

EPISODES = 200  #: paired rollouts of every policy
#: What tells the rows of a table apart.
EPISODE_KEY = ("task", "regime", "method", "seed", "evaluations", "episode")
STUDY_KEY = (
    *("source", "task", "regime", "method", "seed", "target", "frame", "steps", "rate"),
    *("demonstrations", "strata", "condition_weight", "setting", "sampler", "evaluations"),
    *("actions", "temperature"),
    *("start", "starts", "episodes", "note"),
)
#: Columns of the study, and the outcomes of which they are means; a task has some of them.
MEANS = {
    "coverage": "coverage",
    "success_90": "success_90",
    "coverage_200": "coverage_200",
    "success_200": "success_95_200",
    "reward": "reward",
    "reward_200": "reward_200",
    "collision": "collision",
    "goal_error": "goal_error",
    "jerk": "jerk",
    "duration": "steps",
}
EXECUTORS = ("local", "dask", "ray")
Row = dict[str, Any]
Say = Callable[[str], None]


@dataclass(frozen=True)
class Bench:
    """What the cells of a run have in common.

    Attributes:
        setting: the task, with the options of all trainings.
        course: whether they are the course's protocol.
        training: episodes to train on.
        held: episodes that are kept for the energy score.
        episodes: paired rollouts of every policy.
        weights: folder of the trained policies and their checkpoints.
        note: options of the trainings that have no column.
    """

    setting: Setting
    course: bool
    training: Episodes
    held: Episodes
    episodes: int
    weights: Path
    note: str = ""

    def cell(self, method: Method, seed: int, say: Say) -> tuple[list[Row], list[Row]]:
        """The rows of a method and a seed for the two tables: of episodes, and of the study."""
        say(f"chooses its options on {len(self.training)} demonstrations")
        options = method.settle(with_choice(method, self.training, self.setting.options))
        say(f"trains, {options.steps} steps")
        policy = self.trained(method, seed, options)
        held = policy.windows.dataset(self.held, label=options.label)
        named = self.named(method, seed, options)
        episodes: list[Row] = []
        study: list[Row] = []
        for sampler in samplers(policy):
            drawn = policy.with_sampler(sampler)
            say(f"plays {self.episodes} episodes, evaluations for a chunk: {sampler.nfe}")
            done = rollout(drawn, seeds=range(REPORTED, REPORTED + self.episodes))
            scores = {
                "sampler": sampler.name,
                "evaluations": sampler.nfe,
                "temperature": drawn.temperature,
                "energy_score": held_out_score(drawn, held),
                "variety": mode_entropy(mode_draws(drawn)),
                "latency_ms": 1000 * drawn.latency(),
            }
            study.append({**named, **scores, **means(done), **policy.about["training"]})
            short = {name: study[-1][name] for name in EPISODE_KEY[:-1]}
            episodes += episode_rows(short, done)
        return episodes if self.course else [], study

    def named(self, method: Method, seed: int, options: Options) -> Row:
        """What is known of a cell before its training, under the names of the study's columns."""
        frames = find_task(self.setting.task).frames
        clusters = options.clusters if method.open_option == "clusters" else None
        weight = options.condition_weight if method.open_option == "condition_weight" else None
        return {
            "source": "bench",
            "task": self.setting.table,
            "regime": self.setting.regime,
            "method": method.name,
            "seed": seed,
            "target": "chunk" if options.prediction == "data" else options.prediction,
            "frame": options.frame or next(iter(frames)),
            "steps": options.steps,
            "rate": options.learning_rate,
            "demonstrations": len(self.training),
            "strata": clusters,
            "condition_weight": weight,
            "setting": "as trained",
            "actions": options.execute,
            "start": "noise",
            "starts": REPORTED,
            "episodes": self.episodes,
            "course": int(self.course),
            "note": self.note,
        }

    def is_done(self, table: DataFrame, method: Method, seed: int) -> bool:
        """Whether the study has the rows of a cell."""
        named = self.named(method, seed, method.settle(self.setting.options))
        rows = table
        for column, value in named.items():
            if column == "note":
                rows = rows[rows[column].astype(object).fillna("") == value]
            elif column != "source" and value is not None:  # None: the frontier will choose it
                rows = rows[rows[column] == value]
        return not rows.empty

    def trained(self, method: Method, seed: int, options: Options) -> ChunkPolicy:
        """The policy of a cell: from its weights if they are there, else trained."""
        path = self.weights / f"{method.name}-{seed}.safetensors"
        wanted = {"options": repr(options), "episodes": len(self.training)}
        if path.is_file():
            policy = ChunkPolicy.load(path)
            if policy.about.get("wanted") != wanted:
                raise ValueError(f"{path} was trained with other options: give other weights")
            return policy
        checkpoint = path.with_name(f"{path.stem}.training.safetensors")
        cpu = time.process_time()
        done = train(method, self.training, seed=seed, options=options, checkpoint=checkpoint)
        minutes = round((time.process_time() - cpu) / 60, 2)
        about = {"parameters": done.parameters, "cpu_minutes": minutes}
        done.policy.about = {"wanted": wanted, "training": about}
        done.policy.save(path)
        for file in done.checkpoints:
            file.unlink()
        return done.policy


def samplers(policy: ChunkPolicy) -> list[Sampler]:
    """The samplers of the course's protocol: a method's own, with 1, 2 and 16 evaluations."""
    first = {sampler.nfe: sampler for sampler in reversed(policy.sampler.variants)}
    return [first[nfe] for nfe in EVALUATIONS if nfe in first]


def episode_rows(key: Row, done: Rollouts) -> list[Row]:
    """One row an episode."""
    task = done.task
    columns = {"success": done[task.strictest].astype(int)}
    if task.score == "coverage":
        columns["coverage"] = done["coverage"].round(4)
    else:
        columns |= {"collision": done["collision"].astype(int), "mode": done["mode"].astype(int)}
    values = zip(*(column.tolist() for column in columns.values()), strict=True)
    return [
        {**key, "episode": number, **dict(zip(columns, row, strict=True))}
        for number, row in enumerate(values)
    ]


def means(done: Rollouts) -> Row:
    """The means of a rollout, under the names of the study's columns."""
    found = done.summary()
    success = found[done.task.strictest]
    return {
        "successes": round(success * len(done.seed)),
        "success": success,
        **{column: found[name] for column, name in MEANS.items() if name in found},
    }


def append(path: Path, rows: Sequence[Row], key: Sequence[str]) -> None:
    """Add rows to a table, in the place of those with the same key.

    The file is replaced at once, and locked meanwhile: runs can work side by side.

    Args:
        path: the table, a CSV file; made if it is not there.
        rows: column -> value.
        key: columns that tell rows apart.
    """
    import pandas as pd

    path.parent.mkdir(parents=True, exist_ok=True)
    with FileLock(path.with_name(f".{path.name}.lock")):
        fresh = pd.DataFrame(rows)
        old = read_rows(path) if path.is_file() else fresh.iloc[:0]
        whole = pd.concat([old, fresh], ignore_index=True).convert_dtypes()
        whole = whole.drop_duplicates([name for name in key if name in whole], keep="last")
        text = whole.to_csv(index=False, float_format="%.6g").encode()
        with atomic_path(path) as temporary:
            temporary.write_bytes(gzip.compress(text, mtime=0) if path.suffix == ".gz" else text)


def bench(
    setting: Setting,
    demonstrations: Episodes,
    *,
    methods: Sequence[str | Method],
    seeds: Sequence[int],
    weights: Path,
    episodes_table: Path,
    study_table: Path,
    course: bool = False,
    episodes: int = EPISODES,
    train_episodes: int | None = None,
    note: str = "",
    executor: str = "local",
    say: Say = print,
) -> None:
    """Fill the cells that are missing in the tables.

    Finished cells are skipped and an interrupted training resumes, so a killed run loses one cell
    at most. Runs can work side by side on other methods or seeds.

    Args:
        setting: a task and the options of all trainings.
        demonstrations: all of them; some are held out.
        methods: names in `METHODS`, or methods of one's own.
        seeds: of the trainings.
        weights: folder of the trained policies and checkpoints, on the machine of each worker.
        episodes_table: where episodes go if this is the course's protocol.
        study_table: where the rows of networks and samplers go.
        course: whether this is the course's protocol.
        episodes: paired rollouts of each policy.
        train_episodes: to train on; all that are not held out if None.
        note: options of the trainings that the study has no column for.
        executor: "local", one cell after the other in this process; "dask" or "ray", in the workers
            of the cluster that DASK_SCHEDULER_ADDRESS or RAY_ADDRESS names, else in one worker for
            each core of this machine.
        say: where lines go: what each cell does, if it does it in this process, and what came out.

    Raises:
        ValueError: an unknown method or executor, or weights of other options in the folder.
        ImportError: Dask or Ray is not installed.
    """
    check_choice(executor, "executor", EXECUTORS)
    check_count(episodes, "episodes", minimum=2)
    found = [find_method(method) for method in methods]
    seeds = [check_seed(seed, "seeds") for seed in seeds]
    training, held = split(demonstrations, held_out=setting.held_out, train=train_episodes)
    work = Bench(setting, course, training, held, episodes, weights.resolve(), note)
    cells = [(method, seed) for seed in seeds for method in found]
    missing = cells
    if study_table.is_file():
        stored = read_rows(study_table)
        missing = [cell for cell in cells if not work.is_done(stored, *cell)]
    say(f"{len(cells)} cells, {len(cells) - len(missing)} done already")
    if missing and executor != "local":
        say("a line comes when a cell is done")
    with opened(executor) as each:
        computed = each(partial(_computed, work, say if executor == "local" else _silent), missing)
        for number, (name, seconds, played, study) in enumerate(computed, start=1):
            if played:
                append(episodes_table, played, EPISODE_KEY)
            append(study_table, study, STUDY_KEY)
            won = ", ".join(f"{row['success']:.2f} at {row['evaluations']}" for row in study)
            say(f"[{number}/{len(missing)}] {name}: success {won}; {seconds:.0f} s")


def _computed(
    work: Bench, say: Say, cell: tuple[Method, int]
) -> tuple[str, float, list[Row], list[Row]]:
    """The rows of a cell, with its name and how long it took."""
    started, name = time.perf_counter(), f"{cell[0].name}-{cell[1]}"
    episodes, study = work.cell(*cell, lambda words: say(f"{name}: {words}"))
    return name, time.perf_counter() - started, episodes, study


def _silent(words: str) -> None:
    """What a worker says, whose lines nobody would see."""


@contextlib.contextmanager
def opened(executor: str) -> Iterator[Callable[..., Iterable[Any]]]:
    """A function like `map`; with workers, its results come in the order in which they are done."""
    if executor == "local":
        yield map
    elif executor == "dask":
        from distributed import Client

        with Client(threads_per_worker=1, dashboard_address=None) as client:
            yield partial(_each, client.get_executor().submit)
    else:
        import ray

        with ray.init():
            yield partial(_each, _in_ray)


def _in_ray(f: Callable[[Any], Any], cell: Any) -> Any:
    import ray

    @ray.remote
    def task(cell: Any) -> Any:  # Ray takes no `partial`
        return f(cell)

    return task.remote(cell).future()


def _each(submit: Callable[..., Any], f: Callable[[Any], Any], cells: Any) -> Iterator[Any]:
    """The results of f(cell) in the order in which they are done."""
    return (done.result() for done in as_completed([submit(f, cell) for cell in cells]))
