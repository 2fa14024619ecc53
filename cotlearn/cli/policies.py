"""What `cotlearn train` and `cotlearn bench` share: their options and demonstrations."""

from __future__ import annotations

from pathlib import Path
from types import ModuleType
from typing import Annotated

import typer

from cotlearn import assets
from cotlearn.cli.terminal import stop_missing

DEMONSTRATIONS = "push_t_demos.npz"
Data = Annotated[
    Path | None,
    typer.Option(
        help="Demonstrations: .npz, Diffusion Policy's .zarr, or a LeRobot folder. "
        "Without it those of the course."
    ),
]
Steps = Annotated[int, typer.Option(min=1, help="Gradient steps.")]
Batch = Annotated[int, typer.Option(min=1, help="Rows of a gradient step.")]
Clusters = Annotated[int, typer.Option(min=1, help="Of stratified OT.")]
Weight = Annotated[
    float | None, typer.Option(min=0, help="Of COT; without it the frontier chooses.")
]
Frame = Annotated[str, typer.Option(help="What a policy sees and says: body or world.")]
Network = Annotated[str, typer.Option(help="mlp or unet.")]


def robots() -> tuple[ModuleType, ModuleType]:
    """Returns torch and the reader of demonstrations, or says what is missing."""
    try:
        import torch

        from cotlearn.robots import episodes
    except ModuleNotFoundError as error:
        stop_missing(error.name)
    return torch, episodes


def demonstrations(data: Path | None) -> Path:
    """Returns the path that was given, or that of the course's demonstrations."""
    return assets.find_data(DEMONSTRATIONS) if data is None else data


def numbers(text: str, name: str) -> list[int]:
    """Returns the whole numbers of a text such as "0,1,2"."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(
            f"{name} must be whole numbers with commas between, got {text!r}"
        ) from None
