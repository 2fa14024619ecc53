"""`cotlearn bench`: trains and rolls out policies, and adds their rows to the stored tables."""

import functools
from pathlib import Path
from typing import Annotated, Any

import typer

from cotlearn.cli import policies
from cotlearn.cli.terminal import console, reported
from cotlearn.course import assets
from cotlearn.files import check_input, check_output, check_separate
from cotlearn.interrupt import loading

NO_COLUMN = ("batch_size", "label")  #: options that the study notes


@policies.with_options
def bench(
    name: policies.Name,
    options: dict[str, Any],
    methods: Annotated[list[str] | None, typer.Argument(help="Default: the course's.")] = None,
    seeds: Annotated[str, typer.Option(help="Numbers, separated by commas.")] = "0,1,2",
    episodes: Annotated[int, typer.Option(min=2, help="Paired rollouts of each policy.")] = 200,
    train_episodes: Annotated[int | None, typer.Option(min=1, help="Most to train on.")] = None,
    data: policies.Data = None,
    tables: Annotated[Path | None, typer.Option(help="Folder of the two tables.")] = None,
    weights: Annotated[Path | None, typer.Option(help="Folder of the policies.")] = None,
    executor: Annotated[str, typer.Option(help="Of the cells: local, dask or ray.")] = "local",
) -> None:
    """Trains and rolls out policies for a task, and adds rows to the tables of results.

    With the course's options rows go into episodes.csv.gz and study.csv, with others into study.csv
    only. Cells that are there are skipped and an interrupted training resumes; runs can work side
    by side on other methods or seeds.
    """
    root = assets.checkout()
    tables = tables or (root / "data" / "results" if root else Path("results"))
    weights = weights or Path("build") / "bench" / "_".join([name, *map(str, options.values())])
    with reported():
        for folder in (tables, weights):
            check_output(folder / "file", "tables or weights")
        check_separate(data=data, tables=tables / "study.csv")
        check_separate(data=data, weights=weights / "file")
        if data is not None:
            check_input(data, "data")
        with loading():
            from cotlearn.policies.bench import EPISODES
            from cotlearn.policies.bench import bench as run

        setting, demonstrations = policies.setting(name, options, data)
        policies.check_simulator(setting)
        run(
            setting,
            demonstrations,
            methods=methods or setting.methods,
            seeds=policies.numbers(seeds, "seeds"),
            weights=weights,
            episodes_table=tables / "episodes.csv.gz",
            study_table=tables / "study.csv",
            course=not options and train_episodes is None and episodes == EPISODES,
            episodes=episodes,
            train_episodes=train_episodes,
            note=", ".join(f"{name} {options[name]}" for name in NO_COLUMN if name in options),
            executor=executor,
            say=functools.partial(console.print, markup=False),
        )
