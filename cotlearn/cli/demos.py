"""`cotlearn demos`: makes the demonstrations that the course ships."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import console, stop, stop_interrupted, stop_missing

app = typer.Typer(no_args_is_help=True, help="Makes the demonstrations that the course ships.")

Episodes = Annotated[int, typer.Option(min=1, help="How many episodes.")]
Seed = Annotated[int, typer.Option(min=0, help="Of starts, choices and noise.")]
Out = Annotated[Path, typer.Option(help="The file to make.")]


@app.command("push-t")
def demos_push_t(
    episodes: Episodes = 4000, seed: Seed = 0, out: Out = Path("push_t_demos.npz")
) -> None:
    """Records the planned demonstrator of Push-T; goes on where an interrupted recording stopped.

    The 4000 episodes of the course take about 5 minutes on one core.
    """
    _record("push-t", episodes, seed, out)


@app.command("arm-ring")
def demos_arm_ring(
    episodes: Episodes = 4000, seed: Seed = 0, out: Out = Path("arm_ring_demos.npz")
) -> None:
    """Records the arm that reaches round a pillar; goes on where a recording was interrupted.

    The 4000 episodes of the course take about 2 minutes on one core.
    """
    _record("arm-ring", episodes, seed, out)


@app.command("arm-avoid")
def demos_arm_avoid(
    episodes: Episodes = 4000, seed: Seed = 0, out: Out = Path("arm_avoid_demos.npz")
) -> None:
    """Records the arm between two rows of pillars; goes on where a recording was interrupted.

    The 4000 episodes of the course take about 2 minutes on one core.
    """
    _record("arm-avoid", episodes, seed, out)


def _record(task: str, episodes: int, seed: int, out: Path) -> None:
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
