"""Ships trained policies with the course, in 16 bits.

Takes policies that `cotlearn bench` trained and kept in build/, of seed 0 unless another is given,
and writes them to data/weights/. Then compares each with its original: how far actions are moved by
the rounding, and what that does to paired rollouts, where contacts amplify any difference.

For Push-T a further file holds the strata of the stratified policy, found again by the same
k-means, and the numbers of the training windows in 512 of them, so that its pairs can be looked at
without finding and pairing all.

    python benchmarks/policy_weights.py push-t --seed 1
    python benchmarks/policy_weights.py arm-ring-replanning
    python -m cotlearn.course
"""

import argparse
from pathlib import Path

import numpy as np
import torch

from cotlearn.couplings.conditions import KMeansCondition
from cotlearn.course.assets import data_folder, find_data
from cotlearn.metrics import paired_bootstrap
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.rollout import rollout
from cotlearn.policies.settings import SETTINGS
from cotlearn.robots.episodes import read, split
from cotlearn.robots.registry import find_task
from cotlearn.storage import save_tensors

METHODS = ("independent", "minibatch_ot", "residual")
EPISODES = 200
SHOWN = 512  #: strata whose rows are listed
BUILD = Path(__file__).resolve().parents[1] / "build"


def main(setting: str, methods: list[str], seed: int, build: Path) -> None:
    """Writes the files of a setting and compares them with what they were made from."""
    torch.set_num_threads(1)
    name = setting.replace("-", "_")
    if setting == "push-t":
        ship_strata(setting, build / f"residual-{seed}.safetensors")
    for method in methods:
        trained = build / f"{method}-{seed}.safetensors"
        policy = ChunkPolicy.load(trained)
        shipped = data_folder() / "weights" / f"{name}_{method}.safetensors"
        policy.about = {"coupling": method, "seed": seed, "training": policy.about["training"]}
        policy.save(shipped, half=True)
        rounded = ChunkPolicy.load(shipped)
        print(f"{shipped.name}: {shipped.stat().st_size / 1e6:.2f} MB")
        for sampler in (s for s in policy.sampler.variants if s.nfe in (1, 2)):
            compare(policy.with_sampler(sampler), rounded.with_sampler(sampler))


def ship_strata(setting: str, trained: Path) -> None:
    """Writes the fitted clusters of a stratified training, and the rows of some."""
    policy = ChunkPolicy.load(trained)
    course = SETTINGS[setting]
    demonstrations = read(find_data(find_task(course.task).demonstrations))
    training, _ = split(demonstrations, held_out=course.held_out)
    data = policy.windows.dataset(training, label=course.options.label)
    assert data.c is not None
    assert course.options.clusters is not None
    clusters = KMeansCondition(course.options.clusters).fit(data.c)
    some = torch.randperm(clusters.clusters, generator=torch.Generator().manual_seed(0))
    rows = torch.isin(clusters.labels(data.c), some[:SHOWN]).nonzero()[:, 0]
    shipped = data_folder() / "weights" / f"{setting.replace('-', '_')}_strata.safetensors"
    tensors = {**clusters.state_dict(), "rows": rows.int()}
    save_tensors(shipped, tensors, {"setting": setting, "strata": SHOWN})
    print(f"{shipped.name}: {shipped.stat().st_size / 1e6:.2f} MB, {len(rows)} rows")


def compare(original: ChunkPolicy, rounded: ChunkPolicy) -> None:
    """Prints how far two policies differ on the same noise, in one chunk and in whole episodes."""
    task = original.windows.task
    starts = task.vector_sim(range(EPISODES)).states
    history = np.repeat(starts[:, None], original.windows.observe, axis=1)
    noise = original.noise(EPISODES, torch.Generator().manual_seed(0))
    first, second = (policy.chunk(history, noise=noise) for policy in (original, rounded))
    before, after = (rollout(p, episodes=EPISODES)[task.score] for p in (original, rounded))
    mean, low, high = paired_bootstrap(after[None], before[None])
    moved = np.linalg.norm(first - second, axis=2)
    print(
        f"  {original.sampler.name}: actions moved by {moved.mean():.2g}, at most "
        f"{moved.max():.2g}, in their unit; {task.score} {before.mean():.3f}, in 16 bits "
        f"{after.mean():.3f}, difference {mean:+.3f} ({low:+.3f} to {high:+.3f})"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("setting", choices=SETTINGS)
    parser.add_argument("methods", nargs="*", default=METHODS)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--build", type=Path, help="of the policies; default: that of the setting")
    asked = parser.parse_args()
    default = BUILD / "bench" / asked.setting
    main(asked.setting, list(asked.methods), asked.seed, asked.build or default)
