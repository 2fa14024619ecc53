"""`cotlearn demos`: makes the demonstrations that the course ships."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import console, stop, stop_interrupted, stop_missing

app = typer.Typer(no_args_is_help=True, help="Makes the demonstrations that the course ships.")


@app.command("push-t")
def demos_push_t(
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes.")] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Of starts, choices and noise.")] = 0,
    out: Annotated[Path, typer.Option(help="The file to make.")] = Path("push_t_demos.npz"),
) -> None:
    """Records the planned demonstrator of Push-T; goes on where an interrupted recording stopped.

    The 4000 episodes of the course take about 5 minutes on one core.
    """
    try:
        from cotlearn.robots.experts.record import record
    except ModuleNotFoundError as error:
        stop_missing(error.name)
    try:
        about = record(out, episodes=episodes, seed=seed)
    except ValueError as error:
        stop(str(error))
    except KeyboardInterrupt:
        stop_interrupted()
    size = out.stat().st_size / 1e6
    console.print(
        f"{escape(str(out))}: {about['episodes']} episodes, {about['replaced']} of them a second "
        f"try, {size:.1f} MB"
    )
