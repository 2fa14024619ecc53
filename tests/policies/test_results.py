"""The stored tables as data frames."""

import numpy as np
import pandas as pd
import pytest

from cotlearn.course.assets import find_data
from cotlearn.metrics import paired_bootstrap
from cotlearn.policies.policy import ChunkPolicy
from cotlearn.policies.results import (
    between_networks,
    curves,
    episodes,
    grid,
    level,
    over_networks,
    paired_difference,
    results,
    study,
    wide,
)
from cotlearn.policies.rollout import REPORTED, rollout


@pytest.fixture
def table():
    """Two methods with two seeds and three episodes on a task that has both regimes."""
    rows = []
    for regime in ("whole", "replanning"):
        for method, nfes in (("independent", (1, 2)), ("behaviour_cloning", (1,))):
            for seed in (0, 1):
                for nfe in nfes:
                    for number in range(3):
                        won = int((seed + number + nfe + (regime == "whole")) % 3 > 0)
                        key = ("arm", regime, method, seed, nfe, number)
                        rows.append((*key, won, None, 1 - won))
    names = ["task", "regime", "method", "seed", "evaluations", "episode"]
    return pd.DataFrame(rows, columns=[*names, "success", "coverage", "collision"])


def test_means_and_intervals_are_over_seeds_and_episodes(table):
    found = results("arm", regime="whole", table=table)
    assert found["method"].tolist() == ["independent", "independent", "behaviour_cloning"]
    first = found.iloc[0]
    mine = table[(table.regime == "whole") & (table.method == "independent")]
    values = grid(mine[mine.evaluations == 1], "success")
    assert values.shape == (2, 3)
    assert (first["seeds"], first["episodes"]) == (2, 6)
    expected = paired_bootstrap(values, np.zeros_like(values))
    assert (first["success"], first["success_low"], first["success_high"]) == expected
    assert first["success_of_seeds"] == values.mean(axis=1).round(4).tolist()
    assert "coverage" not in found  # no episode has it


def test_a_difference_is_paired(table):
    pair = ("independent", 1), ("independent", 2)
    mean, low, high = paired_difference("arm", *pair, regime="whole", table=table)
    same = paired_difference("arm", pair[0], pair[0], regime="whole", table=table)
    assert same == (0, 0, 0)
    assert low <= mean <= high


def test_only_episodes_that_all_seeds_have_are_compared(table):
    fewer = table[(table.seed == 0) | (table.episode < 2)]
    rows = fewer[(fewer.method == "independent") & (fewer.evaluations == 1)]
    assert grid(rows[rows.regime == "whole"], "success").shape == (2, 2)


def test_they_are_counted_and_a_difference_takes_them(table):
    """It counted five episodes where four were compared, and a difference met NaN."""
    fewer = table[(table.seed == 0) | (table.episode < 2)]
    assert results("arm", regime="whole", table=fewer)["episodes"].tolist() == [4, 4, 4]
    pair = ("independent", 1), ("independent", 2)
    expected = table[table.episode < 2]
    found = paired_difference("arm", *pair, regime="whole", table=fewer)
    assert found == paired_difference("arm", *pair, regime="whole", table=expected)


@pytest.mark.parametrize("values", [range(1, 3), np.array([1, 2]), {1, 2}, (2, 1)])
def test_several_values_of_a_column(values):
    """Of a range and of an array no row was found."""
    assert len(study(evaluations=values)) == len(study(evaluations=1)) + len(study(evaluations=2))


def test_the_study_is_the_caller_s_own():
    """A column that was multiplied changed every later call."""
    rows = study()
    rows["success"] *= 100
    assert study()["success"].max() <= 1


def test_an_episode_that_stands_twice_is_named(table):
    twice = pd.concat([table, table[:1]])
    with pytest.raises(ValueError, match="independent, seed 0, 1 evaluations has episode 0 twice"):
        results("arm", regime="whole", table=twice)


def test_networks_without_a_score_do_not_count():
    """Eight networks of which two had the score gave the interval of eight."""
    rows = networks(0.05, (8, 8))
    rows.loc[(rows["method"] == rows["method"].iloc[-1]) & (rows["seed"] > 1), "success"] = np.nan
    every, some = over_networks(rows), over_networks(rows.dropna(subset="success"))
    columns = ["success", "success_low", "success_high", "success_level"]
    pd.testing.assert_frame_equal(every[columns], some[columns])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"by": ("method", "strata")}, "rows have no strata"),
        ({"by": ("nope",)}, "by must be one of"),
        ({"scores": ("nope",)}, "scores must be one of"),
    ],
)
def test_columns_that_are_missing_or_empty_are_named(options, message):
    """Rows without a number of strata were left out without a word."""
    with pytest.raises(ValueError, match=message):
        over_networks(study(task="push-t", evaluations=1), **options)


def test_one_row_a_method(table):
    shown = wide(results("arm", regime="whole", table=table), ("success", "collision"))
    assert list(shown) == ["method", "success 1", "success 2", "collision 1", "collision 2"]
    assert shown["method"].tolist() == ["independent", "behaviour_cloning"]
    assert shown.loc[1, ["success 2"]].isna().all()


def test_curves_are_what_a_figure_draws(table):
    drawn = curves(results("arm", regime="whole", table=table))
    assert set(drawn["scores"]["independent"]) == {1, 2}
    assert len(drawn["scores"]["independent"][1]) == 2
    assert len(drawn["intervals"]["behaviour_cloning"][1]) == 2


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda t: episodes("moon", table=t), "task must be one of arm; got 'moon'"),
        (lambda t: episodes("arm", table=t), "regime must be one of whole, replanning for arm"),
        (lambda t: episodes("arm", regime="x", table=t), "regime must be one of"),
        (lambda t: results("arm", regime="whole", methods=["x"], table=t), "method must be one of"),
        (
            lambda t: paired_difference("arm", ("x", 1), ("x", 2), regime="whole", table=t),
            "first must be a stored method and number, got 'x', 1",
        ),
        (lambda t: study(moon=1), "column must be one of"),
        (lambda t: study(task="push_t"), "no row of the study has task='push_t'; there are arm-"),
        (lambda t: study(evaluations=[1, 3]), "has evaluations=3; there are 0, 1, 2, 4, 16, 100"),
    ],
)
def test_bad_arguments(table, call, message):
    with pytest.raises(ValueError, match=message):
        call(table)


# --- the course's tables --------------------------------------------------------------------------


def test_each_episode_stands_once():
    key = ["task", "regime", "method", "seed", "evaluations", "episode"]
    rows = pd.read_csv(find_data("results/episodes.csv.gz"))
    assert not rows.duplicated(key).any()
    assert rows["success"].isin([0, 1]).all()
    covered = rows["coverage"].notna()
    assert (rows["task"].str.startswith("push-t") == covered).all()
    near = (rows["coverage"] - 0.95).abs() < 1e-4  # rounded to four digits
    assert ((rows["coverage"] > 0.95) == (rows["success"] == 1))[covered & ~near].all()


def test_the_study_says_the_same_as_the_episodes():
    for task, regime in (
        ("push-t", "replanning"),
        ("arm-ring", "whole"),
        ("arm-ring", "replanning"),
    ):
        key = ["method", "seed", "evaluations"]
        means = episodes(task, regime=regime).groupby(key)["success"].mean()
        stored = study(task=task, regime=regime, course=1).set_index(key)["success"]
        pd.testing.assert_series_equal(means, stored.sort_index(), check_index_type=False)


CELLS = [
    ("push_t_residual", "push-t", "replanning", "residual", 1),
    ("arm_ring_residual", "arm-ring", "whole", "residual", 0),
    ("arm_ring_replanning_residual", "arm-ring", "replanning", "residual", 0),
]


@pytest.mark.slow
@pytest.mark.parametrize(("weights", "task", "regime", "method", "seed"), CELLS)
def test_shipped_weights_repeat_their_rows(weights, task, regime, method, seed):
    """In 16 bits, and perhaps on another processor: contacts amplify any difference."""
    policy = ChunkPolicy.load(find_data(f"weights/{weights}.safetensors"))
    policy = policy.with_sampler(policy.sampler.variants[0])
    assert policy.sampler.nfe == 1
    done = rollout(policy, seeds=range(REPORTED, REPORTED + 100), progress=False)
    rows = episodes(task, regime=regime)
    rows = rows[(rows["method"] == method) & (rows["seed"] == seed) & (rows["evaluations"] == 1)]
    stored = rows["success"].to_numpy()[:100]
    won = done[done.task.strictest]
    assert won.mean() == pytest.approx(stored.mean(), abs=0.1)
    assert (won == stored).mean() > 0.65


# --- how sure: few networks ---


def networks(deviation, counts, *, means=0.5, seed=0):
    """Rows of the study: groups of networks with success rates over 200 episodes."""
    rng = np.random.default_rng(seed)
    rows = []
    for group, count in enumerate(counts):
        centre = means if np.isscalar(means) else means[group]
        for network in range(count):
            share = np.clip(rng.normal(centre, deviation), 0, 1)
            success = rng.binomial(200, share) / 200
            row = {"method": f"m{group}", "seed": network, "evaluations": 1, "success": success}
            rows.append(row)
    return pd.DataFrame(rows)


@pytest.mark.slow
@pytest.mark.parametrize("deviation", [0.0, 0.02, 0.05, 0.1])
def test_intervals_of_one_network_cover_their_method(deviation):
    """Those of its episodes alone cover .96, .93, .76 and .48."""
    counts = [1, 1, 1, 3, 3, 3]
    held = []
    for seed in range(100):
        found = over_networks(networks(deviation, counts, seed=seed))
        some = found[found["networks"] == 1]
        held += ((some["success_low"] < 0.5) & (some["success_high"] > 0.5)).tolist()
    assert 0.92 < np.mean(held) < 0.98


@pytest.mark.slow
def test_what_is_level_with_the_best():
    told, near = [], []
    for seed in range(100):
        rows = networks(0.03, [1, 3, 3], means=[0.7, 0.72, 0.4], seed=seed)
        found = over_networks(rows).set_index("method")["success_level"]
        told.append(found["m2"])
        near.append(found["m0"])
    assert np.mean(told) < 0.05
    assert np.mean(near) > 0.9
    with pytest.raises(ValueError, match="rows must have two networks of one kind"):
        over_networks(networks(0.0, [1, 1]))


def test_numbers_of_evaluations_have_leaders_of_their_own():
    rows = pd.concat([networks(0.0, [3, 3]).assign(evaluations=nfe) for nfe in (1, 16)])
    rows.loc[(rows["method"] == "m0") & (rows["evaluations"] == 1), "success"] = 0.9
    rows.loc[(rows["method"] == "m1") & (rows["evaluations"] == 16), "success"] = 0.9
    found = over_networks(rows)
    told = found.set_index(["method", "evaluations"])["success_level"]
    assert told.to_dict() == {
        ("m0", 1): True, ("m1", 1): False, ("m0", 16): False, ("m1", 16): True,
    }  # fmt: skip
    assert wide(found).columns.tolist() == ["method", "success 1", "success 16"]
    marks = level(found)
    assert marks.to_dict("list") == {"success 1": [True, False], "success 16": [False, True]}


def test_one_network_is_widened_by_what_others_say():
    """In `results` and `paired_difference`, by the networks of other methods of the task."""
    rng = np.random.default_rng(0)
    rows = []
    for method, shares in {"a": [0.3, 0.5, 0.7], "b": [0.5]}.items():
        for seed, share in enumerate(shares):
            for episode in range(200):
                row = {"task": "t", "regime": "whole", "method": method, "seed": seed}
                row |= {"evaluations": 1, "episode": episode}
                rows.append(row | {"success": int(rng.random() < share)})
    table = pd.DataFrame(rows)
    assert between_networks(table, "success") == pytest.approx(0.2, abs=0.05)
    found = results("t", table=table).set_index("method")
    width = found["success_high"] - found["success_low"]
    assert width["b"] > 4 * 0.18  # of its episodes alone: 0.14
    _, low, high = paired_difference("t", ("a", 1), ("b", 1), table=table)
    assert high - low > 0.9
