import math

import pytest

from cotlearn.results import Table, machine


def fill(store, keys, made, **options):
    """Fills a store; `made` notes what was computed."""
    store.fill(keys, lambda key: made.append(key) or {"value": len(made)}, **options)


@pytest.fixture
def table(tmp_path):
    def opened(protocol=None, axis=""):
        words = {"question": "How many?", "command": "python count.py"}
        path = tmp_path / "table.csv"
        return Table(path, protocol=protocol or {"sizes": (1, 2)}, axis=axis, **words)

    return opened


def test_a_table_goes_on_where_it_was(table, capsys):
    made = []
    fill(table(), [{"n": 1}], made)
    fill(table(), [{"n": 1}, {"n": 2}], made)
    assert made == [{"n": 1}, {"n": 2}]
    assert "2 cells, 1 done already" in capsys.readouterr().out
    frame = table().frame()
    assert list(frame.columns) == ["n", "value", "seconds", "cpu_seconds"]
    assert frame["n"].tolist() == frame["value"].tolist() == [1, 2]
    assert frame.attrs["protocol"] == {"sizes": [1, 2]}
    assert {"question", "command", "versions", "machine", "cpu_seconds"} <= set(frame.attrs)
    with pytest.raises(ValueError, match="was made with another protocol: give another file"):
        table({"sizes": (1, 3)})


def test_a_killed_run_loses_one_cell(table):
    def compute(key):
        if key["n"] == 3:
            raise KeyboardInterrupt
        return {"value": key["n"]}

    with pytest.raises(KeyboardInterrupt):
        table().fill([{"n": n} for n in range(5)], compute)
    assert table().frame()["n"].tolist() == [0, 1, 2]
    assert table().holds({"n": 2})
    assert not table().holds({"n": 3})


def test_nested_values_become_columns_and_rows(table):
    values = {
        "error": {1: 0.1 + 0.2, 16: 1e-5},
        "skew": {"mean": 2, "flagged": True},
        "why": None,
    }
    table(axis="nfe").fill([{"way": "flow, short"}], lambda key: values)
    first, second = table(axis="nfe").frame().to_dict("records")
    assert list(first)[:6] == ["way", "nfe", "error", "skew_mean", "skew_flagged", "why"]
    assert (first["way"], first["nfe"], second["nfe"]) == ("flow, short", 1, 16)
    assert (first["error"], second["error"]) == (0.1 + 0.2, 1e-5)  # to the last digit
    assert second["skew_flagged"] is True
    assert math.isnan(first["why"])


def test_two_axes_and_floors_without_them(table):
    def compute(key):
        if key["way"] == "floor":
            return {"error": {0: 0.5}}
        return {"error": {0: {1: 1.0, 2: 2.0}, 1: {1: 3.0, 2: 4.0}}}

    opened = table(axis="label nfe")
    opened.fill([{"way": "floor"}, {"way": "flow"}], compute)
    frame = opened.frame()
    assert frame["label"].tolist() == [0, 0, 0, 1, 1]
    assert frame["nfe"].fillna(0).tolist() == [0, 1, 2, 1, 2]
    assert frame["error"].tolist() == [0.5, 1, 2, 3, 4]


def test_a_cell_may_have_several_rows(table):
    rows = [{"loss": "flow", "cost": 1.0}, {"loss": "drifting", "cost": 4.0}]
    table().fill([{"network": "arm"}], lambda key: rows)
    frame = table().frame()
    assert frame["network"].tolist() == ["arm", "arm"]
    assert frame["loss"].tolist() == ["flow", "drifting"]
    assert frame.attrs["cpu_seconds"] == frame["cpu_seconds"][0]  # a cell counts once


@pytest.mark.parametrize(
    ("value", "message"),
    [
        (math.nan, "value must be finite; got nan"),
        ([1, 2], r"value must be a number, a word or a truth value; got \[1, 2\]"),
        ("# 1", "value must not contain #"),
        ("two\nlines", "value must be one line"),
        ("two\u2028lines", "value must be one line"),
        ("012e3", "value must not be a word that reads as a number; got '012e3'"),
        ("inf", "value must not be a word that reads as a number; got 'inf'"),
        ({"": 1, " ": {}} | {"a": {"b": 1}, "a_b": 2}, "must not return 'value_a_b' twice"),
        ({"b": {1: 0.5}}, "axis must name what the numbers in value_b are"),
        ({1: 0.5, 16: 0.1}, "axis must name what the numbers in value are"),
    ],
)
def test_what_cannot_be_stored_is_refused(table, tmp_path, value, message):
    with pytest.raises(ValueError, match=message):
        table().fill([{"n": 1}], lambda key: {"value": value})
    assert not (tmp_path / "table.csv").exists()


@pytest.mark.parametrize("damage", [lambda text: text[:-5], lambda text: text.split("\n", 3)[3]])
def test_a_damaged_table_is_named(table, tmp_path, damage):
    fill(table(), [{"n": 1}], [])
    file = tmp_path / "table.csv"
    file.write_text(damage(file.read_text()))
    with pytest.raises(ValueError, match=r"table\.csv is damaged: delete it to make it again"):
        table()


@pytest.mark.parametrize(
    "values", [{"nfe": {1: 0.5}}, {"a": {1: {"b": 1}}, "a_b": 2}, {"a": {1: 0.5}, "nfe": 3}]
)
def test_a_name_does_not_occur_twice(table, values):
    with pytest.raises(ValueError, match=r"must not return '(nfe|a_b)' twice"):
        table(axis="nfe").fill([{"n": 1}], lambda key: values)


def test_two_tables_on_one_file_lose_nothing(table):
    one, other = table(), table()
    fill(one, [{"n": 1}], [])
    fill(other, [{"n": 2}, {"n": 2}], made := [])
    assert made == [{"n": 2}]
    assert table().frame()["n"].tolist() == [1, 2]


def test_a_cell_that_two_tables_computed_is_kept_once(table):
    one, other = table(), table()
    for each in (one, other):
        each.keep({"n": 1}, {"value": 3}, 0.1, 0.1)
    assert len(table().rows) == 1


def test_versions_are_those_of_what_was_used():
    assert {"python", "torch", "POT"} <= set(machine("POT")["versions"])


@pytest.mark.parametrize("name", ["n", "seconds"])
def test_a_column_of_the_key_is_not_overwritten(table, name):
    with pytest.raises(ValueError, match=f"compute must not return '{name}'"):
        table().fill([{"n": 1}], lambda key: {name: 2})
