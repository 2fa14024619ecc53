"""`cotlearn demos`: records demonstrations such as those that the course ships."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn import assets
from cotlearn.cli.terminal import console, reported


def demos(
    task: Annotated[str, typer.Argument(help="A task; or push-t-pixels, push-t as pictures.")],
    episodes: Annotated[int, typer.Option(min=1, help="Number of episodes.")] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Seed of starts, choices and noise.")] = 0,
    out: Annotated[Path | None, typer.Option(help="Default: push_t_demos.npz and so on.")] = None,
    size: Annotated[int, typer.Option(min=1, max=1024, help="Width of the pictures.")] = 96,
) -> None:
    """Records a task's planned demonstrator; an interrupted recording resumes.

    The 4000 episodes of the course take about 5 minutes for push-t and 2 for the arm, on one core.
    Pictures of 96 x 96 need 2.4 MB of memory per episode: draw a few hundred episodes at a time.
    """
    out = out or Path(f"{task.replace('-', '_')}_demos.npz")
    with reported(RuntimeError):
        from cotlearn.validation import check_output

        check_output(out, "out")
        if task == "push-t-pixels":
            said = _draw(out, episodes, size)
        else:
            from cotlearn.robots.experts.record import record

            about = record(out, task, episodes=episodes, seed=seed)
            said = f"{about['episodes']} episodes, {about['replaced']} of them a second try"
    console.print(f"{escape(str(out))}: {said}, {out.stat().st_size / 1e6:.1f} MB")


def _draw(out: Path, episodes: int, size: int) -> str:
    """Writes pictures of the first demonstrations that come with the course."""
    from cotlearn.robots.episodes import read, write_pictures

    demonstrations = read(assets.find_data("push_t_demos.npz"))
    some = demonstrations.select(range(min(episodes, len(demonstrations))))
    write_pictures(out, some, size=size)
    return f"{len(some.state)} pictures of {size} x {size}, {len(some)} episodes"
