"""Rows that `bench` adds to the two tables of results."""

import gzip
import os
import signal
import time
from dataclasses import replace
from functools import partial

import pandas as pd
import pytest
from peers import peer

from cotlearn.flows import training
from cotlearn.policies import bench as module
from cotlearn.policies import scores
from cotlearn.policies.bench import EPISODE_KEY, STUDY_KEY, append, bench
from cotlearn.policies.methods import Method
from cotlearn.policies.options import Options
from cotlearn.policies.rollout import rollout
from cotlearn.policies.samplers import MeanSampler
from cotlearn.policies.settings import COMPARED, SETTINGS, Setting

OPTIONS = Options(steps=20, batch_size=32, width=16, blocks=1, clusters=20, ot_batch_size=64)
SMALL = Setting("push-t", replace(OPTIONS, prediction="data"), held_out=3)


@pytest.fixture(autouse=True)
def _little_to_score(monkeypatch):
    monkeypatch.setattr(scores, "SCORED_STATES", 20)
    for name in ("SCORED_SAMPLES", "MODE_STARTS", "MODE_DRAWS"):
        monkeypatch.setattr(scores, name, 2)
    for place in (scores, module):
        monkeypatch.setattr(place, "rollout", _short)


def _short(policy, **options):
    return rollout(policy, **{"progress": False, **options, "max_steps": 9})


@pytest.fixture
def run(episodes, tmp_path):
    """Fills cells in a folder, and returns what was said and the two tables."""

    def ran(methods, setting=SMALL, folder="a", **more):
        said, place = [], tmp_path / folder
        files = {
            "weights": place / "weights",
            "episodes_table": place / "episodes.csv.gz",
            "study_table": place / "study.csv",
        }
        given = {"seeds": [0], "episodes": 2, "course": True, "say": said.append, **files, **more}
        bench(setting, episodes, methods=methods, **given)
        return said, pd.read_csv(files["episodes_table"]), pd.read_csv(files["study_table"])

    return ran


@pytest.mark.slow
def test_rows_are_added_once(run):
    _, episodes, study = run(["independent"])
    assert episodes["evaluations"].tolist() == [1, 1, 2, 2, 16, 16]
    assert study["sampler"].tolist() == ["euler-1", "euler-2", "euler-16"]
    said, episodes, study = run(["independent", "residual", "behaviour_cloning"], seeds=[0, 1])
    assert said[0] == "6 cells, 1 done already"
    assert not episodes.duplicated(list(EPISODE_KEY)).any()
    assert len(episodes) == 2 * (2 * 6 + 2)  # seeds; two flows at 1, 2, 16; a regression
    assert len(study) == len(episodes) / 2
    means = episodes.groupby(["method", "seed", "evaluations"])["coverage"].mean()
    stored = study.set_index(["method", "seed", "evaluations"])["coverage"]
    pd.testing.assert_series_equal(means, stored.sort_index(), atol=1e-4)
    assert set(study["strata"].dropna()) == {20}
    assert run(["independent"])[0] == ["1 cells, 1 done already"]


def test_a_cell_says_what_it_does(run):
    """With one short cell nothing was said for two minutes."""
    said = run(["independent"])[0]
    assert "independent-0: trains, 20 steps" in said
    assert [line.split()[-1] for line in said if "plays 2 episodes" in line] == ["1", "2", "16"]


@pytest.mark.slow
def test_other_options_are_rows_of_the_study_alone(run, tmp_path):
    run(["independent"])
    other = replace(SMALL, options=replace(SMALL.options, steps=10))
    apart = {"weights": tmp_path / "other", "course": False}
    said, episodes, study = run(["independent"], other, **apart)
    assert said[0] == "1 cells, 0 done already"
    assert len(episodes) == 6
    assert study["steps"].tolist() == [20] * 3 + [10] * 3
    assert study["course"].tolist() == [1] * 3 + [0] * 3


@pytest.mark.slow
def test_weights_of_conditions_and_notes_tell_rows_apart(run, tmp_path):
    for number, weight in enumerate((1.0, 100.0)):
        other = replace(SMALL, options=replace(SMALL.options, condition_weight=weight))
        place = tmp_path / f"weights {number}"
        said, _, study = run(["conditional_ot"], other, weights=place)
        assert said[0] == "1 cells, 0 done already"
    assert sorted(set(study["condition_weight"])) == [1, 100]
    said, _, study = run(["conditional_ot"], other, weights=tmp_path / "x", note="label action")
    assert said[0] == "1 cells, 0 done already"
    assert len(study) == 9


def test_weights_of_other_options_are_refused(run, tmp_path):
    run(["behaviour_cloning"])
    other = replace(SMALL, options=replace(SMALL.options, steps=10))
    with pytest.raises(ValueError, match="was trained with other options: give other weights"):
        run(["behaviour_cloning"], other)


@pytest.mark.slow
def test_an_interrupted_run_loses_nothing(run, tmp_path, monkeypatch):
    longer = replace(SMALL, options=replace(SMALL.options, steps=60))
    _, first, _ = run(["independent"], longer)
    step, calls = training._gradient_step, []

    def interrupted(*arguments):
        step(*arguments)
        calls.append(1)
        if len(calls) == 25:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(training, "_gradient_step", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(["independent"], longer, folder="b")
    assert not list((tmp_path / "b").glob("*.csv*"))
    _, again, _ = run(["independent"], longer, folder="b")
    assert len(calls) == 60  # 25 and 35
    pd.testing.assert_frame_equal(first, again)


def test_a_method_of_ones_own(run):
    def loss(network, pairs, generator):
        return network(0.0, pairs.x0, pairs.c)[:, 0]

    mine = Method("mine", "x", loss=lambda o: loss, sampler=lambda o, clip: MeanSampler())
    _, episodes, _ = run([mine])
    assert set(episodes["method"]) == {"mine"}


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"methods": ["magic"]}, "method must be one of"),
        ({"methods": ["independent"], "seeds": [-1]}, "seeds must be"),
        ({"methods": ["independent"], "episodes": 1}, "episodes must be"),
        ({"methods": ["independent"], "executor": "moon"}, "executor must be one of local"),
    ],
)
def test_bad_arguments(run, given, message):
    with pytest.raises(ValueError, match=message):
        run(**given)


def test_a_table_keeps_rows_of_others_and_replaces_its_own(tmp_path):
    path = tmp_path / "t.csv.gz"
    append(path, [{"method": "a", "seed": 0, "x": 1.5}, {"method": "b", "seed": 0}], ["method"])
    before = path.read_bytes()
    append(path, [{"method": "a", "seed": 0, "x": 1.5}], ["method"])
    append(path, [{"method": "b", "seed": 0}], ["method"])
    assert path.read_bytes() == before  # no time stamp, and the same order
    append(path, [{"method": "b", "seed": 3}], ["method"])
    assert gzip.decompress(path.read_bytes()).decode() == "method,seed,x\na,0,1.5\nb,3,\n"


def test_a_damaged_table_is_named_and_kept(tmp_path):
    path = tmp_path / "t.csv.gz"
    path.write_bytes(b"not zipped")
    with pytest.raises(ValueError, match=r"t\.csv\.gz is damaged"):
        append(path, [{"method": "a"}], ["method"])
    assert path.read_bytes() == b"not zipped"


def test_the_protocols_are_those_of_the_tables():
    assert len(COMPARED) == 8
    assert {s.regime for s in SETTINGS.values()} == {"whole", "replanning"}
    assert set(STUDY_KEY) >= {"task", "method", "seed", "evaluations"}


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["dask", "ray"])
def test_workers_compute_what_is_missing(executor):
    peer({"dask": "distributed"}.get(executor, executor))

    def compute(key):
        time.sleep(0.2 * key)
        return key**2, os.getpid()

    with module.opened(executor) as each:
        done = list(each(partial(compute), [4, 1]))
        assert sorted(value for value, _ in done) == [1, 16]
        assert os.getpid() not in {process for _, process in done}
        with pytest.raises(ZeroDivisionError):
            list(each(lambda key: 1 / key, [0]))
