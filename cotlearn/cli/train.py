"""`cotlearn train`: trains a policy, saves it and tests it in rollouts."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.markup import escape
from rich.table import Table

from cotlearn.cli import policies
from cotlearn.cli.terminal import SEED, console, reported
from cotlearn.files import check_input, check_output, check_separate
from cotlearn.interrupt import loading


@policies.with_options
def train(
    name: policies.Name,
    options: dict[str, Any],
    coupling: Annotated[str, typer.Option(help="A method, see below.")] = "stratified",
    seed: Annotated[int, typer.Option(**SEED, help="Seed of weights, pairs and times.")] = 0,
    episodes: Annotated[int | None, typer.Option(min=1, help="Most demonstrations.")] = None,
    data: policies.Data = None,
    out: Annotated[Path | None, typer.Option(help="Default: NAME.safetensors.")] = None,
    rollouts: Annotated[int, typer.Option(min=0, help="Test episodes for each sampler.")] = 50,
) -> None:
    """Trains a policy for a task, saves it and tests it in rollouts; resumes if interrupted."""
    out = out or Path(f"{name.replace('-', '_')}.safetensors")
    with reported(RuntimeError):
        check_output(out, "out")
        checkpoint = out.with_name(f"{out.stem}.training.safetensors")
        check_separate(data=data, out=out, checkpoint=checkpoint)
        if data is not None:
            check_input(data, "data")
        with loading():
            from cotlearn.policies import training
            from cotlearn.policies.choice import with_choice

        setting, chosen = policies.setting(name, options, data)
        if rollouts:
            policies.check_simulator(setting)
        if episodes is not None:
            chosen = chosen.select(range(min(episodes, len(chosen))))
        used = with_choice(coupling, chosen, setting.options)
        trained = training.train(coupling, chosen, seed=seed, options=used, checkpoint=checkpoint)
        trained.policy.about = {"coupling": coupling, "seed": seed, "episodes": len(chosen)}
        trained.policy.save(out)
        facts = f"{trained.parameters} weights, {len(chosen)} episodes, {trained.seconds:.0f} s"
        console.print(f"{escape(str(out))}: {facts}")
        if rollouts:
            console.print(_tested(trained.policy, rollouts))
        for file in trained.checkpoints:
            file.unlink()


def _tested(policy: Any, rollouts: int) -> Table:
    """The scores of a policy with each sampler, and how long it takes."""
    from cotlearn.policies.rollout import rollout

    task = policy.windows.task
    derived = [*task.capped, *task.thresholds]
    names = [task.score, *(name for name in derived if not name.endswith("_200"))]
    table = Table("sampler", *(n.replace("_", " ") for n in names), "ms a chunk", box=None)
    for sampler in policy.sampler.variants:
        sampled = policy.with_sampler(sampler)
        scores = rollout(sampled, episodes=rollouts).summary()
        values = [f"{scores[n]:.3f}" for n in names]
        table.add_row(sampler.name, *values, f"{1000 * sampled.latency():.2f}")
    return table
