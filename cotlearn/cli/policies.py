"""What `cotlearn train` and `cotlearn bench` share: their options and demonstrations."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from cotlearn.course import assets

if TYPE_CHECKING:
    from cotlearn.policies.settings import Setting
    from cotlearn.robots.episodes import Episodes

Name = Annotated[str, typer.Argument(help="A task; its options are the course's.")]
_LAYOUTS = "An .npz, Diffusion Policy's .zarr or LeRobot folder; default: the course's."
Data = Annotated[Path | None, typer.Option(help=_LAYOUTS)]
_TASKS = "default: the task's"
#: Fields of `policies.options.Options` that a command can change.
OPTIONS = {
    "steps": Annotated[int | None, typer.Option(min=1, help=f"Gradient steps; {_TASKS}.")],
    "batch_size": Annotated[
        int | None, typer.Option(min=1, help=f"Rows of a gradient step; {_TASKS}.")
    ],
    "learning_rate": Annotated[float | None, typer.Option(help=f"Of Adam, above 0; {_TASKS}.")],
    "clusters": Annotated[
        int | None, typer.Option(min=1, help=f"Clusters of stratified OT; {_TASKS}.")
    ],
    "condition_weight": Annotated[float | None, typer.Option(min=0, help="Default: by frontier.")],
    "frame": Annotated[str | None, typer.Option(help=f"Frame of states and actions; {_TASKS}.")],
    "label": Annotated[str | None, typer.Option(help=f"Label: intention or action; {_TASKS}.")],
    "prediction": Annotated[
        str | None, typer.Option(help=f"Of noise, data or velocity; {_TASKS}.")
    ],
}


class WithMethods(TyperCommand):
    """A command whose help ends with the tasks and methods, which are imported only then."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help."""
        from cotlearn.policies.methods import METHODS
        from cotlearn.policies.settings import SETTINGS

        rows = [f"{method.name}: {method.description}." for method in METHODS.values()]
        self.epilog = "\n\n".join([f"Tasks: {', '.join(SETTINGS)}.", "Methods:", *rows])
        super().format_help(ctx, formatter)


class WithTasks(TyperCommand):
    """A command whose help ends with the registered tasks."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        """Writes the help."""
        from cotlearn.robots.registry import TASKS

        self.epilog = f"Tasks: {', '.join(TASKS)}."
        super().format_help(ctx, formatter)


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Adds all `OPTIONS` to a command; its argument `options` is a dict of those given."""
    signature = inspect.signature(command, eval_str=True)

    @functools.wraps(command)
    def with_them(**values: Any) -> None:
        named = {name: values.pop(name) for name in OPTIONS}
        command(**values, options={k: v for k, v in named.items() if v is not None})

    own = [p for p in signature.parameters.values() if p.name != "options"]
    named = functools.partial(inspect.Parameter, kind=inspect.Parameter.KEYWORD_ONLY)
    shared = [named(name, default=None, annotation=kind) for name, kind in OPTIONS.items()]
    with_them.__signature__ = signature.replace(parameters=[*own, *shared])  # type: ignore[attr-defined]
    with_them.__annotations__ = {p.name: p.annotation for p in [*own, *shared]}
    return with_them


def setting(name: str, options: dict[str, Any], data: Path | None) -> tuple[Setting, Episodes]:
    """Returns the course's setting for a task, with these options, and its demonstrations.

    Torch is limited to one thread, as in the course.

    Raises:
        ValueError: there is no such task, an option does not fit, or data is missing or of another
            task.
    """
    import torch

    from cotlearn.policies.settings import SETTINGS
    from cotlearn.robots.episodes import read
    from cotlearn.robots.registry import find_task
    from cotlearn.validation import check_choice

    torch.set_num_threads(1)
    found = SETTINGS[check_choice(name, "task", tuple(SETTINGS))]
    task = find_task(found.task)
    if data is None and not (found.shipped and task.demonstrations):
        page = "docs/how_to/use_human_demonstrations.md says where they are"
        where = page if task.demonstrations else f"`cotlearn demos {task.name}` records them"
        raise ValueError(f"{name} needs --data, which does not come with the course; {where}")
    found = replace(found, options=replace(found.options, **options))
    episodes = read(data or assets.find_data(task.demonstrations))
    if episodes.task.name != task.name:
        shown = f"{data} holds demonstrations of {episodes.task.name}"
        raise ValueError(f"{shown}, but {name} needs those of {task.name}")
    return found, episodes


def check_simulator(setting: Setting) -> None:
    """Checks, before a training, that its policy can be rolled out after it.

    Raises:
        ModuleNotFoundError: a package that simulates the task is not installed.
    """
    from cotlearn.robots.registry import find_task

    for package in find_task(setting.task).packages:
        if find_spec(package) is None:
            raise ModuleNotFoundError(name=package)


def numbers(text: str, name: str) -> list[int]:
    """Returns the integers in a text such as "0,1,2"."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(f"{name} must be integers with commas between, got {text!r}") from None
