"""`cotlearn demos`: records demonstrations such as those that the course ships."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import SEED, console, reported
from cotlearn.files import check_output


def demos(
    task: Annotated[str, typer.Argument(help="A task.")],
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 4000,
    seed: Annotated[int, typer.Option(**SEED, help="Seed of starts, choices and noise.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Default: push_t_demos.npz and so on.")] = None,
) -> None:
    """Records a task's planned demonstrator; an interrupted recording resumes.

    The 4000 episodes of the course take about 5 minutes for push-t and 2 for the arm, on one core.
    """
    out = out or Path(f"{task.replace('-', '_')}_demos.npz")
    with reported(RuntimeError):
        check_output(out, "out")
        from cotlearn.robots.episodes.record import record

        about = record(out, task, episodes=episodes, seed=seed)
    said = f"{about['episodes']} episodes, {about['replaced']} of them a second try"
    console.print(f"{escape(str(out))}: {said}, {out.stat().st_size / 1e6:.1f} MB")
