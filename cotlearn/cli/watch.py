"""`cotlearn watch`: see what a policy does. `cotlearn play`: the playground."""

from __future__ import annotations

import tempfile
import webbrowser
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import SEED, console, reported
from cotlearn.files import check_input, check_output, check_separate
from cotlearn.interrupt import loading


def watch(
    task: Annotated[str, typer.Argument(help="push-t or arm-ring.")],
    policy: Annotated[list[Path], typer.Option(help="A file of weights; repeat it to compare.")],
    nfe: Annotated[int, typer.Option(min=1, help="Evaluations for each decision.")] = 1,
    episodes: Annotated[int, typer.Option(min=1, max=20, help="Number of starts.")] = 3,
    seed: Annotated[int, typer.Option(**SEED, help="Of the first start.")] = 1_000_000,
    out: Annotated[Path | None, typer.Option(help="An .html or .gif to write.")] = None,
) -> None:
    """Rolls policies out from the same starts, and shows them side by side in the browser.

    With --out it writes a self-contained page, or a GIF of the first start, and opens nothing.
    """
    with reported(TypeError, RuntimeError):
        for path in policy:
            check_input(path, "policy")
        with loading():
            import torch

            from cotlearn.play import write_page
            from cotlearn.play.film import write_film
            from cotlearn.play.replay import TASKS, compare
            from cotlearn.policies.policy import ChunkPolicy
            from cotlearn.validation import check_choice

        torch.set_num_threads(1)
        check_choice(task, "task", TASKS)
        kind = out.suffix.lower() if out else ".html"
        check_choice(kind, "suffix of out", (".html", ".gif"))
        if out:
            check_output(out, "out")
        for path in policy:
            check_separate(policy=path, out=out)
        stems = [path.stem for path in policy]
        titles = stems if len(set(stems)) == len(stems) else [str(path) for path in policy]
        policies = {t: ChunkPolicy.load(path) for t, path in zip(titles, policy, strict=True)}
        found = compare(task, policies, [nfe], range(seed, seed + episodes), progress=None)
        for name, runs in found["runs"].items():
            ends = ", ".join(end["words"] for end in runs[str(nfe)]["outcomes"])
            console.print(f"{escape(name)}: {ends}")
        if kind == ".gif":
            written = write_film(out or Path(), task, found)
        else:
            target = out or new_file("watch.html")
            written = write_page(target, panels={"robots": {"tasks": {task: found}}})
    show(written, opened=out is None)


def play(
    out: Annotated[Path | None, typer.Option(help="Write the page here and open nothing.")] = None,
) -> None:
    """Opens the playground: couplings, samples, robots and results, by hand in the browser."""
    with reported():
        from cotlearn.play import write_page
        from cotlearn.validation import check_choice

        check_choice(out.suffix.lower() if out else ".html", "suffix of out", (".html",))
        written = write_page(out or new_file("playground.html"))
    show(written, opened=out is None)


def new_file(name: str) -> Path:
    """A file in a new temporary folder, which the browser can read after the command has ended."""
    return Path(tempfile.mkdtemp(prefix="cotlearn-")) / name


def show(path: Path, *, opened: bool) -> None:
    """Prints where the page is, and opens it if nobody said where to write it."""
    console.print(f"{escape(str(path))}: {path.stat().st_size / 1e6:.1f} MB")
    if opened and not webbrowser.open(path.resolve().as_uri()):
        console.print("no browser found: open this file in one")
