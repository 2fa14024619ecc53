"""What a learner has done is kept in one small file."""

import json

from cotlearn import assets
from cotlearn.homework import progress


def test_verdicts_are_kept(tmp_path):
    path = tmp_path / "deep" / "progress.json"
    assert progress.read(path) == {}
    assert progress.remember({"01.a": "correct", "01.b": "not yet"}, path)
    assert progress.remember({"01.a": "not attempted yet", "01.b": "correct"}, path)
    known = progress.read(path)
    assert {name: item["verdict"] for name, item in known.items()} == {
        "01.a": "correct",
        "01.b": "correct",
    }
    assert known["01.a"]["when"][:2] == "20"


def test_a_damaged_file_is_begun_anew(tmp_path):
    path = tmp_path / "progress.json"
    for content in ("", "{", "[]", '{"exercises": 3}', '{"exercises": {"a": 1}}'):
        path.write_text(content)
        assert progress.read(path) == {}
    assert progress.remember({"01.a": "correct"}, path)
    assert json.loads(path.read_text())["exercises"]["01.a"]["verdict"] == "correct"


def test_a_file_that_cannot_be_written_stops_nobody(tmp_path):
    (tmp_path / "file").touch()
    assert not progress.remember({"01.a": "correct"}, tmp_path / "file" / "progress.json")


def test_the_place(monkeypatch, tmp_path):
    assert progress.file() == assets.checkout() / ".cotlearn-progress.json"
    monkeypatch.setattr(assets, "checkout", lambda: None)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("USERPROFILE", str(tmp_path))
    assert progress.file() == tmp_path / ".cotlearn" / "progress.json"


def test_nothing_is_kept_outside_of_a_notebook():
    assert not progress.in_notebook()
