"""`cotlearn demos`: makes the demonstrations that the course ships."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import console, stop, stop_interrupted, stop_missing


def demos(
    task: Annotated[
        str,
        typer.Argument(
            help="push-t; arm-ring, where the arm reaches round a pillar; or arm-avoid, where it "
            "finds its way between two rows of them."
        ),
    ],
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes.")] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Of starts, choices and noise.")] = 0,
    out: Annotated[
        Path | None, typer.Option(help="The file to make; push_t_demos.npz and so on without it.")
    ] = None,
) -> None:
    """Records the planned demonstrator of a task; goes on where a recording was interrupted.

    The 4000 episodes of the course take about 5 minutes for push-t and 2 for the arm, on one core.
    """
    out = out or Path(f"{task.replace('-', '_')}_demos.npz")
    try:
        from cotlearn.robots.experts.record import record

        about = record(out, task, episodes=episodes, seed=seed)
    except ModuleNotFoundError as error:
        stop_missing(error.name)
    except (ImportError, ValueError) as error:  # a MuJoCo of the wrong version, another recording
        stop(str(error))
    except KeyboardInterrupt:
        stop_interrupted()
    size = out.stat().st_size / 1e6
    console.print(
        f"{escape(str(out))}: {about['episodes']} episodes, {about['replaced']} of them a second "
        f"try, {size:.1f} MB"
    )
