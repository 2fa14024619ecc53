"""Shared by all commands: the console, error messages and exit codes."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NoReturn

import typer
from rich.console import Console
from rich.markup import escape

from cotlearn.extras import how_to_install
from cotlearn.interrupt import not_lost, raise_again

LARGEST_SEED = 2**63 - 1  #: that torch takes; too long for the help


def _seed(value: int | None) -> int | None:
    if value is not None and value > LARGEST_SEED:
        raise typer.BadParameter(f"{value} is above {LARGEST_SEED}.")
    return value


#: The seeds that torch takes, for an option.
SEED: dict[str, Any] = {"min": 0, "callback": _seed}

console = Console(highlight=False, soft_wrap=True)


def stop(message: str) -> NoReturn:
    """Ends the command with a message and the exit code 2."""
    from cotlearn.course.checking import printable

    text = escape("\n".join(printable(line, 5000) for line in message.splitlines()))
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[red]error:[/] {text}")
    raise typer.Exit(2)


def stop_missing(package: str | None) -> NoReturn:
    """Ends the command with the name of a missing package and how to install it."""
    extra = "peers" if package in ("distributed", "ray") else "course"
    stop(f"{package} is not installed; install it with: {how_to_install(extra)}")


@contextmanager
def reported(*more: type[Exception]) -> Iterator[None]:
    """Turns the errors that a user can cause into one sentence and the exit code 2.

    These are ValueError, OSError, MemoryError and missing packages; Ctrl-C exits with 130.

    Args:
        more: further error types whose message is enough for the user.
    """
    kinds: tuple[type[Exception], ...] = (ValueError, *more)
    raise_again()
    try:
        with not_lost():
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
        console.print("stopped; run the same command again to go on")
        raise typer.Exit(130) from None
