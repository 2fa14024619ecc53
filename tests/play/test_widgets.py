"""The widget does what the browser asks for, and writes only to its own file."""

import pytest

from cotlearn.play.widgets import Hands, Panel


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


def test_an_unknown_panel_is_named():
    with pytest.raises(ValueError, match="pairs"):
        Panel("petals")


def test_a_panel_carries_its_script_and_its_data():
    panel = Panel("pairs")
    assert "export default" in panel._esm
    assert len(panel.data) < 100_000
