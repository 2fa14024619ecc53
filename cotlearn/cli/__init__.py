"""The command `cotlearn`: open the course, run notebooks, record demonstrations, train, look.

Each module holds one group of commands. torch is imported only by the commands that need it.
"""

import sys
from importlib.metadata import version
from typing import Annotated

import typer

from cotlearn.cli import course, homework, policies
from cotlearn.cli.bench import bench
from cotlearn.cli.challenge import challenge
from cotlearn.cli.demos import demos
from cotlearn.cli.report import report
from cotlearn.cli.train import train
from cotlearn.cli.watch import play, watch

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.add_typer(course.app)
app.add_typer(homework.app)
app.command(cls=policies.WithTasks)(demos)
app.command(cls=policies.WithMethods)(train)
app.command(cls=policies.WithMethods)(bench)
app.command()(report)
app.command()(watch)
app.command()(play)
app.command()(challenge)

PANELS = {
    "Learn": ("lab", "play", "check", "progress", "run", "doctor"),
    "Use": ("report", "demos", "train", "bench", "watch"),
    "Teach": ("grade", "homework", "challenge"),
}
for group in (app, course.app, homework.app):
    for command in group.registered_commands:
        name = command.name or command.callback.__name__  # type: ignore[union-attr]
        [command.rich_help_panel] = [panel for panel, names in PANELS.items() if name in names]


def said(asked: bool) -> None:
    """Prints the version and ends."""
    if asked:
        typer.echo(version("cotlearn"))
        raise typer.Exit


@app.callback()
def options(
    _: Annotated[
        bool, typer.Option("--version", callback=said, is_eager=True, help="Prints the version.")
    ] = False,
) -> None:
    """A hands-on course on couplings for conditional flow matching."""


def main() -> None:
    """Runs the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a Windows console may not know the tick of "✓"
            stream.reconfigure(errors="replace")
    # with this package jsonschema builds 38 grammars of web addresses on import, which takes 2 s
    sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
    app()
