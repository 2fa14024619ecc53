"""Demonstrations by hand are written after each episode, and replay to the same state."""

import numpy as np
import pytest

from cotlearn.play import recorder
from cotlearn.play.recorder import Recorder
from cotlearn.robots.episodes import read
from cotlearn.robots.push_t import Simulation, random_state


def push(hand, steps):
    """Pushes right through the T; returns the targets."""
    targets = [(40.0 + 13.4 * k, 260.03 + k) for k in range(steps)]
    for target in targets:
        hand.step(*target)
    return targets


@pytest.fixture
def easy(monkeypatch):
    """Any coverage is a success after ten steps."""
    real = Recorder.success.fget
    monkeypatch.setattr(
        Recorder, "success", property(lambda hand: len(hand._actions) >= 10 or real(hand))
    )


def test_an_episode_is_written_at_once_and_replays_to_the_same_state(tmp_path, easy):
    path = tmp_path / "mine.npz"
    hand = Recorder(path, seed=4)
    push(hand, 9)
    assert not path.exists()
    before = hand.view["state"]
    push(hand, 1)
    episodes = read(path)
    assert (len(hand), len(episodes), episodes.lengths.tolist()) == (1, 1, [10])
    assert episodes.seed.tolist() == [4]
    again = Simulation(random_state(np.random.default_rng(4)))
    for state, action in zip(episodes.state, episodes.action, strict=True):
        assert np.abs(np.array(again.state[:4]) - state[:4]).max() <= 1 / 64
        last = again.state
        again.step(*action)
    assert last[:4] == pytest.approx(before[:4], abs=0.01)


def test_a_recording_goes_on_where_it_was_interrupted(tmp_path, easy):
    path = tmp_path / "mine.npz"
    push(Recorder(path), 14)  # an episode and four steps, which are lost
    hand = Recorder(path)
    assert (len(hand), hand.view["step"]) == (1, 0)
    push(hand, 10)
    assert read(path).seed.tolist() == [0, 1]


def test_undo_drops_what_goes_on_then_the_last_episode(tmp_path, easy):
    path = tmp_path / "mine.npz"
    hand = Recorder(path)
    push(hand, 23)
    hand.undo()
    assert (len(hand), hand.view["step"]) == (2, 0)
    hand.undo()
    assert read(path).seed.tolist() == [0]
    hand.undo()
    assert not path.exists()
    assert len(hand) == 0


def test_an_episode_without_success_is_not_recorded(tmp_path, monkeypatch):
    monkeypatch.setattr(recorder, "MAX_STEPS", 5)
    hand = Recorder(tmp_path / "mine.npz")
    push(hand, 5)
    assert (len(hand), hand.view["step"]) == (0, 0)


def test_another_or_damaged_file_is_named_and_left_alone(tmp_path):
    path = tmp_path / "mine.npz"
    path.write_bytes(b"no zip")
    with pytest.raises(ValueError, match="damaged"):
        Recorder(path)
    assert path.read_bytes() == b"no zip"
    with pytest.raises(ValueError, match="npz"):
        Recorder(tmp_path / "mine.txt")
