"""What a learner has done is kept in one small file."""

import json

import pytest
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.course import assets, progress, record


@pytest.fixture
def path(tmp_path, monkeypatch):
    """The file, in a folder that does not exist yet."""
    path = tmp_path / "deep" / "progress.json"
    monkeypatch.setattr(record, "file", lambda: path)
    return path


def test_verdicts_are_kept(path):
    assert record.read() == {}
    record.remember({"01.a": "correct", "01.b": "not yet"})
    record.remember({"01.a": "not attempted yet", "01.b": "correct"})
    known = record.read()
    assert known.keys() == {"01.a", "01.b"}
    assert {item["verdict"] for item in known.values()} == {"correct"}
    assert known["01.a"]["when"][:2] == "20"


def test_a_damaged_file_is_begun_anew(path):
    path.parent.mkdir()
    for content in ("", "{", "[]", '{"exercises": 3}', '{"exercises": {"a": 1}}'):
        path.write_text(content)
        assert record.read() == {}
    record.remember({"01.a": "correct"})
    assert json.loads(path.read_text())["exercises"]["01.a"]["verdict"] == "correct"


def test_a_file_that_cannot_be_written_stops_nobody(path):
    path.parent.touch()
    record.remember({"01.a": "correct"})
    assert record.read() == {}


def test_the_place(monkeypatch):
    assert record.file() == assets.checkout() / ".cotlearn-progress.json"
    monkeypatch.setattr(assets, "checkout", lambda: None)
    record.remember({"01.a": "correct"})  # nothing happens
    assert record.read() == {}


def test_nothing_is_kept_outside_of_a_notebook():
    assert not record.in_notebook()


def test_a_notebook_shows_what_is_done_as_the_command_does(path, capsys):
    record.remember({"00.self_test": "correct"})
    progress()
    said = capsys.readouterr().out
    assert "1 of 3" in said
    assert "next: 00.perfect_one_step in 00_start_here.ipynb" in said
    assert CliRunner().invoke(cli.app, ["progress"]).output == said
