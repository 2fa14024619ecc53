"""The widget does what the browser asks for, and writes only to its own file."""

import pytest

from cotlearn.play.widgets import Hands, Panel, hands, watch


def test_hands_step_and_undo(tmp_path):
    hands = Hands(tmp_path / "mine.npz", seed=3)
    before = hands.view["state"]
    for _ in range(3):
        hands._heard(hands, {"do": "step", "x": 500.0, "y": 20.0, "path": "other.npz"}, [])
    assert hands.view["step"] == 3
    assert hands.view["state"][:2] != before[:2]
    hands._heard(hands, {"do": "undo"}, [])
    assert (hands.view["step"], hands.view["state"]) == (0, before)
    assert list(tmp_path.iterdir()) == []


def test_the_panel_says_why_nothing_is_written(tmp_path, monkeypatch):
    widget = Hands(tmp_path / "mine.npz")

    def full(*_):
        raise OSError(28, "No space left on device", "mine.npz")

    monkeypatch.setattr(widget.recorder, "step", full)
    widget._heard(widget, {"do": "step", "x": 1, "y": 2}, [])
    assert "Not written: [Errno 28] No space left" in widget.view["problem"]


def test_each_message_is_answered_even_if_nothing_changed(tmp_path):
    widget = Hands(tmp_path / "mine.npz")
    answers = []
    widget.observe(answers.append, "view")
    for _ in range(2):
        widget._heard(widget, {"do": "undo"}, [])
    assert len(answers) == 2


def test_no_hands_where_nobody_runs_the_cell(tmp_path):
    assert hands(tmp_path / "mine.npz") is None


def test_no_policy_is_named():
    with pytest.raises(ValueError, match="policies must hold at least one"):
        watch({})


def test_an_unknown_panel_is_named():
    with pytest.raises(ValueError, match="pairs"):
        Panel("petals")


def test_a_panel_carries_its_script_and_its_data():
    panel = Panel("pairs")
    assert "export default" in panel._esm
    assert len(panel.data) < 100_000
