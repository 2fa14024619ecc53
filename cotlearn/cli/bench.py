"""`cotlearn bench`: runs the comparisons behind stored tables."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn import assets
from cotlearn.cli import policies
from cotlearn.cli.terminal import console, stop, stop_interrupted

app = typer.Typer(no_args_is_help=True, help="Runs the comparisons behind stored tables.")


@app.command("push-t")
def bench_push_t(
    methods: Annotated[
        str | None, typer.Option(help="Names with commas between; all without it.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="Numbers with commas between.")] = "0,1,2",
    episodes: Annotated[int, typer.Option(min=2, help="Paired rollouts of each policy.")] = 200,
    train_episodes: Annotated[
        int | None, typer.Option(min=1, help="Demonstrations to train on; all without it.")
    ] = None,
    held_out: Annotated[
        int, typer.Option(min=1, help="Demonstrations kept for the energy score.")
    ] = 200,
    steps: policies.Steps = 15_000,
    batch_size: policies.Batch = 256,
    clusters: policies.Clusters = 4096,
    condition_weight: policies.Weight = None,
    frame: policies.Frame = "body",
    network: policies.Network = "mlp",
    data: policies.Data = None,
    folder: Annotated[Path | None, typer.Option(help="Of the cells.")] = None,
    weights: Annotated[Path | None, typer.Option(help="Of policies and checkpoints.")] = None,
    summary: Annotated[Path | None, typer.Option(help="The file about all cells.")] = None,
) -> None:
    """Compares policies for Push-T: trains and rolls out the cells that are missing.

    Finished cells are skipped and an interrupted training resumes, so that the comparison can be
    completed in several goes, or by two runs side by side on different methods or seeds.
    """
    torch, episode_files = policies.robots()
    from cotlearn.robots import benchmark
    from cotlearn.robots.training import METHODS, Options

    torch.set_num_threads(1)
    results = assets.course_folder() / "data" / "results"
    folder = folder or results / "push_t"
    try:
        chosen = [name.strip() for name in methods.split(",")] if methods else list(METHODS)
        numbers = policies.numbers(seeds, "seeds")
        protocol = benchmark.Protocol(
            options=Options(
                steps=steps,
                batch_size=batch_size,
                clusters=clusters,
                condition_weight=condition_weight,
                frame=frame,
                network=network,
            ),
            train_episodes=train_episodes,
            held_out=held_out,
            episodes=episodes,
        )
        benchmark.bench(
            episode_files.read(policies.demonstrations(data)),
            folder=folder,
            methods=chosen,
            seeds=numbers,
            protocol=protocol,
            weights=weights or Path("build") / "push_t",
            say=lambda text: console.print(escape(text)),
        )
        path = summary or folder.with_suffix(".json")
        benchmark.summarise(folder, path)
    except (ValueError, FileNotFoundError, ModuleNotFoundError) as error:
        stop(str(error))
    except KeyboardInterrupt:
        stop_interrupted()
    console.print(f"summary: {escape(str(path))}")
