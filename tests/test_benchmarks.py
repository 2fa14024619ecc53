"""The stored tables are what the scripts of `benchmarks/` compute: cells that cost little."""

import runpy
from pathlib import Path

import pytest

from cotlearn.results import read_table

ROOT = Path(__file__).resolve().parents[1]
BENCHMARKS = ROOT / "benchmarks"
#: All but the table that has no lines of its own: data/results/study.md describes it.
TABLES = sorted({path.stem for path in (ROOT / "data" / "results").glob("*.csv")} - {"study"})
FLOORS = {
    "mac": {"data": "equal", "method": "floor", "seed": 0},
    "ot_batch": {"coupling": "truth", "rows": 1, "seed": 0},
    "prediction_target": {"data": "petals", "path": "floor", "seed": 0},
}


@pytest.fixture
def script(monkeypatch):
    monkeypatch.syspath_prepend(BENCHMARKS)
    return lambda name: runpy.run_path(str(BENCHMARKS / f"{name}.py"))


@pytest.mark.parametrize("name", TABLES)
def test_a_table_says_its_question_and_the_script_that_makes_it(name):
    about = read_table(name).attrs
    assert about["question"].endswith(("?", "."))
    python, script, *_ = about["command"].split()
    assert python == "python"
    assert (ROOT / script).is_file()


@pytest.mark.parametrize("name", FLOORS)
def test_a_floor_is_computed_again(script, name):
    key, rows = FLOORS[name], read_table(name)
    same = (rows[list(key)] == list(key.values())).all(axis=1)
    found = script(name)["compute"](key)
    for score, value in (found[0] if isinstance(found, list) else found).items():
        value = value[1] if isinstance(value, dict) else value
        assert rows.loc[same, score].tolist()[0] == pytest.approx(value, abs=2e-4)


def test_the_ranks_of_the_frontier_follow_from_its_cells(script):
    module, rows = script("frontier"), read_table("frontier")
    stored = read_table("frontier_ranks").set_index(["part", "ranking", "data"])["correlation"]
    held_out = rows[rows["part"] == "held_out"]
    for ranking in module["RANKINGS"]:
        for data, pairs in module["ranked"](held_out, ranking).items():
            correlation = module["_rank_correlation"](pairs)
            assert correlation == pytest.approx(stored["held_out", ranking, data], abs=6e-4)
