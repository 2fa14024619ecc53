"""Tables as HTML and as text."""

from cotlearn import plots

ROWS = [{"name": "a < b", "error": 1.25, "n": 2}, {"name": "c", "error": 0.5, "n": 10}]


def test_the_best_is_marked_in_both_forms():
    table = plots.table(ROWS, low=["error", "n"], digits=2)
    assert repr(table) == "name   error   n\na < b   1.25  2*\nc      0.50*  10"
    page = table._repr_html_()
    assert "<td>a &lt; b</td><td>1.25</td>" in page
    assert page.count("<b>") == 2
    assert "<b>0.50</b>" in page


def test_a_largest_value_is_marked_and_methods_have_their_labels():
    rows = [{"method": "minibatch_ot", "n": 2}, {"method": "mine", "n": None}]
    lines = repr(plots.table(rows, high=["n"])).split("\n")
    assert lines[1:] == ["minibatch OT (naive)  2*", "mine"]
