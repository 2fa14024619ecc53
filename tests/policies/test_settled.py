"""The search of `benchmarks/settled.py`."""

import runpy
from itertools import product
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def settle(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return runpy.run_path(str(BENCHMARKS / "settled.py"))["settle"]


@pytest.mark.parametrize("now", list(product((0, 1, 2), repeat=2)))
def test_no_single_change_is_worth_more(settle, now):
    options = [(0, 1, 2, 3), (0, 1, 2, 3)]
    worth = [[3, 0, 1, 0], [0, 5, 2, 1], [1, 2, 7, 2], [0, 4, 2, 1]]
    a, b = settle(now, options, lambda at: worth[at[0]][at[1]])
    assert worth[a][b] == max(worth[a]) == max(row[b] for row in worth)
    assert worth[a][b] >= worth[now[0]][now[1]]


def test_of_equal_settings_the_first_stays(settle):
    assert settle((1, 1), [(0, 1), (0, 1)], lambda at: 0.0) == (1, 1)
