"""Tables of results."""

import re

import pandas as pd

from cotlearn import plots

ROWS = [{"name": "a < b", "error": 1.25, "n": 2}, {"name": "c", "error": 0.5, "n": 10}]


def bold(table):
    """The cells in bold, by row and column."""
    looks = re.findall(r"([^{}]*)\{\s*font-weight: bold", table.to_html())
    return {(int(i), int(k)) for i, k in re.findall(r"_row(\d+)_col(\d+)", "".join(looks))}


def test_the_best_of_a_column_is_bold():
    table = plots.table(ROWS, low=["error", "n"], digits=2)
    assert bold(table) == {(1, 1), (0, 2)}
    page = table.to_html()
    assert "a &lt; b" in page
    assert ">0.50<" in page


def test_cells_that_read_the_same_are_both_bold():
    rows = pd.DataFrame(
        {"method": ["minibatch_ot", "mine", "other"], "score": [0.914, 0.912, None]}
    )
    table = plots.table(rows, high=["score"], digits=2)
    assert bold(table) == {(0, 1), (1, 1)}
    assert "naive OT" in table.to_html()
    assert rows["method"][0] == "minibatch_ot"  # the caller's rows are as they were


def test_a_count_stays_one_where_another_row_has_none():
    table = plots.table([{"of": "a", "n": 1024, "x": 0.5}, {"of": "b", "n": None}], digits=1)
    assert str(table).splitlines() == ["of     n    x", "a   1024  0.5", "b"]


def test_a_table_made_again_is_the_same_page_and_the_same_text():
    one, again, other = (plots.table(ROWS, low=low) for low in (["n"], ["n"], []))
    assert one._repr_html_() == again._repr_html_()
    assert repr(one) == repr(other)
    assert "a < b" in repr(one)
    names = [re.search(r"T_\w{5}", table._repr_html_())[0] for table in (one, other)]
    assert names[0] != names[1]  # the bold cells of one would be bold in both


def test_what_cannot_be_told_from_the_best_is_underlined():
    table = plots.table(ROWS, low=["error"], level={"error": [False, True]})
    assert bold(table) == {(1, 1)}
    page = table.to_html()
    assert page.count("text-decoration: underline") == 1
    assert table._repr_html_() != plots.table(ROWS, low=["error"])._repr_html_()
