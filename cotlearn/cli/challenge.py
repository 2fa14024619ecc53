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
    out: Annotated[Path, typer.Option(help="The table (.csv); the page lies beside it.")] = Path(
        "leaderboard.csv"
    ),
    name: Annotated[str, typer.Option(help="Of your row; default: the file's.")] = "",
    seed: Annotated[
        int | None, typer.Option(**SEED, envvar="CHALLENGE_SEED", help="Of the data; default: 0.")
    ] = None,
    steps: Annotated[
        int | None, typer.Option(min=1, help="Fewer only to try; default: 1500, which count.")
    ] = None,
) -> None:
    """Trains a coupling on four tasks at a fixed budget and adds it to a leaderboard.

    Those of the course's couplings that it lacks come first; without a file it is only completed,
    with its own seed and steps, and shown. One leaderboard holds one seed and one number of steps,
    and says both. The file is run as it is: of strangers' files, only in a container.
    """
    with reported(TypeError, RuntimeError):
        check_output(out, "out")
        check_separate(file=file, out=out, page=out.with_suffix(".html"))
        if out.suffix.lower() != ".csv":
            beside = "the page lies beside it"
            raise ValueError(f"out must be a file such as leaderboard.csv ({beside}), got {out}")
        if file is not None:
            check_input(file, "file")
        with loading():
            import torch

            from cotlearn.course import challenge as rules

        torch.set_num_threads(1)
        # without a file the leaderboard goes on as it began
        begun = rules.setting(rules.leaderboard(out)) if file is None else None
        usual_seed, usual_steps = begun or (0, rules.STEPS)
        chosen = usual_seed if seed is None else seed
        budget = usual_steps if steps is None else steps
        table = rules.board(out, chosen, budget)
        there = {*table["coupling"]}
        entries = {row: make for row, make in rules.COURSE.items() if row not in there}
        if file is not None:
            own = name or file.stem
            if own in rules.COURSE:
                raise ValueError(f"name must be none of {', '.join(rules.COURSE)}, got {own}")
            rules.attempt(file, chosen)  # what is wrong with it is said before any training
            entries[own] = lambda: rules.load(file)
        for row, make in entries.items():
            entry = rules.compete(row, make, chosen, steps=budget)
            table = rules.add(entry, out)
            console.print(f"{escape(row)}: {entry.score:.3f} in {entry.seconds:.0f} s")
        page = rules.write_page(table, out)
        console.print(f"seed {chosen}, {budget} steps")
        ranked = table[["coupling", "score"]].set_axis(range(1, len(table) + 1))
        console.print(escape(ranked.to_string()))
        console.print(f"table: {escape(str(out))}; page: {escape(str(page))}")
