"""`cotlearn report`: recommends a coupling for your own data and writes a page about it."""

import functools
import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape

from cotlearn.cli.terminal import SEED, console, reported
from cotlearn.files import check_input, check_output, check_separate
from cotlearn.interrupt import loading


def report(
    data: Annotated[Path, typer.Argument(help="An .npz with x1 and c, .zarr or LeRobot folder.")],
    out: Annotated[Path, typer.Option(help="The page to write, an .html.")] = Path("report.html"),
    model: Annotated[Path | None, typer.Option(help="Default: OUT with .safetensors.")] = None,
    steps: Annotated[int, typer.Option(min=1, help="Gradient steps of each training.")] = 2000,
    observe: Annotated[int, typer.Option(min=1, help="States in c, for recorded episodes.")] = 2,
    predict: Annotated[int, typer.Option(min=1, help="Actions in x1, for recorded episodes.")] = 16,
    seed: Annotated[int, typer.Option(**SEED, help="Seed of everything.")] = 0,
) -> None:
    """Examines your data, recommends a coupling, trains with it and tests it; about two minutes.

    The page contains its figures and needs no network. Interrupted trainings resume.
    """
    with reported(TypeError, RuntimeError):
        check_output(out, "out")
        model = check_output(model or out.with_suffix(".safetensors"), "model")
        check_separate(data=data, out=out, model=model)
        if out.suffix.lower() != ".html":
            raise ValueError(f"--out must end in .html, as the page is HTML; got {out}")
        check_input(data, "data")
        console.print(f"reading {escape(str(data))}")
        with loading():
            import torch

            from cotlearn.report import examine, read_data, write_page
            from cotlearn.report.findings import TRAININGS

        torch.set_num_threads(1)
        checkpoints = out.with_name(f".{out.name}")
        rows = read_data(data, observe=observe, predict=predict)
        console.print(f"{escape(rows.data.name)}: {escape(rows.about)}")
        for note in rows.notes:
            console.print(f"note: {escape(note)}")
        say = functools.partial(console.print, markup=False)
        found = examine(rows, steps=steps, seed=seed, checkpoints=checkpoints, say=say)
        found.model.save(model)
        command = shlex.join(["cotlearn", *sys.argv[1:]])
        write_page(found, out, command=command, model=model)
        for word in TRAININGS:
            Path(f"{checkpoints}.{word}.training.safetensors").unlink(missing_ok=True)
    console.print(f"{escape(found.headline())}\n{escape(found.verdict())}")
    console.print(f"page: {escape(str(out))}\nmodel: {escape(str(model))}")
