"""`cotlearn train`: trains a policy, saves it, and tries it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.markup import escape
from rich.table import Table

from cotlearn.cli import policies
from cotlearn.cli.terminal import console, stop, stop_interrupted

app = typer.Typer(no_args_is_help=True, help="Trains policies.")


@app.command("push-t")
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
    steps: policies.Steps = 15_000,
    batch_size: policies.Batch = 256,
    clusters: policies.Clusters = 4096,
    condition_weight: policies.Weight = None,
    frame: policies.Frame = "body",
    network: policies.Network = "mlp",
    data: policies.Data = None,
    out: Annotated[Path, typer.Option(help="The file to make.")] = Path("push_t.safetensors"),
    rollouts: Annotated[
        int, typer.Option(min=0, help="Episodes to try each way of drawing chunks in.")
    ] = 50,
) -> None:
    """Trains a policy for Push-T, saves it, and tries it; resumes where it was interrupted."""
    torch, episode_files = policies.robots()
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
        chosen = episode_files.read(policies.demonstrations(data))
        if episodes is not None:
            chosen = chosen.select(list(range(min(episodes, len(chosen)))))
        options = benchmark.with_weight(coupling, chosen, options)
        checkpoint = out.with_name(f"{out.stem}.training.safetensors")
        trained = train(coupling, chosen, seed=seed, options=options, checkpoint=checkpoint)
    except (ValueError, FileNotFoundError, ModuleNotFoundError) as error:
        stop(str(error))
    except KeyboardInterrupt:
        stop_interrupted()
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
