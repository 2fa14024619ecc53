"""The challenge: floors, hidden data, its files, and a leaderboard in order."""

import pandas as pd
import pytest
import torch
from typer.testing import CliRunner

from cotlearn.cli import app
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
    course = {"independent": Independent, "conditional_ot": ConditionalOT}
    monkeypatch.setattr(challenge, "COURSE", course)
    return flat


def entered(*words):
    """The exit code and the output of the command, in one line."""
    result = CliRunner().invoke(app, ["challenge", *map(str, words)])
    return result.exit_code, " ".join(result.output.split())


def written(folder, match="return Match(*2 * [np.arange(len(x0))])"):
    """A file whose coupling has this `match`."""
    file = folder / "mine.py"
    file.write_text(ENTRY.format(match=match))
    return file


ENTRY = """
import numpy as np
from cotlearn.couplings import Coupling
from cotlearn.couplings.base import Match

class Mine(Coupling):
    def match(self, x0, x1, c, rng):
        {match}

coupling = Mine()
"""


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
        add(Entry(name, {("petals", 1): value}, 1.0, seed=3, steps=9), table)
    rows = pd.read_csv(table)
    assert list(rows.columns) == ["coupling", "score", "seed", "steps", "petals, 1", "seconds"]
    assert rows["coupling"].tolist() == ["a", "<b>", "b"]
    assert rows["score"].tolist() == [1.0, 1.5, 2.0]
    text = (tmp_path / "board.html").read_text("utf-8")
    assert text == page(rows)
    assert "<h1>Challenge: your own coupling (seed 3, 9 steps)</h1>" in text
    assert "<th>seed</th>" not in text
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


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("import nunpy", "line 1 of .*does not run: ModuleNotFoundError: No module named 'nunpy' "),
        ("x = 1\ncoupling = ConditionalOT()", "line 2 of .*does not run: NameError"),
        ("def (", "does not run: SyntaxError"),
    ],
)
def test_a_file_that_does_not_run_is_named_with_its_line(text, why, tmp_path):
    """A package of the student's own was to be installed with the course's extra."""
    (tmp_path / "mine.py").write_text(text, "utf-8")
    with pytest.raises(ValueError, match=why):
        challenge.load(tmp_path / "mine.py")


def test_the_command_begins_with_the_courses_rows(quick, tmp_path):
    table = tmp_path / "board.csv"
    words = (written(tmp_path), "--out", table, "--steps", 2)
    code, said = entered(*words)
    assert (code, "seed 0, 2 steps coupling score" in said) == (0, True)
    assert set(pd.read_csv(table)["coupling"]) == {"independent", "conditional_ot", "mine"}
    (tmp_path / "mine.py").write_text("coupling = 1\n")
    code, said = entered(*words)
    assert (code, "must define" in said) == (2, True)


def test_rows_of_another_seed_or_number_of_steps_are_refused(quick, tmp_path):
    """They stood in one order, and nothing told them apart."""
    table = tmp_path / "board.csv"
    words = (written(tmp_path), "--out", table)
    assert entered(*words, "--steps", 2)[0] == 0
    before = table.read_text()
    for more, wanted in (
        ((), "seed 0 and 1500 steps"),
        (("--steps", 3), "seed 0 and 3 steps"),
        (("--steps", 2, "--seed", 5), "seed 5 and 2 steps"),
    ):
        code, said = entered(*words, *more)
        assert code == 2
        assert f"out must be a new file or a leaderboard of {wanted}" in said
        assert f"{table} is of seed 0 and 2 steps" in said
    with pytest.raises(ValueError, match="out must be a new file or a leaderboard of seed 7"):
        add(Entry("mine", {("petals", 1): 1.0}, 1.0, seed=7, steps=2), table)
    assert table.read_text() == before


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "board.csv is damaged or no leaderboard"),
        ("coupling,score\na,1.0\n", "board.csv has coupling, score"),
        ("coupling,score,seed,steps\na,1.0,x,2\n", "board.csv is damaged or no leaderboard"),
        ("coupling,score,seed,steps\na,1,0,2\nb,1,3,2\n", r"out must be of one seed, .* \[0, 3\]"),
    ],
)
def test_what_is_no_leaderboard_is_refused(tmp_path, text, why):
    table = tmp_path / "board.csv"
    table.write_text(text)
    with pytest.raises(ValueError, match=why):
        challenge.board(table, 0, 2)
    assert table.read_text() == text


def test_after_an_interruption_the_other_rows_of_the_course_follow(quick, tmp_path, monkeypatch):
    """Two rows were all that a leaderboard ever got."""
    table = tmp_path / "board.csv"
    words = (written(tmp_path), "--out", table, "--steps", 2)

    def stop():
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setitem(challenge.COURSE, "conditional_ot", stop)
        assert entered(*words)[0] == 130
    assert pd.read_csv(table)["coupling"].tolist() == ["independent"]
    code, said = entered(*words)
    assert (code, "independent: " in said) == (0, False)
    assert set(pd.read_csv(table)["coupling"]) == {"independent", "conditional_ot", "mine"}


def test_without_a_file_the_leaderboard_is_completed_and_shown(quick, tmp_path):
    """The command said nothing."""
    table = tmp_path / "board.csv"
    add(Entry("mine", {("petals", nfe): 1.0 for nfe in (1, 2, 4)}, 1.0, seed=0, steps=2), table)
    code, said = entered("--out", table)
    assert (code, "conditional_ot: " in said) == (0, True)
    before = table.read_text()
    table.with_suffix(".html").unlink()
    code, said = entered("--out", table)
    assert (code, "seed 0, 2 steps coupling score 1 mine 1.0" in said) == (0, True)
    assert table.with_suffix(".html").exists()
    assert table.read_text() == before
    assert entered("--out", table, "--steps", 3)[0] == 2


@pytest.mark.parametrize(
    ("match", "why"),
    [
        ("return np.arange(len(x0))", "TypeError: what match returns must be a Match"),
        ("return Match(rng, x0[:, 2])", "line 8 of {file} fails on the first batch of petals: Ind"),
        (
            "assert x0.shape[1] == 2; return Match(*2 * [np.arange(len(x0))])",
            "line 8 of {file} fails on the first batch of arm-ring: AssertionError",
        ),
    ],
)
def test_a_broken_entry_is_found_before_anything_is_trained(
    quick, tmp_path, monkeypatch, match, why
):
    """It was found minutes later, when the course's couplings had been trained."""
    monkeypatch.setattr(challenge, "compete", lambda *given, **more: pytest.fail("it trains"))
    file, table = written(tmp_path, match), tmp_path / "board.csv"
    code, said = entered(file, "--out", table)
    assert (code, table.exists()) == (2, False)
    assert why.format(file=file) in said


def test_an_entry_takes_no_name_of_the_courses(quick, tmp_path):
    words = ("--name", "independent", "--out", tmp_path / "board.csv")
    code, said = entered(written(tmp_path), *words)
    assert code == 2
    assert "name must be none of independent, conditional_ot, got independent" in said


def test_equal_scores_are_shown_as_equal_the_first_one_first(tmp_path):
    """Stored scores had four digits, and a new one all: it came before its equals."""
    table = tmp_path / "board.csv"
    for name in "cab":
        rows = add(Entry(name, {("petals", 1): 1.23456789}, 1.0, seed=0, steps=2), table)
    assert rows["coupling"].tolist() == ["c", "a", "b"]
    assert rows["score"].tolist() == [1.2346] * 3
    assert challenge.leaderboard(table).equals(rows)


def test_a_name_may_look_like_a_number(tmp_path):
    """The name 007 became 7, and its second try another row; NA became no name."""
    table = tmp_path / "board.csv"
    for name in ("007", "NA", "007", "NA"):
        rows = add(Entry(name, {("petals", 1): 1.0}, 1.0, seed=0, steps=2), table)
    assert sorted(rows["coupling"]) == ["007", "NA"]
    assert sorted(challenge.leaderboard(table)["coupling"]) == ["007", "NA"]
