"""Which pairs suit a policy of few demonstrations? Judged before any rollout.

The pairs of `cotlearn bench push-t-human` beside others that should skew less when data are few:

- `centred_early`: the regression stops where its error on held-out episodes is least;
- `centred_folds`: the mean that centres a window comes from a regression that never saw its
  episode (five folds; cross-fitting);
- `centred_scale`: as before, and divided by the spread that a second regression predicts;
- `mixed_25`, `mixed_50`: pairs of `residual`, a share of them shuffled;
- `weighted`: pairs of `residual`, each weighted in the loss by an estimate of p(x0) / p(x0 | c):
  both normal with variance 1, the second about a regression of the noise on the condition;
- `reflow_inverted`: each chunk with the noise from which a trained flow would make it; with
  `inverted_folds` the flow never saw the chunk's episode;
- `apart`: pairs of `residual`, each assignment among windows of different episodes only;
- `coarse`, `fine`: strata of 64 and of 2,048 clusters.

And with independent pairs the choices that were right for planned demonstrations, each changed
alone: the target (`data`), the frame, the scale, the times (`at_t0`: 3 in 10 at t = 0), the steps.

Each is trained once, with the same network and steps, and scored by the energy score of held-out
chunks, in pixels, and by the skew of its pairs.

    python benchmarks/few_data.py --data push_t_human.zarr
"""

import argparse
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from cells import opened
from numpy.typing import NDArray
from torch import Tensor

from cotlearn.couplings import (
    Coupling,
    FixedPairs,
    Independent,
    StratifiedOT,
    Transformed,
    centred,
)
from cotlearn.couplings.base import Match
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import linear_skew, prior_skew
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.solvers import integrate
from cotlearn.metrics import energy_score
from cotlearn.policies.methods import METHODS
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.scores import held_out_draws
from cotlearn.policies.settings import SETTINGS
from cotlearn.policies.training import Run, train
from cotlearn.randomness import generator_for
from cotlearn.robots.episodes import Episodes, read, split

STEPS = 3000  #: of those tried, the best for held-out chunks
FOLDS = 5
PAIRS = 20_000  #: that a skew is measured on
MOST_WEIGHT = 5.0
EARLY = (100, 200, 400, 800, 1600, 3200)  #: steps of a regression that are tried


def same(x: Tensor, c: Tensor) -> Tensor:
    """The values themselves: a `Transformed` that pairs what it is given."""
    return x


@dataclass(repr=False)
class Mixed(Transformed):
    """Shuffles the noise of a random share of the pairs of another coupling."""

    forward: Callable[[Tensor, Tensor], Tensor] = same
    share: float = 0.25

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """The pairs of the coupling, with some of their noise shuffled."""
        match = super().match(x0, x1, c, rng)
        source = match.source_index.copy()
        some = np.flatnonzero(rng.random(len(source)) < self.share)
        source[some] = source[rng.permutation(some)]
        return match._replace(source_index=source)


@dataclass(repr=False)
class Apart(StratifiedOT):
    """Assigns noise, within a stratum, among windows of different episodes only."""

    episode: Any = None  #: of each window, (n,)

    def _solves(self, label: NDArray[Any], rng: np.random.Generator) -> Iterator[NDArray[Any]]:
        """The first window of each episode in a stratum, the second of each, and so on."""
        for rows in super()._solves(label, rng):
            order = np.argsort(self.episode[rows], kind="stable")
            by_episode = self.episode[rows][order]
            rank = np.arange(len(rows)) - np.searchsorted(by_episode, by_episode)
            yield from (rows[order][rank == k] for k in range(rank.max() + 1))


@dataclass(repr=False)
class Weighted(Transformed):
    """Weighs each pair by an estimate of p(x0) / p(x0 | c), at most `MOST_WEIGHT`."""

    forward: Callable[[Tensor, Tensor], Tensor] = same
    mean: Callable[[Tensor], Tensor] = torch.zeros_like  # E[x0 | c]

    def match(self, x0: Tensor, x1: Tensor, c: Any, rng: np.random.Generator) -> Match:
        """The pairs of the coupling, with weights of mean one."""
        match = super().match(x0, x1, c, rng)
        noise, mean = x0[match.source_index], self.mean(c)[match.target_index]
        ratio = (mean.square().sum(dim=1) / 2 - (noise * mean).sum(dim=1)).exp()
        weight = ratio.clamp(max=MOST_WEIGHT)
        return match._replace(weight=weight / weight.mean())


def regression(run: Run, data: Dataset, prefix: str, steps: int) -> Callable[[Tensor], Tensor]:
    """A network like the policy's that predicts x1 of the data from c."""
    first = replace(run, data=data, coupling=Independent(), loss=regression_loss, checkpoint=None)
    first.options = replace(run.options, steps=steps)
    network = first.fit(prefix).network
    run.seconds += first.seconds

    def mean(c: Tensor) -> Tensor:
        parts = (predict(network, o.new_zeros(len(o), data.dim), o) for o in c.split(8192))
        return torch.cat(list(parts))

    return mean


def rows_of(data: Dataset, rows: Tensor) -> Dataset:
    """Some rows of the data."""
    assert data.c is not None
    return Dataset(data.x1[rows], data.c[rows])


def out_of_fold(run: Run, episode: Tensor, data: Dataset) -> tuple[Tensor, list[Any]]:
    """What regressions predict for the rows of episodes that they never saw."""
    found, means = torch.empty_like(data.x1), []
    for fold in range(FOLDS):
        left_out = episode % FOLDS == fold
        mean = regression(run, rows_of(data, ~left_out), f"fold_{fold}_", run.options.steps // 5)
        assert data.c is not None
        found[left_out] = mean(data.c[left_out])
        means.append(mean)
    return found, means


def by_rows(whole: Tensor | None, values: Tensor, elsewhere: Callable[[Tensor], Tensor]) -> Any:
    """A function of c that gives the stored values for the whole data, which strata pair."""
    return lambda c: values if c is whole else elsewhere(c)


def early(run: Run, episode: Tensor) -> None:
    """Centre on a regression that stops at the least error on a fifth of the episodes."""
    held = episode % FOLDS == 0
    apart = rows_of(run.data, held)
    assert apart.c is not None
    errors = {}
    for steps in EARLY:
        mean = regression(run, rows_of(run.data, ~held), "", steps)
        errors[steps] = float((mean(apart.c) - apart.x1).square().sum(dim=1).mean())
    best = min(errors, key=errors.__getitem__)
    print(f"  a regression of {best} steps: {errors}")
    run.coupling = centred(run.coupling, regression(run, run.data, "", best))


def folds(run: Run, episode: Tensor, *, scale: bool = False) -> None:
    """Centre on regressions that never saw the episode; with `scale`, divide by a spread, too."""
    data = run.data
    mean, means = out_of_fold(run, episode, data)
    average = partial(_average, means)
    if not scale:
        run.coupling = centred(run.coupling, by_rows(data.c, mean, average))
        return
    logs = (data.x1 - mean).square().mean(dim=1, keepdim=True).clamp(min=1e-4).log()
    spread, spreads = out_of_fold(run, episode, Dataset(logs.expand_as(data.x1), data.c))
    half = partial(_half_exp, spreads)
    known = (spread.mean(dim=1, keepdim=True) / 2).exp()
    run.coupling = centred(
        run.coupling, by_rows(data.c, mean, average), by_rows(data.c, known, half)
    )


def _average(means: list[Any], c: Tensor) -> Tensor:
    return torch.stack([mean(c) for mean in means]).mean(dim=0)


def _half_exp(means: list[Any], c: Tensor) -> Tensor:
    return (_average(means, c).mean(dim=1, keepdim=True) / 2).exp()


def mixed(run: Run, episode: Tensor, *, share: float) -> None:
    """Shuffle a share of the pairs."""
    run.coupling = Mixed(run.coupling, share=share)


def apart(run: Run, episode: Tensor) -> None:
    """Pair windows with noise that only windows of other episodes could have had."""
    run.coupling = Apart(run.options.clusters, residual=True, episode=episode.numpy())


def weighted(run: Run, episode: Tensor) -> None:
    """Weigh pairs by a regression of their noise on the condition."""
    stream = run.coupling.stream(
        run.data, batch_size=1000, generator=generator_for(run.seed, 0, purpose=31)
    )
    pairs = [next(stream) for _ in range(100)]
    x0, c = (torch.cat([getattr(p, name) for p in pairs]) for name in ("x0", "c"))
    mean = regression(run, Dataset(x0, c), "", run.options.steps // 5)
    run.coupling = Weighted(run.coupling, mean=mean)


def inverse(teacher: Any, rows: Dataset) -> Tensor:
    """The noise from which a flow would make the rows; its mean square is 1 for its own chunks.

    With Euler's method and 16 evaluations it would be .64 for them: near t = 1 the field is steep.
    """

    def backwards(t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
        return -teacher(1 - t, x, c)

    return integrate(backwards, rows.x1, rows.c, nfe=64, method="midpoint").x1


def inverted_folds(run: Run, episode: Tensor) -> None:
    """Each chunk with its noise under a flow that never saw its episode."""
    x0, data = torch.empty_like(run.data.x1), run.data
    for fold in range(FOLDS):
        left_out = episode % FOLDS == fold
        first = replace(run, data=rows_of(data, ~left_out), checkpoint=None)
        first.options = replace(run.options, steps=run.options.steps // 2)
        x0[left_out] = inverse(first.fit(f"fold_{fold}_").network, rows_of(data, left_out))
        run.seconds += first.seconds
    run.network = run.fit("teacher_").network
    run.data = Dataset(data.x1, data.c, name="chunks with their inverse")
    run.coupling = FixedPairs(x0)


#: name -> row of the table of methods, what prepares it, options
ROWS: dict[str, tuple[str, Callable[..., None] | None, dict[str, Any]]] = {
    "independent": ("independent", None, {}),
    "stratified": ("stratified", None, {}),
    "coarse": ("stratified", None, {"clusters": 64}),
    "fine": ("stratified", None, {"clusters": 2048}),
    "residual": ("residual", None, {}),
    "centred": ("centred", None, {}),
    "centred_early": ("stratified", early, {}),
    "centred_folds": ("stratified", folds, {}),
    "centred_scale": ("stratified", partial(folds, scale=True), {}),
    "mixed_25": ("residual", partial(mixed, share=0.25), {}),
    "mixed_50": ("residual", partial(mixed, share=0.5), {}),
    "apart": ("residual", apart, {}),
    "weighted": ("residual", weighted, {}),
    "reflow_inverted": ("reflow_inverted", None, {}),
    "inverted_folds": ("independent", inverted_folds, {}),
    "data": ("independent", None, {"prediction": "data"}),
    "steps_1000": ("independent", None, {"steps": 1000}),
    "steps_2000": ("independent", None, {"steps": 2000}),
    "steps_8000": ("independent", None, {"steps": 8000}),
    "regression": ("behaviour_cloning", None, {}),
    "regression_1000": ("behaviour_cloning", None, {"steps": 1000}),
    "diffusion": ("diffusion", None, {}),
    "diffusion_data": ("diffusion", None, {"prediction": "data"}),
    "diffusion_noise": ("diffusion", None, {"prediction": "noise"}),
    "frame_world": ("independent", None, {"frame": "world"}),
    "frame_agent": ("independent", None, {"frame": "agent"}),
    "scale_range": ("independent", None, {"scale": "range"}),
    "at_t0": ("independent", None, {"share_at_t0": 0.3}),
}


def in_pixels(policy: ChunkPolicy, unseen: Dataset) -> float:
    """The energy score of unseen chunks: frames turn and shift them, which leaves it as it is."""
    draws, truth = held_out_draws(policy, unseen)
    low, high = policy.windows.action_range
    scale = torch.from_numpy((high - low) / 2).float().repeat(policy.windows.points)
    return energy_score(draws * scale, truth * scale)


def watched(run: Run, *, prepare: Callable[[Run], None], kept: dict[str, Any]) -> None:
    """A preparation, and what it left: the teacher and the data with their pairs."""
    prepare(run)
    kept |= {"teacher": run.network, "data": run.data, "coupling": run.coupling}


def skews(coupling: Coupling, data: Dataset) -> dict[str, float]:
    """The skew of the pairs of a coupling, by a line, by cells and by neighbours."""
    stream = coupling.stream(data, batch_size=1000, generator=generator_for(0, 0, purpose=32))
    pairs = [next(stream) for _ in range(PAIRS // 1000)]
    x0, c = (torch.cat([getattr(p, name) for p in pairs]) for name in ("x0", "c"))
    near = prior_skew(x0, c, generator=generator_for(0, 0, purpose=33))
    return {
        "line": linear_skew(x0, c).explained,
        "cells": linear_skew(x0, c, cells=64).explained,
        "neighbours": near.statistic,
        "mean_square": float(x0.square().mean()),
    }


def main() -> None:
    """Fills the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="people's demonstrations")
    parser.add_argument("--rows", help="names with commas between; all without it")
    parser.add_argument("--steps", type=int, default=STEPS, help="fewer to try it out")
    asked = parser.parse_known_args()[0]
    setting = SETTINGS["push-t-human"]
    base_options = replace(setting.options, steps=asked.steps)
    episodes = read(asked.data)
    training, held = split(episodes, held_out=setting.held_out)

    def compute(key: dict[str, Any]) -> list[dict[str, Any]]:
        base, prepare, others = ROWS[key["pairs"]]
        options = replace(base_options, **others)
        method = METHODS[base]
        if prepare:
            method = replace(method, prepare=partial(prepare, episode=episode_of(training)))
        kept: dict[str, Any] = {}
        if "inverted" in key["pairs"]:
            assert method.prepare
            watch = partial(watched, prepare=method.prepare, kept=kept)
            method = replace(method, prepare=watch)
        trained = train(method, training, options=options)
        windows = trained.policy.windows
        unseen = windows.dataset(held, label=options.label)
        scores = {
            sampler.name: in_pixels(trained.policy.with_sampler(sampler), unseen)
            for sampler in trained.policy.sampler.variants
        }
        data = windows.dataset(training, label=options.label)
        paired = skews(trained.coupling, kept.get("data", data))
        if kept:
            for name, rows in (("training", data), ("held_out", unseen)):
                noise = inverse(kept["teacher"], rows)
                paired[f"inverse_square_{name}"] = float(noise.square().mean())
        return [{"sampler": s, "energy_score": e, "skew": paired} for s, e in scores.items()]

    protocol = {"steps": base_options.steps, "held_out": setting.held_out, "pairs": PAIRS}
    table = opened(__doc__ or "", protocol, parser=parser)
    wanted = asked.rows.split(",") if asked.rows else list(ROWS)
    table.fill([{"pairs": name} for name in wanted], compute)


def episode_of(episodes: Episodes) -> Tensor:
    """The number of the episode of each window: one window for each control step."""
    lengths = np.diff(episodes.ends, prepend=0)
    return torch.from_numpy(np.repeat(np.arange(len(lengths)), lengths))


if __name__ == "__main__":
    main()
