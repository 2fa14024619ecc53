"""The challenge: floors, hidden data, its files, and a leaderboard in order."""

import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from cotlearn.couplings import ConditionalOT, Independent
from cotlearn.course import challenge
from cotlearn.course.challenge import Entry, add, compete, load, page
from cotlearn.mixtures import petals


@pytest.fixture
def quick(monkeypatch):
    """One small task, and few draws."""
    monkeypatch.setattr(challenge, "ROWS", 256)
    monkeypatch.setattr(challenge, "HELD_OUT", 64)
    flat = challenge._flat("petals", 0)
    monkeypatch.setattr(challenge, "tasks", lambda seed, steps: (flat,))
    return flat


def test_a_floor_is_the_score_of_the_truth():
    """Petals have four labels of equal law up to a turn: the floor does not depend on the seed."""
    floors = [challenge._flat("petals", seed).floor for seed in range(3)]
    mixture = petals()
    truth, c = mixture.sample(4000)
    draws = torch.stack([mixture.sample_given(c) for _ in range(8)])
    assert floors == pytest.approx(3 * [challenge.energy_score(draws, truth)], rel=0.05)


def test_another_seed_hides_other_data():
    first, again, other = (challenge._flat("moving_modes", seed).data.x1 for seed in (0, 0, 1))
    assert torch.equal(first, again)
    assert not torch.allclose(first, other)
    assert first.square().sum(1).mean() == pytest.approx(
        float(other.square().sum(1).mean()), rel=0.05
    )


def test_an_entry_is_scored_at_each_number_of_evaluations(quick):
    entry = compete("mine", ConditionalOT, 0, steps=2)
    assert list(entry.scores) == [("petals", 1), ("petals", 2), ("petals", 4)]
    assert entry.score == pytest.approx(sum(entry.scores.values()) / 3)
    assert all(value > 1 for value in entry.scores.values())  # two steps reach no floor
    again = compete("mine", ConditionalOT, 0, steps=2)
    assert again.scores == entry.scores


def test_the_leaderboard_is_ordered_and_a_second_try_replaces_the_first(tmp_path):
    table = tmp_path / "board.csv"
    for name, value in (("b", 2.0), ("a", 3.0), ("<b>", 1.5), ("a", 1.0)):
        add(Entry(name, {("petals", 1): value}, 1.0), table)
    rows = pd.read_csv(table)
    assert rows["coupling"].tolist() == ["a", "<b>", "b"]
    assert rows["score"].tolist() == [1.0, 1.5, 2.0]
    text = (tmp_path / "board.html").read_text("utf-8")
    assert text == page(rows)
    assert "&lt;b&gt;" in text
    assert "<td><b></td>" not in text


def test_files_that_define_no_coupling(tmp_path):
    file = tmp_path / "mine.py"
    with pytest.raises(FileNotFoundError, match="no file"):
        load(file)
    file.write_text("coupling = 'ot'\n")
    with pytest.raises(TypeError, match=r"must define `coupling`, a Coupling; got 'ot'"):
        load(file)
    file.write_text("from cotlearn.couplings import Independent\ncoupling = Independent()\n")
    assert isinstance(load(file), Independent)


def test_the_command_begins_with_the_courses_rows(quick, tmp_path, monkeypatch):
    from cotlearn.cli import app

    monkeypatch.setattr(challenge, "COURSE", {"independent": Independent})
    file, table = tmp_path / "mine.py", tmp_path / "board.csv"
    file.write_text("from cotlearn.couplings import Independent\ncoupling = Independent()\n")
    words = ["challenge", str(file), "--out", str(table), "--steps", "2"]
    assert CliRunner().invoke(app, words).exit_code == 0
    assert set(pd.read_csv(table)["coupling"]) == {"independent", "mine"}
    file.write_text("coupling = 1\n")
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 2
    assert "must define" in result.output
