import json
import os
import time

import pytest

from cotlearn.results import Folder, Table, machine


def fill(store, keys, made, **options):
    """Fills a store; `made` notes what was computed."""
    store.fill(keys, lambda key: made.append(key) or {"value": len(made)}, **options)


@pytest.fixture
def table(tmp_path):
    def opened(protocol):
        words = {"question": "How many?", "command": "python count.py"}
        return Table(tmp_path / "table.json", protocol=protocol, **words)

    return opened


def test_a_table_goes_on_where_it_was(table, tmp_path, capsys):
    made = []
    fill(table({"sizes": (1, 2)}), [{"n": 1}], made)
    fill(table({"sizes": (1, 2)}), [{"n": 1}, {"n": 2}], made)
    assert made == [{"n": 1}, {"n": 2}]
    assert "2 cells, 1 done already" in capsys.readouterr().out
    text = (tmp_path / "table.json").read_text()
    stored = json.loads(text)
    assert [cell["key"] for cell in stored["cells"]] == made
    assert [cell["value"] for cell in stored["cells"]] == [1, 2]
    assert {"question", "command", "versions", "machine", "seconds", "cpu_seconds"} <= set(stored)
    assert '"sizes": [ 1, 2 ]' in text  # innermost lists on one line
    with pytest.raises(ValueError, match="was made with another protocol: give another file"):
        table({"sizes": (1, 3)})
    (tmp_path / "table.json").write_text(text[:-5])
    with pytest.raises(ValueError, match=r"table\.json is damaged: delete it to make it again"):
        table({"sizes": (1, 2)})


def test_two_runs_share_a_folder(tmp_path):
    made, said = [], []
    first = Folder(tmp_path, {"steps": 3, "seed": 0})
    fill(first, ["a"], made, say=said.append)
    fill(first, ["a", "b"], made, say=said.append)
    assert made == ["a", "b"]
    assert json.loads((tmp_path / "b.json").read_text())["value"] == 2
    with pytest.raises(ValueError, match=r"a\.json was made with another protocol \(steps\)"):
        Folder(tmp_path, {"steps": 4, "seed": 0}).holds("a")
    old = Folder(tmp_path, {"length": 3}, read=lambda stored: {"length": stored["steps"]})
    assert old.holds("a")
    assert not old.holds("c")


@pytest.mark.slow
@pytest.mark.parametrize("executor", ["dask", "ray"])
def test_workers_compute_what_is_missing(tmp_path, executor):
    pytest.importorskip({"dask": "distributed"}.get(executor, executor))
    said, store = [], Folder(tmp_path, {"steps": 3})
    store.keep("2", {"value": 0})

    def compute(key):
        time.sleep(0.2 * int(key))
        return {"value": int(key) ** 2, "process": os.getpid()}

    store.fill(["4", "2", "1"], compute, executor=executor, say=said.append)
    stored = {path.stem: json.loads(path.read_text()) for path in tmp_path.iterdir()}
    assert {key: cell["value"] for key, cell in stored.items()} == {"1": 1, "2": 0, "4": 16}
    assert stored["1"]["process"] != os.getpid()
    assert said[0] == "3 cells, 1 done already"
    assert [line.split()[1] for line in said[1:]] == ["1:", "4:"]  # as they are ready
    with pytest.raises(ZeroDivisionError):
        store.fill(["0"], lambda key: {"value": 1 / int(key)}, executor=executor)


def test_an_unknown_executor(tmp_path):
    with pytest.raises(ValueError, match="executor must be one of local, dask, ray; got 'slurm'"):
        Folder(tmp_path, {}).fill(["a"], dict, executor="slurm")


def test_versions_are_those_of_what_was_used():
    assert {"python", "torch", "POT"} <= set(machine("POT")["versions"])
