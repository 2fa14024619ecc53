"""Output and exit of all commands: one console, error messages and missing packages."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

import typer
from rich.console import Console
from rich.markup import escape

console = Console(highlight=False, soft_wrap=True)


def stop(message: str) -> NoReturn:
    """Ends the command with a message and the exit code 2."""
    from cotlearn.homework.registry import printable

    text = escape("\n".join(printable(line, 5000) for line in message.splitlines()))
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[red]error:[/] {text}")
    raise typer.Exit(2)


def stop_missing(package: str | None) -> NoReturn:
    """Ends the command because a package of the course is not installed."""
    stop(f"{package} is not installed; install it with: pip install 'cotlearn[course]'")


@contextmanager
def reported(*more: type[Exception]) -> Iterator[None]:
    """Ends the command with a sentence if the block fails as files and values from outside do.

    Args:
        more: other kinds of errors of which the message says enough.
    """
    kinds: tuple[type[Exception], ...] = (ValueError, *more)
    try:
        yield
    except ImportError as error:
        if error.name is None:  # the message is ours, and says what to install
            stop(str(error))
        stop_missing(error.name)
    except OSError as error:
        stop(f"{error.strerror}: {error.filename}" if error.filename else str(error))
    except MemoryError as error:
        stop(f"there is not enough memory: {error}")
    except kinds as error:
        stop(str(error))
    except KeyboardInterrupt:
        stop_interrupted()


def stop_interrupted() -> NoReturn:
    """Ends an interrupted command that will resume when it is repeated."""
    console.print("stopped; run the same command again to go on")
    raise typer.Exit(130) from None
