import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from cotlearn.policies.windows import Windows
from cotlearn.robots import episodes as module
from cotlearn.robots.episodes import Episodes, read, split, write_lerobot
from cotlearn.robots.episodes.lerobot import pose_of
from cotlearn.robots.episodes.npz import write_arrays
from cotlearn.robots.push_t import GOAL, corners
from cotlearn.robots.push_t.task import KEYPOINTS, PIXEL, TURN


def same(a, b, tolerance=0.0):
    assert np.array_equal(a.ends, b.ends)
    assert np.allclose(a.action, b.action, atol=tolerance)
    assert np.allclose(a.state[:, :4], b.state[:, :4], atol=tolerance)
    turn = (a.state[:, 4] - b.state[:, 4] + np.pi) % (2 * np.pi) - np.pi
    assert np.allclose(turn, 0, atol=1e-4 if tolerance else 0)


# --- store ----------------------------------------------------------------------------------------


def test_select_and_split(episodes):
    some = episodes.select([3, 1])
    rows = slice(episodes.starts[3], episodes.ends[3])
    assert np.array_equal(some.state[: some.ends[0]], episodes.state[rows])
    assert some.lengths.tolist() == episodes.lengths[[3, 1]].tolist()
    assert some.seed.tolist() == [3, 1]
    train, held = split(episodes, held_out=4, seed=1)
    assert (len(train), len(held)) == (8, 4)
    assert not set(train.seed) & set(held.seed)
    fewer, again = split(episodes, held_out=4, train=3, seed=1)
    assert again.seed.tolist() == held.seed.tolist()
    assert set(fewer.seed) < set(train.seed)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        (
            lambda e: {"state": e.state[:, :4]},
            ValueError,
            r"state has shape .*, 4\), expected",
        ),
        (lambda e: {"action": e.action[:-1]}, ValueError, "action has shape .*, expected"),
        (lambda e: {"action": e.action.astype(str)}, TypeError, "action must hold real numbers"),
        (lambda e: {"ends": e.ends[:-1]}, ValueError, "state has shape .*, expected"),
        (lambda e: {"ends": e.ends[::-1]}, ValueError, "ends must rise"),
        (lambda e: {"ends": e.ends.astype(float)}, TypeError, "ends must hold integers"),
        (lambda e: {"seed": e.seed[:3]}, ValueError, "seed has shape"),
    ],
)
def test_arrays_that_do_not_fit(episodes, change, error, message):
    with pytest.raises(error, match=f"a few: {message}"):
        replace(episodes, **change(episodes))


@pytest.mark.parametrize("value", [np.nan, -1.0, 513.0])
def test_a_bad_value_is_located(episodes, value):
    action = episodes.action.copy()
    action[episodes.starts[2] + 5, 1] = value
    with pytest.raises(ValueError, match="step 5 of episode 2; 1 rows are like that"):
        replace(episodes, action=action)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda e: split(e, held_out=12), "held_out must be below the 12 episodes"),
        (lambda e: split(e, held_out=2, train=11), "train must be at most the 10 remaining"),
    ],
)
def test_bad_choices(episodes, call, message):
    with pytest.raises(ValueError, match=message):
        call(episodes)


def write_own(path, episodes):
    arrays = {
        "state": np.column_stack(
            [
                np.rint(episodes.state[:, :4] / PIXEL),
                np.rint((episodes.state[:, 4] + np.pi) % (2 * np.pi) / TURN - 32768),
            ]
        ).astype(np.int16),
        "action": np.rint(episodes.action / PIXEL).astype(np.int16),
        "intention": np.rint(episodes.intention / PIXEL).astype(np.int16),
        "episode_ends": episodes.ends,
        "seed": episodes.seed.astype(np.uint32),
    }
    write_arrays(path, arrays, {"task": "Push-T"})
    return path


def test_own_file(episodes, tmp_path):
    path = write_own(tmp_path / "demos.npz", episodes)
    stored = read(path)
    same(stored, episodes, 0.02)
    assert np.allclose(stored.intention, episodes.intention, atol=0.02)
    assert stored.seed.tolist() == episodes.seed.tolist()


def test_other_and_damaged_files(episodes, tmp_path):
    with pytest.raises(FileNotFoundError, match="no such file"):
        read(tmp_path / "none.npz")
    np.savez(tmp_path / "other.npz", x=np.zeros(3))
    with pytest.raises(ValueError, match="is not a file of demonstrations"):
        read(tmp_path / "other.npz")
    path = write_own(tmp_path / "demos.npz", episodes)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"demos.npz is damaged"):
        read(path)
    (tmp_path / "notes").mkdir()
    with pytest.raises(ValueError, match=r"the layout of .* is unknown"):
        read(tmp_path / "notes")


# --- windows --------------------------------------------------------------------------------------


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


def test_whole_episodes_have_one_window(episodes):
    windows = Windows.fit(episodes, observe=1, predict=40, whole=True)
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
    windows = Windows.fit(episodes, knots=4, whole=True)
    again = Windows.from_about(json.loads(json.dumps(windows.about())))
    assert (again.knots, again.whole, again.task) == (4, True, windows.task)
    history, _ = windows.cut(episodes)
    assert torch.equal(again.condition(history), windows.condition(history))


@pytest.mark.parametrize(
    ("call", "error", "message"),
    [
        (lambda w, e: w.condition(np.zeros((3, 1, 5))), ValueError, r"shape \(rows, 2, 5\)"),
        (lambda w, e: w.condition(np.zeros((2, 5))), ValueError, r"got \(2, 5\)"),
        (lambda w, e: w.condition(np.full((3, 2, 5), np.nan)), ValueError, r"rows \[0, 1, 2\]"),
        (lambda w, e: w.condition(np.full((3, 2, 5), "a")), TypeError, "history must hold real"),
        (
            lambda w, e: w.actions(torch.zeros(3, 30), np.zeros((3, 2, 5))),
            ValueError,
            r"x must have shape \(3, 32\), got \(3, 30\)",
        ),
        (
            lambda w, e: w.chunks(np.zeros((3, 8, 2)), np.zeros((3, 2, 5))),
            ValueError,
            r"actions must have shape \(3, 16, 2\)",
        ),
        (lambda w, e: Windows.fit(e, frame="room"), ValueError, "frame must be one of body"),
        (lambda w, e: Windows.fit(e, scale="unit"), ValueError, "scale must be one of deviation"),
        (lambda w, e: Windows.fit(e, predict=0), ValueError, "predict must be at least 1"),
        (lambda w, e: Windows.fit(e, knots=17), ValueError, "knots must be at most the 16"),
        (
            lambda w, e: w.dataset(replace(e, intention=None), label="intention"),
            ValueError,
            "a few has no intentions",
        ),
        (
            lambda w, e: replace(w, action_range=np.array([[1.0, 1.0], [0.0, 0.0]])),
            ValueError,
            "action_range must hold the smallest values first",
        ),
    ],
)
def test_bad_windows(episodes, call, error, message):
    with pytest.raises(error, match=message):
        call(Windows.fit(episodes), episodes)


# --- other layouts --------------------------------------------------------------------------------


def write_replay(path, episodes, zarr_format=2):
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(path, mode="w", zarr_format=zarr_format)
    data, meta = group.create_group("data"), group.create_group("meta")
    data.create_array("state", data=episodes.state.astype(np.float32), chunks=(50, 5))
    data.create_array("action", data=episodes.action.astype(np.float32), chunks=(50, 2))
    data.create_array("img", data=np.zeros((len(episodes.state), 2, 2, 3), np.float32))
    meta.create_array("episode_ends", data=episodes.ends)
    return path


@pytest.mark.parametrize("zarr_format", [2, 3])
def test_diffusion_policys_layout(episodes, tmp_path, zarr_format):
    path = write_replay(tmp_path / "pusht.zarr", episodes, zarr_format)
    same(read(path), episodes, 1e-3)


def test_a_zipped_replay_buffer(episodes, tmp_path):
    import shutil

    folder = write_replay(tmp_path / "pusht.zarr", episodes)
    file = shutil.make_archive(str(folder), "zip", folder)
    same(read(file), episodes, 1e-3)
    with open(file, "r+b") as opened:
        opened.truncate(1000)
    with pytest.raises(ValueError, match="is damaged"):
        read(file)


def test_a_replay_buffer_without_states(episodes, tmp_path):
    import shutil

    path = write_replay(tmp_path / "pusht.zarr", episodes)
    shutil.rmtree(path / "data" / "state")
    with pytest.raises(ValueError, match="has no data/state"):
        read(path)


def test_lerobots_layout_there_and_back(episodes, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_lerobot(tmp_path / "set", episodes)
    same(read(path), episodes, 1e-3)
    info = json.loads((path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (12, len(episodes.state))
    table = parquet.read_table(path / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        assert str(np.array(table[name].to_pylist()[:1]).shape[1:]) in (
            "()",
            str(tuple(feature["shape"])),
        )
    about = parquet.read_table(path / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert about["length"].to_pylist() == episodes.lengths.tolist()
    stats = json.loads((path / "meta" / "stats.json").read_text())
    assert np.allclose(stats["action"]["max"], episodes.action.max(axis=0), atol=1e-3)
    with pytest.raises(ValueError, match="must be an empty folder"):
        write_lerobot(path, episodes)


def test_one_file_for_each_episode_in_any_order(episodes, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    whole = parquet.read_table(write_lerobot(tmp_path / "set", episodes) / "data" / "chunk-000")
    folder = tmp_path / "older" / "data" / "chunk-000"
    folder.mkdir(parents=True)
    for index in range(12):
        part = whole.filter(pyarrow.compute.equal(whole["episode_index"], index))
        parquet.write_table(part, folder / f"episode_{11 - index:06d}.parquet")
    same(read(tmp_path / "older"), episodes, 1e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda t: t.drop_columns(["observation.environment_state"]),
            "no column observation.environment_state; agent and pose",
        ),
        (lambda t: t.drop_columns(["action"]), "has no column action"),
        (lambda t: t.slice(3), "frame 3 follows where 0 should"),
    ],
)
def test_lerobot_sets_that_do_not_fit(episodes, tmp_path, change, message):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_lerobot(tmp_path / "set", episodes)
    file = path / "data" / "chunk-000" / "file-000.parquet"
    parquet.write_table(change(parquet.read_table(file)), file)
    with pytest.raises(ValueError, match=message):
        read(path)


def test_damaged_parquet(episodes, tmp_path):
    pytest.importorskip("pyarrow")
    path = write_lerobot(tmp_path / "set", episodes)
    (path / "data" / "chunk-000" / "file-000.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(ValueError, match="is damaged or not a parquet file"):
        read(path)


def test_the_pose_from_key_points():
    pose = np.array([[100.0, 200.0, 2.5], [300.0, 50.0, -1.0]])
    points = corners(pose, points=KEYPOINTS)
    found, miss = pose_of(points)
    assert np.allclose(found, pose)
    assert np.allclose(miss, 0, atol=1e-9)
    assert pose_of(1.2 * points)[1].min() > 5


def test_a_missing_package_is_named(monkeypatch, tmp_path):
    import importlib

    def missing(name):
        raise ModuleNotFoundError(name)

    (tmp_path / "x.zarr").mkdir()
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ModuleNotFoundError, match=r"zarr is not installed.*cotlearn\[formats\]"):
        module.read_replay_buffer(tmp_path / "x.zarr")


def test_any_constant_column_becomes_zero():
    state = np.tile([100.0, 100.0, 200.0, 200.0, 0.5], (30, 1))
    still = Episodes(state, state[:, :2], np.array([30]))
    data = Windows.fit(still).dataset(still)
    assert torch.allclose(data.c, torch.zeros(30, 12), atol=1e-6)
    assert torch.allclose(data.x1, torch.zeros(30, 32), atol=1e-6)
