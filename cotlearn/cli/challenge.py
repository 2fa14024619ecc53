"""`cotlearn challenge`: a coupling of your own against those of the course."""

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import SEED, console, reported
from cotlearn.files import check_input, check_output, check_separate
from cotlearn.interrupt import loading


def challenge(
    file: Annotated[Path | None, typer.Argument(help="Defines `coupling`; default: none.")] = None,
    out: Annotated[Path, typer.Option(help="The table; the page lies beside it.")] = Path(
        "leaderboard.csv"
    ),
    name: Annotated[str, typer.Option(help="Of your row; default: the file's.")] = "",
    seed: Annotated[int, typer.Option(**SEED, envvar="SECRET_SEED", help="Of the data.")] = 0,
    steps: Annotated[int, typer.Option(min=1, help="Fewer only to try; 1500 count.")] = 1500,
) -> None:
    """Trains a coupling on four tasks at a fixed budget and adds it to a leaderboard.

    The course's couplings are the first rows of a new leaderboard. One leaderboard holds one seed.
    The file is run as it is: of strangers' files, only in a container.
    """
    with reported(TypeError, RuntimeError):
        check_output(out, "out")
        check_separate(file=file, out=out, page=out.with_suffix(".html"))
        if file is not None:
            check_input(file, "file")
        with loading():
            import torch

            from cotlearn.course import challenge as rules

        torch.set_num_threads(1)
        entries = {}
        if file is not None:
            rules.load(file)  # what is wrong with it is said before the course's are trained
            entries[name or file.stem] = lambda: rules.load(file)
        if not out.exists():
            entries = {**rules.COURSE, **entries}
        for row, make in entries.items():
            entry = rules.compete(row, make, seed, steps=steps)
            table = rules.add(entry, out)
            console.print(f"{escape(row)}: {entry.score:.3f} in {entry.seconds:.0f} s")
        if entries:
            console.print(escape(table[["coupling", "score"]].to_string()))
            console.print(
                f"table: {escape(str(out))}; page: {escape(str(out.with_suffix('.html')))}"
            )
