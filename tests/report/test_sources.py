"""Data of one's own: every layout that is read, and errors that name what is wrong."""

import numpy as np
import pytest

from cotlearn.report import from_arrays, read_data
from cotlearn.report.sources import from_episodes


def numbers(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=shape)


def saved(tmp_path, **arrays):
    path = tmp_path / "mine.npz"
    np.savez(path, **arrays)
    return path


def episodes():
    """Two episodes of 5 and 4 steps whose values say where they are."""
    state = np.arange(9.0)[:, None] * [1, 10]
    return state, 100 + np.arange(9.0)[:, None], np.array([5, 9])


def test_arrays_come_back():
    x1, c = numbers(30, 3), numbers(30, 2)
    rows = from_arrays(x1, c)
    np.testing.assert_allclose(rows.data.x1, x1, rtol=1e-6)
    np.testing.assert_allclose(rows.data.c, c, rtol=1e-6)
    assert (rows.group == np.arange(30)).all()
    assert rows.about == "30 rows of 3 numbers, conditions of 2 numbers"


@pytest.mark.parametrize("labels", [["a", "b", "a"], [7, 9, 7], [True, False, True]])
def test_labels_become_one_hot(labels):
    rows = from_arrays(numbers(3, 1), labels)
    assert sorted(map(tuple, rows.data.c.tolist()[:2])) == [(0, 1), (1, 0)]
    assert rows.data.c[0].tolist() == rows.data.c[2].tolist()
    assert "2 labels" in rows.about


def test_further_axes_are_flattened_and_a_vector_of_numbers_is_a_column():
    rows = from_arrays(numbers(5, 2, 4), numbers(5))
    assert rows.data.x1.shape == (5, 8)
    assert rows.data.c.shape == (5, 1)


def test_an_npz_with_groups(tmp_path):
    group = np.array([3, 3, 8, 8])
    rows = read_data(saved(tmp_path, x1=numbers(4, 2), c=numbers(4, 1), group=group))
    assert rows.group.tolist() == [0, 0, 1, 1]
    assert rows.data.name == "mine.npz"


def test_windows_of_episodes():
    rows = from_episodes(*episodes(), observe=2, predict=3, name="mine")
    assert rows.data.x1.shape == (9, 3)
    assert rows.data.c.shape == (9, 4)
    assert rows.data.c[0].tolist() == [0, 0, 0, 0]  # the first state is repeated
    assert rows.data.c[6].tolist() == [5, 50, 6, 60]
    assert rows.data.x1[3].tolist() == [103, 104, 104]  # and the last action
    assert rows.group.tolist() == [0] * 5 + [1] * 4


def test_a_zarr_of_diffusion_policy(tmp_path):
    zarr = pytest.importorskip("zarr")
    state, action, ends = episodes()
    group = zarr.open_group(tmp_path / "mine.zarr", mode="w")
    for name, values in (("data/obs", state), ("data/action", action), ("meta/episode_ends", ends)):
        group.create_array(name, data=values)
    rows = read_data(tmp_path / "mine.zarr", observe=1, predict=2)
    np.testing.assert_array_equal(rows.data.c, state)
    assert rows.data.x1.shape == (9, 2)


def lerobot(folder, **changes):
    pyarrow = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    state, action, _ = episodes()
    columns = {"observation.state": state.tolist(), "action": action.tolist()}
    columns |= {"episode_index": [0] * 5 + [1] * 4, "frame_index": [*range(5), *range(4)]}
    columns = {k: v for k, v in {**columns, **changes}.items() if v is not None}
    (folder / "data").mkdir(parents=True)
    turned = {name: list(reversed(values)) for name, values in columns.items()}
    parquet.write_table(pyarrow.table(turned), folder / "data" / "file-000.parquet")
    return folder


def test_a_lerobot_folder_whose_frames_are_out_of_order(tmp_path):
    rows = read_data(lerobot(tmp_path / "mine"), observe=1, predict=1)
    np.testing.assert_array_equal(rows.data.c, episodes()[0])
    assert rows.group.tolist() == [0] * 5 + [1] * 4


def test_damaged_and_foreign_files(tmp_path):
    (tmp_path / "text.npz").write_text("no zip")
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.zarr").mkdir()
    objects = saved(tmp_path, x1=np.array([{}, {}], dtype=object), c=numbers(2))
    for path, error, message in (
        (tmp_path / "nowhere.npz", FileNotFoundError, "no such file"),
        (tmp_path / "text.npz", ValueError, "text.npz is damaged, no .npz"),
        (tmp_path / "empty", ValueError, "no known layout: expected an .npz"),
        (tmp_path / "broken.zarr", ValueError, "broken.zarr"),
        (objects, ValueError, "Python objects"),
    ):
        with pytest.raises(error, match=message):
            read_data(path)


def test_a_lerobot_folder_without_states(tmp_path):
    with pytest.raises(ValueError, match=r"no column observation\.state"):
        read_data(lerobot(tmp_path / "mine", **{"observation.state": None}))


@pytest.mark.parametrize(
    ("arrays", "error", "message"),
    [
        ({"x1": numbers(3, 2)}, ValueError, "no array c; it has"),
        ({"x1": numbers(3, 2), "c": numbers(4)}, ValueError, "x1 has 3 rows, c has 4"),
        ({"x1": np.full((3, 2), np.nan), "c": numbers(3)}, ValueError, "x1 has NaN"),
        ({"x1": np.full((3, 2), 1e300), "c": numbers(3)}, ValueError, "x1 has NaN or infinite"),
        ({"x1": np.array(["a"] * 3), "c": numbers(3)}, TypeError, "x1 must hold real numbers"),
        ({"x1": numbers(0, 2), "c": numbers(0)}, ValueError, "x1 must have rows"),
        ({"x1": numbers(70, 1), "c": np.arange(70)}, ValueError, "70 different labels"),
        ({"x1": numbers(3), "c": numbers(3), "group": numbers(2)}, ValueError, "group must have"),
    ],
)
def test_an_npz_that_does_not_fit(arrays, error, message, tmp_path):
    with pytest.raises(error, match=message):
        read_data(saved(tmp_path, **arrays))


@pytest.mark.parametrize("ends", [[4, 4, 9], [5, 8], [], [5.0, 9.0]])
def test_ends_that_do_not_rise(ends):
    with pytest.raises(ValueError, match="ends must rise to the number of rows 9"):
        from_episodes(*episodes()[:2], ends, observe=2, predict=3, name="mine")
