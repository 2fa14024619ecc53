import importlib
import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from peers import lerobot

from cotlearn.course.assets import find_data
from cotlearn.robots.episodes import read, split, write_lerobot
from cotlearn.robots.episodes.npz import write_arrays
from cotlearn.robots.push_t import corners
from cotlearn.robots.push_t.constants import KEYPOINTS, PIXEL, TURN
from cotlearn.robots.push_t.lerobot import pose_of


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
        (lambda e: {"state": e.state[:, :4]}, ValueError, r"state has shape .*, 4\), expected"),
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


def test_bad_choices(episodes):
    with pytest.raises(ValueError, match="held_out must be below the 12 episodes"):
        split(episodes, held_out=12)
    with pytest.raises(ValueError, match="train must be at most the 10 remaining"):
        split(episodes, held_out=2, train=11)


def write_own(path, episodes):
    turns = np.rint((episodes.state[:, 4] + np.pi) % (2 * np.pi) / TURN - 32768)
    numbers = {
        "state": np.column_stack([np.rint(episodes.state[:, :4] / PIXEL), turns]),
        "action": np.rint(episodes.action / PIXEL),
        "intention": np.rint(episodes.intention / PIXEL),
    }
    arrays = {name: values.astype(np.int16) for name, values in numbers.items()}
    arrays |= {"episode_ends": episodes.ends, "seed": episodes.seed.astype(np.uint32)}
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
    with pytest.raises(ValueError, match="is no recording: it holds x"):
        read(tmp_path / "other.npz")
    path = write_own(tmp_path / "demos.npz", episodes)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(ValueError, match=r"demos.npz is damaged"):
        read(path)
    (tmp_path / "notes").mkdir()
    with pytest.raises(ValueError, match=r"the layout of .* is unknown"):
        read(tmp_path / "notes")


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


def data_of(path):
    return pytest.importorskip("zarr").open_group(path, mode="r+")["data"]


@pytest.mark.parametrize("zarr_format", [2, 3])
def test_diffusion_policys_layout(episodes, tmp_path, zarr_format):
    path = write_replay(tmp_path / "pusht.zarr", episodes, zarr_format)
    same(read(path), episodes, 1e-3)


def test_a_zipped_replay_buffer(episodes, tmp_path):
    folder = write_replay(tmp_path / "pusht.zarr", episodes)
    file = shutil.make_archive(str(folder), "zip", folder)
    same(read(file), episodes, 1e-3)
    with open(file, "r+b") as opened:
        opened.truncate(1000)
    with pytest.raises(ValueError, match="is damaged"):
        read(file)


def test_a_replay_buffer_without_states(episodes, tmp_path):
    path = write_replay(tmp_path / "pusht.zarr", episodes)
    shutil.rmtree(path / "data" / "state")
    with pytest.raises(ValueError, match="has no data/state"):
        read(path)


def test_a_replay_buffer_of_no_task(episodes, tmp_path):
    path = write_replay(tmp_path / "pusht.zarr", episodes)
    data = data_of(path)
    data.create_array("state", data=episodes.state[:, :4], overwrite=True)
    with pytest.raises(ValueError, match=r"which is no task's; .* push-t 5 and 2"):
        read(path)


def test_a_task_without_a_layout_is_not_written(tmp_path):
    few = read(find_data("arm_ring_demos.npz")).select([0])
    with pytest.raises(ValueError, match="episodes of arm-ring have no layout of LeRobot"):
        write_lerobot(tmp_path / "set", few)


def test_lerobots_layout_there_and_back(episodes, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_lerobot(tmp_path / "set", episodes)
    same(read(path), episodes, 1e-3)
    info = json.loads((path / "meta" / "info.json").read_text())
    assert (info["total_episodes"], info["total_frames"]) == (12, len(episodes.state))
    table = parquet.read_table(path / info["data_path"].format(chunk_index=0, file_index=0))
    assert set(table.column_names) == set(info["features"])
    for name, feature in info["features"].items():
        assert np.array(table[name].to_pylist()[:1]).shape[1:] in ((), tuple(feature["shape"]))
    about = parquet.read_table(path / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert about["length"].to_pylist() == episodes.lengths.tolist()
    stats = json.loads((path / "meta" / "stats.json").read_text())
    assert np.allclose(stats["action"]["max"], episodes.action.max(axis=0), atol=1e-3)
    with pytest.raises(ValueError, match="must be an empty folder"):
        write_lerobot(path, episodes)


def test_pandas_finds_a_task_by_its_name_as_lerobot_does(episodes, tmp_path):
    pytest.importorskip("pyarrow")
    pandas = pytest.importorskip("pandas")
    path = write_lerobot(tmp_path / "set", episodes)
    tasks = pandas.read_parquet(path / "meta" / "tasks.parquet")
    assert (tasks.index.name, list(tasks.columns)) == ("task", ["task_index"])
    assert tasks.loc[tasks.index[0], "task_index"] == 0
    assert tasks.index[0] == episodes.task.lerobot.instruction


@pytest.mark.slow
def test_lerobot_itself_reads_what_we_write(episodes, tmp_path):
    lerobot()
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    path = write_lerobot(tmp_path / "set", episodes)
    offsets = [step / 10 for step in range(16)]
    rows = LeRobotDataset("local/set", root=path, delta_timestamps={"action": offsets})
    assert (len(rows), rows.fps) == (len(episodes.state), 10)
    frame = int(episodes.ends[0]) - 4  # four actions are left in this episode
    row = rows[frame]
    assert np.allclose(row["action"][:4], episodes.action[frame : frame + 4], atol=1e-3)
    assert row["action_is_pad"].tolist() == [False] * 4 + [True] * 12
    assert np.allclose(row["action"][4:], episodes.action[frame + 3], atol=1e-3)
    assert np.allclose(row["observation.state"], episodes.state[frame, :2], atol=1e-3)
    assert row["task"] == episodes.task.lerobot.instruction
    assert np.allclose(rows.meta.stats["action"]["mean"], episodes.action.mean(axis=0), atol=1e-3)


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


POSE = "observation.environment_state"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t.drop_columns([POSE]), f"push-t needs agent and pose of the T in .*{POSE}"),
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


def test_a_flipped_bit_of_a_parquet_file_with_checksums(episodes, tmp_path):
    parquet = pytest.importorskip("pyarrow.parquet")
    path = write_lerobot(tmp_path / "set", episodes)
    file = path / "data" / "chunk-000" / "file-000.parquet"
    plain = {"write_page_checksum": True, "compression": "none", "use_dictionary": False}
    parquet.write_table(parquet.read_table(file), file, **plain)
    read(path)
    content = bytearray(file.read_bytes())
    content[len(content) // 3] ^= 64
    file.write_bytes(content)
    with pytest.raises(ValueError, match="is damaged"):
        read(path)


def test_a_lost_chunk_of_a_replay_buffer_is_said(episodes, tmp_path):
    path = write_replay(tmp_path / "pusht.zarr", episodes)
    data = data_of(path)
    data.create_array("action", data=data["action"][:], chunks=(8, 2), overwrite=True)
    read(path)
    (path / "data" / "action" / "1.0").unlink()
    with pytest.warns(UserWarning, match=r"1 of \d+ chunks of data/action are not stored"):
        read(path)


def test_damaged_parquet(episodes, tmp_path):
    pytest.importorskip("pyarrow")
    path = write_lerobot(tmp_path / "set", episodes)
    (path / "data" / "chunk-000" / "file-000.parquet").write_bytes(b"PAR1 no more")
    with pytest.raises(ValueError, match="is damaged or holds a file that is not a parquet file"):
        read(path)


def test_the_pose_from_key_points():
    pose = np.array([[100.0, 200.0, 2.5], [300.0, 50.0, -1.0]])
    points = corners(pose, points=KEYPOINTS)
    found, miss = pose_of(points)
    assert np.allclose(found, pose)
    assert np.allclose(miss, 0, atol=1e-9)
    assert pose_of(1.2 * points)[1].min() > 5


def test_a_missing_package_is_named(monkeypatch, tmp_path):
    def missing(name):
        raise ModuleNotFoundError(name)

    (tmp_path / "x.zarr").mkdir()
    monkeypatch.setattr(importlib, "import_module", missing)
    with pytest.raises(ModuleNotFoundError, match=r"zarr is not installed.*'\.\[formats\]'"):
        read(tmp_path / "x.zarr")
