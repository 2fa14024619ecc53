"""What all commands say and how they end: one console, errors, and what is not installed."""

from __future__ import annotations

from typing import NoReturn

import typer
from rich.console import Console
from rich.markup import escape

console = Console(highlight=False, soft_wrap=True)


def stop(message: str) -> NoReturn:
    """Ends the command with a message and the exit code 2."""
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[red]error:[/] {escape(message)}")
    raise typer.Exit(2)


def stop_missing(package: str | None) -> NoReturn:
    """Ends the command because a package of the course is not installed."""
    stop(f"{package} is not installed; install it with: pip install 'cotlearn[course]'")


def stop_interrupted() -> NoReturn:
    """Ends a command that goes on where it was when it is given again."""
    console.print("stopped; run the same command again to go on")
    raise typer.Exit(130) from None
