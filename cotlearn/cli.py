"""The command `cotlearn`: open the course, run notebooks, examine the machine."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Annotated, NoReturn

import typer
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.syntax import Syntax
from rich.table import Table
from rich.text import Text

from cotlearn import assets

if TYPE_CHECKING:
    from cotlearn.execution import Run

FIRST_NOTEBOOK = "00_start_here.ipynb"

app = typer.Typer(
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_show_locals=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    help="A hands-on course on couplings for conditional flow matching.",
)
demos = typer.Typer(no_args_is_help=True, help="Makes the demonstrations that the course ships.")
app.add_typer(demos, name="demos")
training = typer.Typer(no_args_is_help=True, help="Trains policies.")
app.add_typer(training, name="train")
benches = typer.Typer(no_args_is_help=True, help="Runs the comparisons behind stored tables.")
app.add_typer(benches, name="bench")
console = Console(highlight=False, soft_wrap=True)


def main() -> None:
    """Runs the command."""
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a Windows console may not know the tick of "✓"
            stream.reconfigure(errors="replace")
    app()


@app.command(context_settings={"allow_extra_args": True, "ignore_unknown_options": True})
def lab(
    context: typer.Context,
    to: Annotated[
        Path,
        typer.Option(help="Where an installed package copies the notebooks; unused in a checkout."),
    ] = Path("cotlearn-course"),
) -> None:
    """Opens the course in JupyterLab; other options, such as --port, go to JupyterLab."""
    if importlib.util.find_spec("jupyterlab") is None:
        _stop("JupyterLab is not installed; install it with: pip install 'cotlearn[course]'")
    root = assets.checkout()
    if root is not None:
        first = f"notebooks/{FIRST_NOTEBOOK}"
    else:
        root, first = to.resolve(), FIRST_NOTEBOOK
        try:
            copied, kept = assets.copy_notebooks(root)
        except ValueError as error:
            _stop(str(error))
        console.print(f"{len(copied)} notebooks copied to {escape(str(root))}, {len(kept)} kept")
    command = [sys.executable, "-m", "jupyterlab", *lab_options(root, first, context.args)]
    try:
        code = subprocess.call(command, env=lab_environment())
    except KeyboardInterrupt:
        code = 0
    raise typer.Exit(code)


def lab_options(root: Path, first: str, extra: list[str]) -> list[str]:
    """Returns the options of JupyterLab: what to open, and what this machine makes necessary.

    Args:
        root: The folder that JupyterLab shows.
        first: The notebook to open, relative to `root`, with forward slashes.
        extra: The user's own options; they come last and win.

    Returns:
        Command line options.
    """
    options = [f"--ServerApp.root_dir={root}", f"--LabApp.default_url=/lab/tree/{first}"]
    if not _has_display():
        options.append("--no-browser")
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        options.append("--allow-root")
    return [*options, *extra]


def lab_environment() -> dict[str, str]:
    """Returns the environment of JupyterLab.

    This Python's own kernel comes before any other, and kernels compute on one core unless
    `OMP_NUM_THREADS` says otherwise (see `cotlearn.execution.execute`).
    """
    own = str(Path(sys.prefix) / "share" / "jupyter")
    path = [own, os.environ.get("JUPYTER_PATH", "")]
    return os.environ | {
        "JUPYTER_PATH": os.pathsep.join(filter(None, path)),
        "JUPYTER_PREFER_ENV_PATH": "1",
        "OMP_NUM_THREADS": os.environ.get("OMP_NUM_THREADS", "1"),
    }


def _has_display() -> bool:
    if sys.platform in {"win32", "darwin"}:
        return not os.environ.get("SSH_CONNECTION")
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@app.command()
def run(
    notebook: Annotated[
        list[str] | None,
        typer.Argument(help="Numbers (00), names (00_start_here) or paths; none: all of them."),
    ] = None,
    inplace: Annotated[
        bool, typer.Option("--inplace", help="Store the outputs in the notebook.")
    ] = False,
    html: Annotated[
        Path | None, typer.Option(help="Leave a page to read, and an index, in this folder.")
    ] = None,
    timeout: Annotated[int, typer.Option(min=1, help="Most seconds for one cell.")] = 300,
) -> None:
    """Executes notebooks without a browser and says how long each took."""
    try:
        from cotlearn import execution
    except ModuleNotFoundError as error:
        _stop(f"{error.name} is not installed; install it with: pip install 'cotlearn[course]'")
    try:
        paths = [assets.find_notebook(name) for name in notebook or []] or assets.notebooks()
    except ValueError as error:
        _stop(str(error))
    runs = []
    for path in paths:
        try:
            done = _run_with_progress(path, timeout)
        except ValueError as error:
            _stop(str(error))
        runs.append(done)
        _report(done)
        if inplace and done.failure is None:
            execution.store(done)
        if html is not None:
            execution.to_html(done, html)
    seconds = sum(item.seconds for item in runs)
    failed = sum(item.failure is not None for item in runs)
    if len(runs) > 1:
        claims = sum(item.claims for item in runs)
        console.print(
            f"{len(runs)} notebooks, {seconds:.1f} s, {claims} claims passed, {failed} failed"
        )
    if html is not None:
        console.print(f"to read: {escape(str(execution.write_index(runs, html)))}")
    raise typer.Exit(1 if failed else 0)


def _run_with_progress(path: Path, timeout: int) -> Run:
    from cotlearn import execution

    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn()
    with Progress(
        *columns,
        TextColumn("cells"),
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=not console.is_terminal,
    ) as bar:
        task = bar.add_task(escape(path.stem), total=None)
        return execution.execute(
            path,
            timeout=timeout,
            progress=lambda done, total, seconds: bar.update(task, completed=done, total=total),
        )


def _report(done: Run) -> None:
    mark = "[red]✗[/]" if done.failure else "[green]✓[/]"
    claims = "1 claim" if done.claims == 1 else f"{done.claims} claims"
    console.print(f"{mark} {escape(done.path.stem):<28} {done.seconds:6.1f} s   {claims} passed")
    if done.failure:
        console.print(f"\n[red]cell {done.failure.index} of {escape(str(done.path))} failed:[/]\n")
        console.print(Syntax(done.failure.source, "python", background_color="default"))
        console.print()
        console.print(Text.from_ansi(done.failure.traceback))


@demos.command("push-t")
def demos_push_t(
    episodes: Annotated[int, typer.Option(min=1, help="How many episodes.")] = 4000,
    seed: Annotated[int, typer.Option(min=0, help="Of starts, choices and noise.")] = 0,
    out: Annotated[Path, typer.Option(help="The file to make.")] = Path("push_t_demos.npz"),
) -> None:
    """Records the planned demonstrator of Push-T; goes on where an interrupted recording stopped.

    The 4000 episodes of the course take about 5 minutes on one core.
    """
    try:
        from cotlearn.robots.experts.record import record
    except ModuleNotFoundError as error:
        _stop(f"{error.name} is not installed; install it with: pip install 'cotlearn[course]'")
    try:
        about = record(out, episodes=episodes, seed=seed)
    except ValueError as error:
        _stop(str(error))
    except KeyboardInterrupt:
        console.print("stopped; run the same command again to go on")
        raise typer.Exit(130) from None
    size = out.stat().st_size / 1e6
    console.print(
        f"{escape(str(out))}: {about['episodes']} episodes, {about['replaced']} of them a second "
        f"try, {size:.1f} MB"
    )


DEMONSTRATIONS = "push_t_demos.npz"
_Data = Annotated[
    Path | None,
    typer.Option(
        help="Demonstrations: .npz, Diffusion Policy's .zarr, or a LeRobot folder. "
        "Without it those of the course."
    ),
]
_Steps = Annotated[int, typer.Option(min=1, help="Gradient steps.")]
_Batch = Annotated[int, typer.Option(min=1, help="Rows of a gradient step.")]
_Clusters = Annotated[int, typer.Option(min=1, help="Of stratified OT.")]
_Weight = Annotated[
    float | None, typer.Option(min=0, help="Of COT; without it the frontier chooses.")
]
_Frame = Annotated[str, typer.Option(help="What a policy sees and says: body or world.")]
_Network = Annotated[str, typer.Option(help="mlp or unet.")]


@training.command("push-t")
def train_push_t(
    coupling: Annotated[
        str,
        typer.Option(
            help="independent, minibatch_ot, conditional_ot, stratified, aligned, reflow; or "
            "behaviour_cloning or diffusion, which have none."
        ),
    ] = "stratified",
    seed: Annotated[int, typer.Option(min=0, help="Of weights, pairs and times.")] = 0,
    episodes: Annotated[
        int | None, typer.Option(min=1, help="Demonstrations to train on; all without it.")
    ] = None,
    steps: _Steps = 15_000,
    batch_size: _Batch = 256,
    clusters: _Clusters = 4096,
    condition_weight: _Weight = None,
    frame: _Frame = "body",
    network: _Network = "mlp",
    data: _Data = None,
    out: Annotated[Path, typer.Option(help="The file to make.")] = Path("push_t.safetensors"),
    rollouts: Annotated[
        int, typer.Option(min=0, help="Episodes to try each way of drawing chunks in.")
    ] = 50,
) -> None:
    """Trains a policy for Push-T, saves it, and tries it; resumes where it was interrupted."""
    torch, episode_files = _robots()
    from cotlearn.robots import benchmark
    from cotlearn.robots.rollout import rollout
    from cotlearn.robots.training import Options, train

    torch.set_num_threads(1)
    try:
        options = Options(
            steps=steps,
            batch_size=batch_size,
            clusters=clusters,
            condition_weight=condition_weight,
            frame=frame,
            network=network,
        )
        chosen = episode_files.read(_demonstrations(data))
        if episodes is not None:
            chosen = chosen.select(list(range(min(episodes, len(chosen)))))
        options = benchmark.with_weight(coupling, chosen, options)
        checkpoint = out.with_name(f"{out.stem}.training.safetensors")
        trained = train(coupling, chosen, seed=seed, options=options, checkpoint=checkpoint)
    except (ValueError, FileNotFoundError, ModuleNotFoundError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        console.print("stopped; run the same command again to go on")
        raise typer.Exit(130) from None
    trained.policy.save(out, about={"coupling": coupling, "seed": seed, "episodes": len(chosen)})
    for file in out.parent.glob(f"*{checkpoint.name}"):
        file.unlink()
    console.print(
        f"{escape(str(out))}: {trained.parameters} weights, {len(chosen)} episodes, "
        f"{trained.seconds:.0f} s"
    )
    if rollouts:
        table = Table("sampler", "coverage", "above 0.90", "above 0.95", "ms a chunk", box=None)
        for sampler in benchmark.samplers(trained.policy):
            policy = trained.policy.with_sampler(sampler)
            scores = rollout(policy, episodes=rollouts).summary()
            numbers = [f"{scores[name]:.3f}" for name in ("coverage", "success_90", "success_95")]
            table.add_row(sampler.name, *numbers, f"{1000 * policy.latency():.2f}")
        console.print(table)


@benches.command("push-t")
def bench_push_t(
    methods: Annotated[
        str | None, typer.Option(help="Names with commas between; all without it.")
    ] = None,
    seeds: Annotated[str, typer.Option(help="Numbers with commas between.")] = "0,1,2",
    episodes: Annotated[int, typer.Option(min=2, help="Paired rollouts of each policy.")] = 200,
    train_episodes: Annotated[
        int | None, typer.Option(min=1, help="Demonstrations to train on; all without it.")
    ] = None,
    held_out: Annotated[
        int, typer.Option(min=1, help="Demonstrations kept for the energy score.")
    ] = 200,
    steps: _Steps = 15_000,
    batch_size: _Batch = 256,
    clusters: _Clusters = 4096,
    condition_weight: _Weight = None,
    frame: _Frame = "body",
    network: _Network = "mlp",
    data: _Data = None,
    folder: Annotated[Path | None, typer.Option(help="Of the cells.")] = None,
    weights: Annotated[Path | None, typer.Option(help="Of policies and checkpoints.")] = None,
    summary: Annotated[Path | None, typer.Option(help="The file about all cells.")] = None,
) -> None:
    """Compares policies for Push-T: trains and rolls out the cells that are missing.

    Finished cells are skipped and an interrupted training resumes, so that the comparison can be
    completed in several goes, or by two runs side by side on different methods or seeds.
    """
    torch, episode_files = _robots()
    from cotlearn.robots import benchmark
    from cotlearn.robots.training import METHODS, Options

    torch.set_num_threads(1)
    results = assets.course_folder() / "data" / "results"
    folder = folder or results / "push_t"
    try:
        chosen = [name.strip() for name in methods.split(",")] if methods else list(METHODS)
        numbers = _numbers(seeds, "seeds")
        protocol = benchmark.Protocol(
            options=Options(
                steps=steps,
                batch_size=batch_size,
                clusters=clusters,
                condition_weight=condition_weight,
                frame=frame,
                network=network,
            ),
            train_episodes=train_episodes,
            held_out=held_out,
            episodes=episodes,
        )
        benchmark.bench(
            episode_files.read(_demonstrations(data)),
            folder=folder,
            methods=chosen,
            seeds=numbers,
            protocol=protocol,
            weights=weights or Path("build") / "push_t",
            say=lambda text: console.print(escape(text)),
        )
        path = summary or folder.with_suffix(".json")
        benchmark.summarise(folder, path)
    except (ValueError, FileNotFoundError, ModuleNotFoundError) as error:
        _stop(str(error))
    except KeyboardInterrupt:
        console.print("stopped; run the same command again to go on")
        raise typer.Exit(130) from None
    console.print(f"summary: {escape(str(path))}")


def _robots() -> tuple[ModuleType, ModuleType]:
    """torch and the reader of demonstrations, or a word on what is missing."""
    try:
        import torch

        from cotlearn.robots import episodes
    except ModuleNotFoundError as error:
        _stop(f"{error.name} is not installed; install it with: pip install 'cotlearn[course]'")
    return torch, episodes


def _demonstrations(data: Path | None) -> Path:
    return assets.find_data(DEMONSTRATIONS) if data is None else data


def _numbers(text: str, name: str) -> list[int]:
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise ValueError(
            f"{name} must be whole numbers with commas between, got {text!r}"
        ) from None


@app.command()
def doctor() -> None:
    """Examines this machine; names what is missing and the command that mends it."""
    from cotlearn import doctor as examination

    findings = examination.examine()
    table = Table(box=None, pad_edge=False, show_header=False)
    for finding in findings:
        mark = "[green]✓[/]" if finding.ok else "[red]✗[/]" if finding.required else "[yellow]![/]"
        table.add_row(mark, escape(finding.name), escape(finding.found))
    console.print(table)
    missing = [finding for finding in findings if not finding.ok]
    for finding in missing:
        kind = "needed" if finding.required else "good to have"
        console.print(f"\n[bold]{escape(finding.name)}[/] ({kind}): mend it with")
        console.print(f"    {escape(finding.remedy)}")
    broken = any(finding.required for finding in missing)
    if broken:
        console.print("\nSomething that the course needs is missing.")
    else:
        console.print("\nEverything that the course needs is here.")
    raise typer.Exit(1 if broken else 0)


def _stop(message: str) -> NoReturn:
    Console(stderr=True, highlight=False, soft_wrap=True).print(f"[red]error:[/] {escape(message)}")
    raise typer.Exit(2)
