"""The search of `benchmarks/settled.py`."""

import runpy
from itertools import product
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def settled(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    return runpy.run_path(str(BENCHMARKS / "settled.py"))


@pytest.mark.parametrize("now", list(product((0, 1, 2), repeat=2)))
def test_no_single_change_is_worth_more(settled, now):
    options = [(0, 1, 2, 3), (0, 1, 2, 3)]
    worth = [[3, 0, 1, 0], [0, 5, 2, 1], [1, 2, 7, 2], [0, 4, 2, 1]]
    a, b = settled["settle"](now, options, lambda at: worth[at[0]][at[1]])
    assert worth[a][b] == max(worth[a]) == max(row[b] for row in worth)
    assert worth[a][b] >= worth[now[0]][now[1]]


def test_of_equal_settings_the_first_stays(settled):
    assert settled["settle"]((1, 1), [(0, 1), (0, 1)], lambda at: 0.0) == (1, 1)


@pytest.mark.parametrize(
    ("first", "again", "best"),
    [
        (1, {6: 9}, 6),  # the third best
        (1, {5: 9}, 8),  # the fourth best is not compared
        (0, {0: 9}, 0),  # the first is
    ],
)
def test_the_best_and_the_first_are_compared_again(settled, first, again, best):
    tried = [(value,) for value in range(9)]
    found = settled["best_again"](
        tried, (first,), lambda at: at[0], lambda at: again.get(at[0], at[0] / 9)
    )
    assert found == (best,)
