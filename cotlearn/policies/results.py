"""The two stored tables of robot policies as data frames: episodes, and everything else trained.

`data/results/episodes.md` and `data/results/study.md` say what each column means, and which command
adds a row.
"""

from __future__ import annotations

import functools
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cotlearn.course.assets import find_data
from cotlearn.metrics import paired_bootstrap, student
from cotlearn.validation import check_choice

if TYPE_CHECKING:
    from pandas import DataFrame

EPISODES = "results/episodes.csv.gz"
STUDY = "results/study.csv"
EVALUATIONS = (1, 2, 16)  #: of the network for each chunk, in the course's protocol
SCORES = ("success", "coverage", "collision")


def read_rows(path: Path) -> DataFrame:
    """Read a table that `cotlearn bench` writes.

    Raises:
        ValueError: the file is damaged.
    """
    import pandas as pd

    try:
        return pd.read_csv(path, low_memory=False)
    except (ValueError, OSError, EOFError) as error:
        raise ValueError(f"{path} is damaged, restore it ({error})") from error


@functools.cache
def _stored(name: str) -> DataFrame:
    return read_rows(find_data(name))


def episodes(task: str, *, regime: str | None = None, table: DataFrame | None = None) -> DataFrame:
    """Every episode of the course's protocol on a task.

    Args:
        task: such as "push-t" or "arm-ring".
        regime: "whole" or "replanning"; needed where the task has both.
        table: to look in; the course's if None.

    Returns:
        One row an episode: method, seed, evaluations, episode, success (0 or 1), and coverage or
        collision and mode.

    Raises:
        ValueError: the table has no such task or regime.
    """
    table = _stored(EPISODES) if table is None else table
    found = table[table["task"] == check_choice(task, "task", tuple(table["task"].unique()))]
    known = tuple(found["regime"].unique())
    if regime is None and len(known) > 1:
        raise ValueError(f"regime must be one of {', '.join(known)} for {task}, got None")
    regime = check_choice(regime or known[0], "regime", known)
    return found[found["regime"] == regime].dropna(axis="columns", how="all")


def study(**wanted: Any) -> DataFrame:
    """The rows of the study: everything that was trained, one row a network and sampler.

    Args:
        wanted: column -> the value, or several values, that a row must have, such as
            `study(task="push-t", method=["independent", "residual"], evaluations=1)`.

    Raises:
        ValueError: the study has no such column, or no row of it has such a value.
    """
    rows = whole = _stored(STUDY)
    for column, value in wanted.items():
        check_choice(column, "column", tuple(rows.columns))
        one = isinstance(value, str) or not isinstance(value, Iterable)
        values = [value] if one else list(value)
        if absent := [each for each in values if not whole[column].isin([each]).any()]:
            known = whole[column].dropna().unique().tolist()
            known = ", ".join(
                word if isinstance(word, str) else f"{word:g}" for word in sorted(known)
            )
            raise ValueError(f"no row of the study has {column}={absent[0]!r}; there are {known}")
        rows = rows[rows[column].isin(values)]
    return rows if wanted else rows.copy()


def results(
    task: str,
    *,
    methods: Sequence[str] | None = None,
    evaluations: Iterable[int] = EVALUATIONS,
    regime: str | None = None,
    table: DataFrame | None = None,
) -> DataFrame:
    """Means of the course's protocol, with 95 % intervals over seeds and episodes.

    Args:
        task: such as "push-t" or "arm-ring".
        methods: names, in the order of the rows; all that are stored if None.
        evaluations: numbers of evaluations of the network for each chunk.
        regime: "whole" or "replanning"; needed where the task has both.
        table: to look in; the course's if None.

    Returns:
        One row a method and number of evaluations: `method`, `evaluations`, `seeds`, `episodes`,
        and for each score its mean, `<score>_low`, `<score>_high` and `<score>_of_seeds`.

    Raises:
        ValueError: the table has no such task, regime or method.
    """
    import pandas as pd

    found = episodes(task, regime=regime, table=table)
    known = tuple(found["method"].unique())
    rows = []
    for method in known if methods is None else methods:
        mine = found[found["method"] == check_choice(method, "method", known)]
        for nfe in evaluations:
            some = mine[mine["evaluations"] == nfe]
            if len(some):  # a regression has one evaluation only
                summary = _summary(some, found)
                rows.append({"method": method, "evaluations": nfe, **summary})
    return pd.DataFrame(rows)


def _summary(rows: DataFrame, task: DataFrame) -> dict[str, Any]:
    """Means and intervals of the episodes of one method at one number of evaluations.

    Args:
        rows: these episodes.
        task: all episodes of the task, which say how much networks differ.
    """
    found: dict[str, Any] = {"seeds": rows["seed"].nunique(), "episodes": len(rows)}
    for score in SCORES:
        if score in rows and rows[score].notna().any():
            values = grid(rows, score)
            deviation = between_networks(task, score) if len(values) == 1 else 0.0
            found["episodes"] = values.size  # those that all seeds have
            mean, low, high = mean_interval(values, deviation=deviation)
            found |= {score: mean, f"{score}_low": low, f"{score}_high": high}
            found[f"{score}_of_seeds"] = values.mean(axis=1).round(4).tolist()
    return found


def grid(rows: DataFrame, score: str) -> NDArray[np.float64]:
    """A score as (seeds, episodes), of the episodes that all seeds have.

    Args:
        rows: episodes of one method at one number of evaluations.
        score: a column.
    """
    by_seed = _by_seed(rows, score)
    return by_seed.dropna(axis="columns").to_numpy(dtype=np.float64)


def _by_seed(rows: DataFrame, score: str) -> DataFrame:
    """A score of episodes, one row a seed.

    Raises:
        ValueError: an episode stands twice.
    """
    twice = rows[rows.duplicated(["seed", "episode"])]
    if len(twice):
        one = twice.iloc[0]
        raise ValueError(
            f"table must have each episode once: {one['method']}, seed {one['seed']}, "
            f"{one['evaluations']} evaluations has episode {one['episode']} twice"
        )
    return rows.pivot(index="seed", columns="episode", values=score)


def mean_interval(
    values: NDArray[np.float64], *, deviation: float = 0.0
) -> tuple[float, float, float]:
    """Mean and 95 % interval, lower and upper end; seeds and episodes are both resampled.

    Args:
        values: (seeds, episodes).
        deviation: between networks, by which the interval of one network is widened.
    """
    return paired_bootstrap(values, np.zeros_like(values), deviation=deviation)


def between_networks(episodes: DataFrame, score: str) -> float:
    """The standard deviation of a score between the networks of a method, pooled over methods.

    Args:
        episodes: of one task.
        score: "success", "coverage" or "collision".

    Returns:
        0 if no method has two networks.
    """
    networks = episodes.groupby(["method", "evaluations", "seed"])[score].mean()
    return _pooled(networks.groupby(["method", "evaluations"]))[0]


def _pooled(groups: Any) -> tuple[float, int]:
    """The deviation within groups of numbers, pooled, and its degrees of freedom."""
    counts, variances = groups.count(), groups.var().fillna(0)
    freedom = int((counts - 1).clip(lower=0).sum())
    squares = float(((counts - 1) * variances).sum())
    return (squares / freedom) ** 0.5 if freedom else 0.0, freedom


def over_networks(
    rows: DataFrame, by: Sequence[str] = ("method",), scores: Sequence[str] = ("success",)
) -> DataFrame:
    """Means of the study's rows over networks, with intervals that hold for one network, too.

    The deviation between networks is pooled over all groups of the table that have two or more,
    and the intervals are Student's with its degrees of freedom. They take the deviation for one
    number: where some rows succeed nearly always, these have too wide intervals (success deviates
    less near 0 and 1), and rows in the middle too narrow ones, of 80 to 85 % in place of 95.

    Args:
        rows: of the study.
        by: columns that tell the rows of a table apart, beside the number of evaluations.
        scores: columns of numbers, the largest best.

    Returns:
        One row a group and number of evaluations: `by`, `evaluations`, `networks`, and for each
        score, over the networks that have it, its mean, `<score>_low`, `<score>_high`, and
        `<score>_level`: whether it cannot be told from the best of the table at the same number of
        evaluations.

    Raises:
        ValueError: a column is unknown, a value of `by` is missing, or no group has two networks.
    """
    for what, names in (("by", by), ("scores", scores)):
        for name in names:
            check_choice(name, what, tuple(rows.columns))
    keys = [*by, "evaluations"]
    for name in keys:
        if missing := int(rows[name].isna().sum()):
            raise ValueError(
                f"by: {missing} of {len(rows)} rows have no {name}: fill it in, or leave them out"
            )
    groups = rows.groupby(keys, sort=False)
    found = groups.agg(networks=("seed", "count")).reset_index()
    for score in scores:
        deviation, freedom = _pooled(groups[score])
        if not freedom:
            raise ValueError(f"rows must have two networks of one kind, got one of each: {keys}")
        reach = student(freedom) * deviation
        found[score] = groups[score].mean().to_numpy()
        count = groups[score].count().where(lambda n: n > 0).reset_index(drop=True)  # that have it
        half = reach / count**0.5
        found[f"{score}_low"], found[f"{score}_high"] = found[score] - half, found[score] + half
        best = found.groupby("evaluations")[score].transform("idxmax").to_numpy()
        apart = reach * (1 / count + 1 / count.loc[best].to_numpy()) ** 0.5
        found[f"{score}_level"] = found[score].loc[best].to_numpy() - found[score] <= apart
    return found


def paired_difference(
    task: str,
    first: tuple[str, int],
    second: tuple[str, int],
    *,
    score: str = "success",
    regime: str | None = None,
    table: DataFrame | None = None,
) -> tuple[float, float, float]:
    """Mean of first minus second and its 95 % interval, over the seeds and episodes of both.

    Args:
        task: such as "push-t" or "arm-ring".
        first: a method and a number of evaluations, such as ("residual", 1).
        second: another one; it is rolled out from the same starts.
        score: "success", "coverage" or "collision".
        regime: "whole" or "replanning"; needed where the task has both.
        table: to look in; the course's if None.

    Raises:
        ValueError: the table has no such rows, or the two have no seed or episode in common.
    """
    found = episodes(task, regime=regime, table=table)
    check_choice(score, "score", tuple(s for s in SCORES if s in found))
    grids = []
    for name, (method, nfe) in (("first", first), ("second", second)):
        rows = found[(found["method"] == method) & (found["evaluations"] == nfe)]
        if rows.empty:
            raise ValueError(f"{name} must be a stored method and number, got {method!r}, {nfe}")
        grids.append(_by_seed(rows, score))
    one, other = grids[0].align(grids[1], join="inner")
    whole = one.notna().all() & other.notna().all()  # of the episodes that all seeds have
    one, other = one.loc[:, whole], other.loc[:, whole]
    if one.size == 0:
        raise ValueError(f"first and second have no episode of one seed in common: {first, second}")
    deviation = 2**0.5 * between_networks(found, score) if len(one) == 1 else 0.0
    values = (each.to_numpy(dtype=float) for each in (one, other))
    return paired_bootstrap(*values, deviation=deviation)


def wide(
    table: DataFrame, scores: Sequence[str] = ("success",), by: Sequence[str] = ("method",)
) -> DataFrame:
    """One row a method, and a column for each score and number of evaluations.

    Args:
        table: as `results` or `over_networks` returns it.
        scores: columns of it.
        by: columns that tell the rows apart.
    """
    keys = list(by)
    order = table[keys].drop_duplicates()
    found = table.pivot(index=keys, columns="evaluations", values=list(scores))
    found.columns = [f"{score} {nfe:g}" for score, nfe in found.columns]
    return order.merge(found.reset_index(), on=keys)


def level(
    table: DataFrame, scores: Sequence[str] = ("success",), by: Sequence[str] = ("method",)
) -> DataFrame:
    """What cannot be told from the best, for `plots.table`: rows and columns as of `wide`.

    Args:
        table: as `over_networks` returns it.
        scores: columns of it.
        by: columns that tell the rows apart.
    """
    found = wide(table, [f"{score}_level" for score in scores], by).drop(columns=list(by))
    return found.rename(columns=lambda name: name.replace("_level", "")).eq(True)


def curves(table: DataFrame, score: str = "success") -> dict[str, dict[str, dict[int, Any]]]:
    """The arguments `scores` and `intervals` of `plots.score_against_nfe`.

    Args:
        table: as `results` returns it.
        score: a column of it.
    """
    drawn: dict[str, dict[str, dict[int, Any]]] = {"scores": {}, "intervals": {}}
    for method, rows in table.groupby("method", sort=False):
        nfes = rows["evaluations"].tolist()
        ends = zip(rows[f"{score}_low"], rows[f"{score}_high"], strict=True)
        drawn["scores"][str(method)] = dict(zip(nfes, rows[f"{score}_of_seeds"], strict=True))
        drawn["intervals"][str(method)] = dict(zip(nfes, ends, strict=True))
    return drawn
