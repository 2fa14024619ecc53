import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from cotlearn.policies.windows import Windows
from cotlearn.robots.episodes import Episodes
from cotlearn.robots.push_t import GOAL, PUSH_T, corners


def test_windows_by_hand(episodes):
    windows = Windows.fit(episodes, frame="world", scale="range")
    history, actions = windows.cut(episodes)
    assert history.shape == (len(episodes.state), 2, 5)
    assert actions.shape == (len(episodes.state), 16, 2)
    first, last = episodes.starts[1], episodes.ends[1] - 1
    assert np.array_equal(history[first], episodes.state[[first, first]])
    assert np.array_equal(history[first + 3], episodes.state[[first + 2, first + 3]])
    assert np.array_equal(actions[first], episodes.action[first : first + 16])
    assert np.array_equal(actions[last], np.repeat(episodes.action[[last]], 16, axis=0))
    data = windows.dataset(episodes)
    assert (data.dim, data.condition_dim) == (windows.dim, windows.condition_dim) == (32, 12)
    assert data.x1.dtype == torch.float32
    for values in (data.x1, data.c):
        assert values.min() == pytest.approx(-1, abs=1e-6)
        assert values.max() == pytest.approx(1, abs=1e-6)
    low, high = windows.action_range
    assert np.allclose((data.x1[first, :2].numpy() + 1) / 2 * (high - low) + low, actions[first, 0])


def test_the_deviation_as_scale(episodes):
    data = Windows.fit(episodes).dataset(episodes)
    c = data.c.reshape(-1, 6)
    assert torch.allclose(c.mean(dim=0), torch.zeros(6), atol=1e-5)
    assert torch.allclose(c.std(dim=0), torch.ones(6), atol=1e-3)
    x1 = data.x1.reshape(-1, 2)
    assert torch.allclose(x1.mean(dim=0), torch.zeros(2), atol=1e-5)
    assert torch.allclose(x1.std(dim=0), torch.ones(2), atol=1e-3)


@pytest.mark.parametrize("frame", ["body", "world"])
def test_actions_come_back(episodes, frame):
    windows = Windows.fit(episodes, frame=frame, label="intention", predict=8)
    history, actions = windows.cut(episodes, label="intention")
    back = windows.actions(windows.chunks(actions, history), history)
    assert np.allclose(back, actions, atol=1e-3)


def test_the_body_frame_is_the_frame_of_the_t(episodes):
    windows = Windows.fit(episodes)
    unit = np.array([[-1.0], [1.0]])
    raw = replace(windows, observation_range=unit * np.ones(6), action_range=unit * np.ones(2))
    pose = np.array([100.0, 200.0, 0.7])
    on_t = corners(pose, points=((10.0, 20.0), (0.0, 0.0), (-5.0, 60.0)))
    history = np.array([[[*on_t[0], *pose], [*on_t[2], *pose]]])
    c = raw.condition(history)[0].reshape(2, 6)
    assert torch.allclose(c[:, :2], torch.tensor([[10.0, 20.0], [-5.0, 60.0]]), atol=1e-4)
    goal = corners(pose, points=(tuple(c[1, 2:4].tolist()),))[0]
    assert np.allclose(goal, GOAL[:2], atol=1e-3)
    assert np.arctan2(float(c[1, 5]), float(c[1, 4])) == pytest.approx(GOAL[2] - 0.7, abs=1e-5)
    chunk = np.broadcast_to(on_t[0], (1, 16, 2))
    assert torch.allclose(raw.chunks(chunk, history)[0, :2], torch.tensor([10.0, 20.0]), atol=1e-4)


def test_what_the_body_frame_sees_does_not_turn_with_the_world(episodes):
    """A full turn of the angle changes nothing, in either frame."""
    for frame in ("body", "world"):
        windows = Windows.fit(episodes, frame=frame)
        history, actions = windows.cut(episodes)
        turned = history + np.array([0, 0, 0, 0, 2 * np.pi])
        assert torch.allclose(windows.condition(turned), windows.condition(history), atol=1e-5)
        chunk = windows.chunks(actions, history)
        assert np.allclose(windows.actions(chunk, turned), actions, atol=1e-3)


def test_open_loop_has_one_window_for_an_episode(episodes):
    windows = Windows.fit(episodes, observe=1, predict=40, open_loop=True)
    history, actions = windows.cut(episodes)
    assert history.shape == (len(episodes), 1, 5)
    assert np.array_equal(history[:, 0], episodes.state[episodes.starts])
    for number, (first, end) in enumerate(zip(episodes.starts, episodes.ends, strict=True)):
        assert np.array_equal(actions[number, : end - first], episodes.action[first:end])
        assert (actions[number, end - first :] == episodes.action[end - 1]).all()


@pytest.mark.parametrize("frame", ["body", "world"])
def test_knots(episodes, frame):
    """A smooth way from rest to rest comes back from a quarter of its points."""
    windows = Windows.fit(episodes, frame=frame, predict=40, knots=10)
    assert (windows.points, windows.dim) == (10, 20)
    history, _ = windows.cut(episodes)
    share = np.linspace(0, 1, 41)[1:]
    share = share**2 * (3 - 2 * share)
    here = history[:, -1:, :2]
    way = here + share[:, None] * (np.array([300.0, 200.0]) - here)
    x = windows.chunks(way, history)
    assert x.shape == (len(history), 20)
    assert np.allclose(windows.actions(x, history), way, atol=0.1)
    seen = windows.chunks(np.repeat(np.arange(40.0)[:, None], 2, axis=1)[None], history[:1])
    if frame == "world":
        low, high = windows.action_range
        at_knots = (seen.numpy().reshape(10, 2) + 1) / 2 * (high - low) + low
        assert np.allclose(at_knots[:, 0], [3, 7, 11, 15, 19, 23, 27, 31, 35, 39], atol=1e-3)


def test_windows_survive_json(episodes):
    windows = Windows.fit(episodes, knots=4, open_loop=True)
    again = Windows.from_metadata(json.loads(json.dumps(windows.metadata())))
    assert (again.knots, again.open_loop, again.task) == (4, True, windows.task)
    history, _ = windows.cut(episodes)
    assert torch.equal(again.condition(history), windows.condition(history))


def test_without_intentions_the_actions_are_learned(episodes):
    windows = Windows.fit(episodes)
    silent = replace(episodes, intention=None)
    labels = [windows.cut(e, label="intention")[1] for e in (episodes, silent)]
    assert not np.array_equal(*labels)
    assert np.array_equal(labels[1], windows.cut(episodes)[1])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"frame": "room"}, "frame must be one of body"),
        ({"scale": "unit"}, "scale must be one of deviation"),
        ({"label": "wish"}, "label must be one of action"),
        ({"predict": 0}, "predict must be at least 1"),
        ({"knots": 17}, "knots must be at most the 16"),
    ],
)
def test_bad_windows(episodes, options, message):
    with pytest.raises(ValueError, match=message):
        Windows.fit(episodes, **options)


def test_any_constant_column_becomes_zero():
    state = np.tile([100.0, 100.0, 200.0, 200.0, 0.5], (30, 1))
    still = Episodes(state, state[:, :2], np.array([30]), PUSH_T)
    data = Windows.fit(still).dataset(still)
    assert torch.allclose(data.c, torch.zeros(30, 12), atol=1e-6)
    assert torch.allclose(data.x1, torch.zeros(30, 32), atol=1e-6)
