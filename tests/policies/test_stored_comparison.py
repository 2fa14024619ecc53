"""A stored table, read by method and number of evaluations."""

import json
from pathlib import Path

import numpy as np
import pytest

from cotlearn.policies.comparison import stored
from cotlearn.policies.comparison.scores import rounded_up
from cotlearn.policies.rollout import with_derived
from cotlearn.robots.registry import find_task

CELLS = Path(__file__).resolve().parents[2] / "benchmarks/results"


def row(method, sampler, nfe, success):
    scores = {"success_95": success, "success_95_of_seeds": [success]}
    about = {"method": method, "sampler": sampler, "nfe": nfe}
    return {**about, **scores, "success_95_interval": [0, 1]}


ROWS = [
    row("independent", "euler-1", 1, 0.1),
    row("independent", "euler-1 at its temperature", 1, 0.2),
    row("independent", "midpoint-2", 2, 0.9),
    row("diffusion", "ddim-2", 2, 0.9),
    row("diffusion", "ddim-2-trailing", 2, 0.3),
    row("behaviour_cloning", "mean", 1, 0.4),
]


@pytest.fixture
def compared(tmp_path, monkeypatch):
    path = tmp_path / "table.json"
    path.write_text(json.dumps({"command": "make it", "rows": ROWS}))
    monkeypatch.setattr(stored, "find_data", lambda name: path)
    return stored.stored_comparison("table")


def test_a_method_is_found_by_its_own_sampler(compared):
    assert compared.about == {"command": "make it"}
    assert compared.at("independent", 1)["success_95"] == 0.1
    assert compared.at("independent", 1, cooled=True)["success_95"] == 0.2
    assert compared.at("independent", 2) is None, "a midpoint step is no Euler step"
    assert compared.at("diffusion", 2)["success_95"] == 0.3
    assert compared.at("behaviour_cloning", 1)["success_95"] == 0.4
    assert compared.at("behaviour_cloning", 2) is None, "regression has one evaluation"


def test_a_table_has_a_row_for_each_method_and_a_column_for_each_number(compared):
    table = compared.table("success_95", nfes=(1, 2))
    assert table == [
        {"method": "independent", "success 1": 0.1, "success 2": None},
        {"method": "diffusion", "success 1": None, "success 2": 0.3},
        {"method": "behaviour_cloning", "success 1": 0.4, "success 2": None},
    ]
    [cooled] = compared.table("success_95", nfes=(1,), cooled=True)
    assert cooled == {"method": "independent", "success 1": 0.2}


def test_curves_are_what_the_figure_takes(compared):
    scores, intervals = {"independent": {1: [0.1]}}, {"independent": {1: [0, 1]}}
    drawn = compared.curves("success_95", methods=["independent"])
    assert drawn == {"scores": scores, "intervals": intervals}


def test_rounding_up_keeps_a_coverage_on_its_side_of_a_threshold():
    assert rounded_up(0.9500004) > 0.95 == rounded_up(0.95)
    assert rounded_up(0.12345649) == 0.123457


@pytest.mark.parametrize("folder", [path.name for path in CELLS.iterdir() if path.is_dir()])
def test_outcomes_of_episodes_give_the_means_of_their_cell(folder):
    for file in (CELLS / folder).glob("*-*.json"):
        cell = json.loads(file.read_text("utf-8"))
        for name, found in cell["samplers"].items():
            arrays = {key: np.array(values) for key, values in found["outcomes"].items()}
            task = find_task(cell["protocol"]["task"])
            for key, values in with_derived(task, arrays).items():
                mean = found["summary"].get(key, values.mean())
                assert values.mean() == pytest.approx(mean, abs=1e-4), (file.name, name, key)
