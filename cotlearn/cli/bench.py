"""`cotlearn bench`: runs the comparisons behind the course's stored tables."""

import functools
from pathlib import Path
from typing import Annotated, Any

import typer

from cotlearn import assets
from cotlearn.cli import policies
from cotlearn.cli.terminal import console, reported


@policies.with_options
def bench(
    name: policies.Name,
    options: dict[str, Any],
    methods: Annotated[str | None, typer.Option(help="Names with commas; default: all.")] = None,
    seeds: Annotated[str, typer.Option(help="Numbers, separated by commas.")] = "0,1,2",
    episodes: Annotated[int, typer.Option(min=2, help="Paired rollouts of each policy.")] = 200,
    train_episodes: Annotated[int | None, typer.Option(min=1, help="Most to train on.")] = None,
    held_out: Annotated[int | None, typer.Option(min=1, help="Kept for the energy score.")] = None,
    data: policies.Data = None,
    folder: Annotated[Path | None, typer.Option(help="Folder of the cells.")] = None,
    weights: Annotated[Path | None, typer.Option(help="Folder of the policies.")] = None,
    summary: Annotated[Path | None, typer.Option(help="Summary of all cells, a file.")] = None,
    executor: Annotated[str, typer.Option(help="Of the cells: local, dask or ray.")] = "local",
    latency: Annotated[bool, typer.Option("--latency", help="Only remeasure it.")] = False,
) -> None:
    """Compares policies for a task: trains and rolls out all cells that are missing.

    Finished cells are skipped and an interrupted training resumes. So a comparison can be completed
    in several runs, one after the other, or in parallel on different methods or seeds.
    """
    short, root = name.replace("-", "_"), assets.checkout()
    places = ("benchmarks/results", "data/results") if root else ("results", "results")
    cells, table = ((root or Path()) / place / short for place in places)
    summary = summary or (folder or table).with_suffix(".json")
    folder, weights = folder or cells, weights or Path("build") / short
    say = functools.partial(console.print, markup=False)
    with reported():
        from cotlearn.policies.comparison import cells as comparison
        from cotlearn.policies.comparison.cells import Protocol
        from cotlearn.policies.comparison.summary import summarise
        from cotlearn.validation import check_output

        for path in (summary, folder / "cell", weights / "cell"):
            check_output(path, "summary, folder or weights")
        setting, demonstrations = policies.setting(name, options, data)
        if latency:
            comparison.measure_latency(folder, weights=weights, say=say)
        else:
            sizes = train_episodes, held_out or setting.held_out, episodes
            comparison.bench(
                demonstrations,
                folder=folder,
                methods=[m.strip() for m in methods.split(",")] if methods else setting.methods,
                seeds=policies.numbers(seeds, "seeds"),
                protocol=Protocol(setting.options, *sizes, temperatures=setting.temperatures),
                weights=weights,
                executor=executor,
                say=say,
            )
        summarise(folder, summary, command=f"cotlearn bench {name}")
    say(f"summary: {summary}")
