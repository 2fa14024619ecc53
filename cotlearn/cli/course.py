"""`cotlearn lab`, `run` and `doctor`: open the course, run notebooks, check the machine."""

from __future__ import annotations

import contextlib
import difflib
import importlib.util
import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.markup import escape
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text
from typer.core import TyperCommand

from cotlearn.cli.terminal import console, reported, stop_missing
from cotlearn.course import assets, assignments, copies, record
from cotlearn.extras import how_to_install
from cotlearn.files import check_output
from cotlearn.interrupt import loading, raise_again
from cotlearn.progress import watched

if TYPE_CHECKING:
    from cotlearn.course.execution import Run

FIRST_NOTEBOOK = "00_start_here.ipynb"
#: Settings of JupyterLab: no question about news.
CONFIG = Path(__file__).with_name("jupyter")
SECONDS_TO_END = 2  #: that JupyterLab has to end its kernels after Ctrl-C

app = typer.Typer()


class Lab(TyperCommand):
    """The command with an error of its own for `--fresh` without a notebook."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Parses the words of the command line."""
        if args[-1:] == ["--fresh"]:
            ctx.fail("--fresh needs a notebook, for example: cotlearn lab --fresh 03")
        return list(super().parse_args(ctx, args))


@app.command(cls=Lab, context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def lab(
    context: typer.Context,
    to: Annotated[
        Path | None, typer.Option(help=f"Folder of your copies; default: {copies.FOLDER}.")
    ] = None,
    fresh: Annotated[
        list[str] | None, typer.Option(help="Start this notebook (03) over; yours is kept.")
    ] = None,
    with_outputs: Annotated[
        bool, typer.Option("--with-outputs", help="New copies keep the stored outputs.")
    ] = False,
) -> None:
    """Opens your copies of the notebooks in JupyterLab; other options, as --port, go to it.

    The first time they are copied, without outputs; later only those that are new.
    """
    if importlib.util.find_spec("jupyterlab") is None:
        stop_missing("JupyterLab")
    for word in (arg.partition("=")[0] for arg in context.args if arg.startswith("--")):
        if near := difflib.get_close_matches(
            word, ("--fresh", "--to", "--with-outputs"), cutoff=0.8
        ):
            context.fail(f"No such option: {word} Did you mean {near[0]}?")
    with reported():
        own = to.resolve() if to is not None else copies.folder()
        first = own / FIRST_NOTEBOOK
        for name in fresh or []:
            first, old = copies.renew(name, own, outputs=with_outputs)
            was = f"; yours is now {escape(old.name)}" if old is not None else ""
            record.forget(item.name for item in assignments.read(first, name).questions)
            console.print(f"{escape(first.name)} starts over{was}")
        copied, kept = copies.make(own, outputs=with_outputs)
    if copied:
        note = "" if with_outputs else ", outputs cleared"
        console.print(
            f"{len(copied)} notebooks copied to {escape(str(own))}{note}, {len(kept)} kept"
        )
    course = assets.course_folder()
    root = course if own.is_relative_to(course) else own
    page = first.relative_to(root).as_posix()
    options = [f"--ServerApp.root_dir={root}", f"--LabApp.default_url=/lab/tree/{page}"]
    options.append("--ServerApp.contents_manager_class=cotlearn.course.saving.SameEverywhere")
    options.append("--ServerApp.answer_yes=True")  # Ctrl-C ends it without a question
    if sys.platform != "win32":  # a login shell would forget the PATH, and with it this command
        shell = {"shell_command": [os.environ.get("SHELL") or "sh"]}
        options.append(f"--ServerApp.terminado_settings={shell}")
    if not _has_display():
        options.append("--no-browser")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--allow-root")
    # This Python's own kernel comes before any other; one core, as in `cotlearn run`.
    kernels = [str(Path(sys.prefix) / "share" / "jupyter"), os.environ.get("JUPYTER_PATH", "")]
    quiet = {"OMP_NUM_THREADS": "1", "PYDEVD_DISABLE_FILE_VALIDATION": "1"}
    environment = {**quiet, **os.environ, "JUPYTER_PREFER_ENV_PATH": "1"}
    places = [str(Path(sys.executable).parent), os.environ.get("PATH", "")]
    environment["PATH"] = os.pathsep.join(filter(None, places))  # for `cotlearn` in a terminal
    environment.setdefault("JUPYTERLAB_WORKSPACES_DIR", str(own / ".jupyterlab"))  # own tabs
    environment["JUPYTER_PATH"] = os.pathsep.join(filter(None, kernels))
    configured = [str(CONFIG), os.environ.get("JUPYTER_CONFIG_PATH", "")]
    environment["JUPYTER_CONFIG_PATH"] = os.pathsep.join(filter(None, configured))
    command = [sys.executable, "-m", "jupyterlab", *options, *context.args]
    raise typer.Exit(_serve(command, environment))


def _serve(command: list[str], environment: dict[str, str]) -> int:
    """Runs a server until it ends, and returns its exit code; 130 if Ctrl-C ended it.

    The server ignores Ctrl-C until it has loaded and handles it: an exception in its imports would
    be a traceback. It is this process that ends it.
    """
    raise_again()
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        server = subprocess.Popen(command, env=environment)
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        return server.wait()
    except KeyboardInterrupt:
        server.terminate()
        with contextlib.suppress(subprocess.TimeoutExpired, KeyboardInterrupt):
            server.wait(SECONDS_TO_END)
        server.kill()  # does nothing if it has ended; its kernels notice and end themselves
        console.print("stopped")
        return 130


def _has_display() -> bool:
    if sys.platform in {"win32", "darwin"}:
        return not os.environ.get("SSH_CONNECTION")
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@app.command()
def run(
    notebook: Annotated[
        list[str] | None, typer.Argument(help="Numbers, paths, homework (hw1: your copy); or all.")
    ] = None,
    inplace: Annotated[bool, typer.Option("--inplace", help="Store the outputs.")] = False,
    html: Annotated[Path | None, typer.Option(help="Folder of HTML pages to write.")] = None,
    timeout: Annotated[int, typer.Option(min=1, help="Time limit per cell, in seconds.")] = 300,
) -> None:
    """Executes notebooks without a browser and reports how long each took."""
    with reported():
        paths = [copies.course_or_homework(name) for name in notebook or []]
        paths = paths or assets.all_notebooks()
        if not paths:
            raise ValueError(f"no notebooks in {assets.course_folder()}; get the course again")
        if html is not None:
            check_output(html / "index.html", "html")
        for path in paths if inplace else []:
            check_output(path, "notebook")
        with loading():
            from cotlearn.course import execution, pages
        runs = []
        for path in paths:
            if html is not None and not inplace and (done := pages.kept(path, html)):
                console.print(f"{escape(path.stem)} was executed before the stop")
                runs.append(done)
                continue
            if not watched():  # else there is a bar
                console.print(f"executing {escape(path.stem)} ...")
            done = execution.execute(path, timeout=timeout)
            runs.append(done)
            _report(done)
            if inplace and not done.error:
                execution.store(done)
            if html is not None:
                pages.to_html(done, html)
                if not done.error:
                    pages.keep(done, html)
        index = None
        if html is not None:
            index = pages.write_index(runs, html)
            pages.forget(html)
    failed = sum(bool(item.error) for item in runs)
    if len(runs) > 1:
        seconds, claims = sum(item.seconds for item in runs), sum(item.claims for item in runs)
        found = f"{len(runs)} notebooks, {seconds:.1f} s, {claims} claims passed, {failed} failed"
        console.print(found)
    if index is not None:
        console.print(f"to read: {escape(str(index))}")
    raise typer.Exit(1 if failed else 0)


def _report(done: Run) -> None:
    mark = "[red]✗[/]" if done.error else "[green]✓[/]"
    claims = "1 claim" if done.claims == 1 else f"{done.claims} claims"
    words, stem = f"{claims} passed", escape(done.path.stem)
    if not done.error and re.fullmatch(r"hw\d+", stem):  # it runs without an answer, too
        mark, words = "·", f"executed; cotlearn check {stem} judges the answers"
    console.print(f"{mark} {stem:<28} {done.seconds:6.1f} s   {words}")
    if done.failed is not None:
        source = done.notebook.cells[done.failed].source
        console.print(f"\n[red]cell {done.failed} of {escape(str(done.path))} failed:[/]\n")
        console.print(Syntax(source, "python", background_color="default"), "")
        console.print(Text.from_ansi(done.error))


@app.command()
def doctor() -> None:
    """Checks this machine; for each missing part it prints the command that fixes it."""
    from cotlearn.course import doctor as examination

    findings = examination.examine()
    table = Table(box=None, pad_edge=False, show_header=False)
    for finding in findings:
        mark = "[green]✓[/]" if finding.ok else "[red]✗[/]" if finding.required else "[yellow]![/]"
        table.add_row(mark, escape(finding.name), escape(finding.found))
    console.print(table)
    missing = [finding for finding in findings if not finding.ok]
    if not any(finding.required for finding in missing) and assets.checkout() is None:
        console.print("\nThe library has all it needs; what is marked ! is for the course.")
        console.print(f"The course: clone or unpack it, then {escape(how_to_install('course'))}")
        raise typer.Exit(0)
    for finding in missing:
        kind = "needed" if finding.required else "good to have"
        console.print(f"\n[bold]{escape(finding.name)}[/] ({kind}): fix it with")
        console.print(f"    {escape(finding.remedy)}")
    needed = [finding.name for finding in missing if finding.required]
    others = [finding.name for finding in missing if not finding.required]
    told = f"Needed and not there: {', '.join(needed)}. " if needed else ""
    told += (
        f"Not there, and some parts of the course need it: {', '.join(others)}." if others else ""
    )
    console.print(f"\n{escape(told.strip() or 'The course has all it needs.')}")
    if any(finding.course for finding in missing):
        console.print(f"All of the course at once: {escape(how_to_install('course'))}")
    raise typer.Exit(1 if needed else 0)
