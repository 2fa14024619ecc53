"""The command `cotlearn`: open the course, run notebooks, make demonstrations, train, report.

Each module holds one group of commands. torch is imported only by the commands that need it.
"""

import sys

import typer

from cotlearn.cli import course, homework, policies
from cotlearn.cli.bench import bench
from cotlearn.cli.demos import demos
from cotlearn.cli.report import report
from cotlearn.cli.train import train

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A hands-on course on couplings for conditional flow matching.",
)
app.add_typer(course.app)
app.add_typer(homework.app)
app.command(cls=policies.WithTasks)(demos)
app.command(cls=policies.WithMethods)(train)
app.command(cls=policies.WithMethods)(bench)
app.command()(report)


def main() -> None:
    """Runs the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a Windows console may not know the tick of "✓"
            stream.reconfigure(errors="replace")
    # with this package jsonschema builds 38 grammars of web addresses on import, which takes 2 s
    sys.modules.setdefault("rfc3987_syntax", None)  # type: ignore[arg-type]
    app()
