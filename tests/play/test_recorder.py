"""Demonstrations by hand are written after each episode, and replay to the same state."""

import numpy as np
import pytest

from cotlearn.play import recorder
from cotlearn.play.recorder import Recorder
from cotlearn.play.steered import steer
from cotlearn.robots.episodes import read
from cotlearn.robots.push_t import Simulation, coverage, random_state
from cotlearn.robots.push_t.constants import SUCCESS


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


def test_two_recorders_of_one_file_lose_nothing(tmp_path, easy):
    path = tmp_path / "mine.npz"
    one, other = Recorder(path), Recorder(path)
    push(one, 10)
    push(other, 10)
    push(one, 10)
    assert (len(read(path)), len(one)) == (3, 3)
    other.undo()
    assert len(read(path)) == 2


def test_an_episode_that_cannot_be_written_is_kept_and_written_later(tmp_path, easy):
    path = tmp_path / "mine.npz"
    hand = Recorder(path)
    push(hand, 10)
    good = path.read_bytes()
    path.write_bytes(b"no zip")
    with pytest.raises(ValueError, match="damaged"):
        push(hand, 10)
    assert (len(hand), hand.view["step"], path.read_bytes()) == (1, 10, b"no zip")
    path.write_bytes(good)
    push(hand, 1)
    assert read(path).lengths.tolist() == [10, 11]


def test_how_an_episode_ended_is_said_until_the_next_push(tmp_path, easy, monkeypatch):
    hand = Recorder(tmp_path / "mine.npz")
    push(hand, 10)
    assert hand.view["note"] == "Recorded after 1.0 s."
    push(hand, 1)
    assert hand.view["note"] == ""
    monkeypatch.setattr(recorder, "MAX_STEPS", 5)
    push(hand, 4)
    assert "without success" in hand.view["note"]


@pytest.mark.slow
def test_a_hand_does_not_continue_a_script_s_recording(tmp_path):
    path = tmp_path / "script.npz"
    steer(path, episodes=1)
    episodes = read(path)
    again = Simulation(random_state(np.random.default_rng(0)))
    for action in episodes.action:
        again.step(*action)
    assert coverage(again.state[2:]) > SUCCESS
    with pytest.raises(ValueError, match=r"path must be of Push-T by hand, got .* by a script"):
        Recorder(path)


def test_a_seed_that_the_file_cannot_hold_is_named(tmp_path):
    with pytest.raises(ValueError, match="seed must be below"):
        Recorder(tmp_path / "mine.npz", seed=2**32)


def test_another_or_damaged_file_is_named_and_left_alone(tmp_path):
    path = tmp_path / "mine.npz"
    path.write_bytes(b"no zip")
    with pytest.raises(ValueError, match="damaged"):
        Recorder(path)
    assert path.read_bytes() == b"no zip"
    with pytest.raises(ValueError, match="npz"):
        Recorder(tmp_path / "mine.txt")
