"""How does the trade-off of conditional coupling move with data and strata?

Policies for Push-T with stratified coupling, trained on few to many demonstrations with coarse to
fine clusters of conditions, all else equal: best coverage at 1, 2 and 16 evaluations on the same
starts, and beside it what the frontier says of each setting before any training. One training seed,
and a third of the steps of `cotlearn bench push-t --prediction velocity`.

    python benchmarks/push_t_strata.py

writes data/results/push_t_strata.json. An interrupted run goes on.
"""

from typing import Any

from cells import opened
from short_training import train_and_roll

from cotlearn.assets import find_data
from cotlearn.couplings import StratifiedOT
from cotlearn.diagnostics import frontier
from cotlearn.policies.training import Options
from cotlearn.robots.episodes import read, split

SETTING = {
    "steps": 5000,
    "batch_size": 256,
    "seed": 0,
    "held_out": 200,
    "rollouts": 100,
    "frontier_rows": 4096,
    "frontier_repetitions": 2,
}
EPISODES = (500, 1000, 3800)
CLUSTERS = (64, 1024, 8192)


def main() -> None:
    """Fills the table."""
    episodes = read(find_data("push_t_demos.npz"))
    table = opened(
        "How does the trade-off of conditional coupling move with data and strata?",
        SETTING,
    )

    def compute(key: dict[str, Any]) -> dict[str, Any]:
        training, _ = split(episodes, held_out=SETTING["held_out"], train=key["episodes"])
        options = Options(
            frame="body",
            steps=SETTING["steps"],
            batch_size=SETTING["batch_size"],
            clusters=key["clusters"],
        )
        data = options.windows(training).dataset(training, label=options.label)
        assert data.c is not None
        found = frontier(
            data.x1,
            data.c,
            {"stratified": StratifiedOT(key["clusters"])},
            batch_size=options.ot_batch_size,
            rows=SETTING["frontier_rows"],
            repetitions=SETTING["frontier_repetitions"],
            progress=False,
        )
        point = found.points[0]
        return {
            "rows": len(data),
            **train_and_roll(
                "stratified",
                training,
                options,
                seed=SETTING["seed"],
                rollouts=SETTING["rollouts"],
            ),
            "skew": point.skew,
            "one_step_variance": point.one_step_variance,
            "one_step_error": point.one_step_error,
        }

    keys = [{"episodes": n, "clusters": k} for n in EPISODES for k in CLUSTERS]
    table.fill(keys, compute)


if __name__ == "__main__":
    main()
