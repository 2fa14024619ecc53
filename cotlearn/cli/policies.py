"""What `cotlearn train` and `cotlearn bench` share: their options and demonstrations."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cotlearn import assets
from cotlearn.cli.terminal import stop_missing

if TYPE_CHECKING:
    from cotlearn.robots.settings import Setting

Name = Annotated[
    str,
    typer.Argument(
        help="push-t, arm-ring, arm-avoid; or arm-ring-receding, arm-avoid-receding, where the arm "
        "looks again after every few steps."
    ),
]
Data = Annotated[
    Path | None,
    typer.Option(
        help="Demonstrations: .npz, Diffusion Policy's .zarr, or a LeRobot folder. "
        "Without it those of the course."
    ),
]
Steps = Annotated[int | None, typer.Option(min=1, help="Gradient steps.")]
Batch = Annotated[int | None, typer.Option(min=1, help="Rows of a gradient step.")]
Clusters = Annotated[int | None, typer.Option(min=1, help="Of stratified OT.")]
Weight = Annotated[
    float | None, typer.Option(min=0, help="Of COT; without it the frontier chooses.")
]
Frame = Annotated[str | None, typer.Option(help="What a policy sees and says.")]
Label = Annotated[str | None, typer.Option(help="intention or action.")]
Network = Annotated[str | None, typer.Option(help="mlp or unet.")]


def robots() -> tuple[ModuleType, ModuleType]:
    """Returns torch and the reader of demonstrations, or says what is missing."""
    try:
        import torch

        from cotlearn.robots import episodes
    except ModuleNotFoundError as error:
        stop_missing(error.name)
    return torch, episodes


def setting(name: str, **given: Any) -> Setting:
    """The course's setting of this name, with the options that were given.

    Raises:
        ValueError: there is none of this name, or an option does not fit.
    """
    from cotlearn.robots.settings import SETTINGS
    from cotlearn.validation import check_choice

    found = SETTINGS[check_choice(name, "task", tuple(SETTINGS))]
    chosen = {key: value for key, value in given.items() if value is not None}
    return replace(found, options=replace(found.options, **chosen))


def demonstrations(data: Path | None, setting: Setting) -> Path:
    """Returns the path that was given, or that of the course's demonstrations."""
    return assets.find_data(setting.demonstrations) if data is None else data


def numbers(text: str, name: str) -> list[int]:
    """Returns the whole numbers of a text such as "0,1,2"."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(
            f"{name} must be whole numbers with commas between, got {text!r}"
        ) from None
