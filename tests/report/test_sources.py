"""Data of one's own: every layout that is read, and errors that name what is wrong."""

import contextlib
import json
import pickle
import shutil
from pathlib import Path

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
    one = from_arrays(x1[:, :1], c[:, :1])
    assert one.about == "30 rows of 1 number, conditions of 1 number"


@pytest.mark.parametrize("labels", [["a", "b", "a"], [7, 9, 7], [True, False, True]])
def test_labels_become_one_hot(labels):
    rows = from_arrays(numbers(3, 1), labels)
    assert sorted(map(tuple, rows.data.c.tolist()[:2])) == [(0, 1), (1, 0)]
    assert rows.data.c[0].tolist() == rows.data.c[2].tolist()
    assert "2 labels" in rows.about


def test_a_column_that_may_hold_labels_is_named():
    """Before, a class 0, 1 or 2 beside a number was a number without a word."""
    label, place = np.arange(60) % 3, numbers(60, 2)
    words = "column 0 of c has 3 values: if these are labels, make them one-hot"
    assert from_arrays(place, np.column_stack([label, place])).notes == (words,)
    assert from_arrays(place, label[:, None]).notes == (words,)  # alone; before, it was not named
    others = np.column_stack([np.eye(3)[label], place]), np.column_stack([np.arange(60), place])
    for c in (
        *others,
        np.column_stack([label / 2, place]),
        np.column_stack([label, 2 * label]),
    ):
        assert from_arrays(place, c).notes == ()


def test_a_condition_that_does_not_vary_is_named():
    """Before, there was no word about it, and strata by its only label were recommended."""
    for c in (np.ones((30, 1)), np.ones((30, 2)), ["a"] * 30):
        rows = from_arrays(numbers(30, 2), c)
        assert rows.notes == ("c does not vary: every coupling is then one without a condition",)
    assert rows.about == "30 rows of 2 numbers, 1 label"
    one = from_arrays(numbers(30, 2), np.insert(numbers(30, 2), 1, 7, axis=1))
    assert one.notes == ("column 1 of c does not vary: leave it out",)
    many = from_arrays(numbers(30, 2), np.insert(np.ones((30, 7)), 0, numbers(30), axis=1))
    words = "columns 1, 2, 3, 4, 5 and 2 more of c do not vary: leave them out"
    assert many.notes == (words,)


def test_copies_share_a_group():
    """Before, copies of training rows were held out, without a word, and the gain was a fiction."""
    x1, c = numbers(30, 2), numbers(30, 1, seed=1)
    rows = from_arrays(np.tile(x1, (40, 1)), np.tile(c, (40, 1)))
    assert rows.group.tolist() == [*range(30)] * 40
    [note] = rows.notes
    assert note.startswith("rows that repeat another one, in x1 and in c: 1170 of 1200; equal rows")
    alike = from_arrays(np.zeros((30, 1)), c)  # in x1 alone
    assert (alike.group.tolist(), alike.notes) == ([*range(30)], ())
    zeros = from_arrays([[0.0], [-0.0], [1.0]], [[1.0], [1.0], [2.0]])
    assert zeros.group.tolist() == [0, 0, 1]


def test_copies_in_groups_that_were_given():
    x1, c, group = numbers(30, 2), numbers(30, 1, seed=1), np.arange(30)
    twice = np.tile(x1, (2, 1)), np.tile(c, (2, 1))
    apart = from_arrays(*twice, group=np.append(group, [*range(20), *range(30, 40)]))
    assert apart.group.tolist() == [*range(30), *range(20), *range(30, 40)]
    [note] = apart.notes
    assert note.startswith("rows that repeat one of another group, in x1 and in c: 20 of 60; leave")
    assert from_arrays(*twice, group=np.tile(group, 2)).notes == ()


def test_text_and_numbers_in_one_matrix():
    """Before, the error began with the whole matrix, and said nothing of what to do."""
    text, place = np.array(["a", "b"] * 300), numbers(600, 1)
    mixed = np.column_stack([text, place]), np.column_stack([text.astype(object), place])
    for c in (*mixed, mixed[0].tolist(), text[:, None], text[:, None].astype(bytes)):
        with pytest.raises(
            TypeError, match=r"got text in shape \(600, .\): make each col.* one-hot"
        ):
            from_arrays(place, c)
    with pytest.raises(TypeError, match=r"c must hold real .*, got objects such as None$"):
        from_arrays(numbers(3, 1), np.array([1, None, 2], dtype=object))
    with pytest.raises(TypeError, match=r"c must hold real .*, got \[\[1\], \[2, 3\]\]$"):
        from_arrays(place, [[1], [2, 3]])


def test_strings_are_labels_however_they_are_held():
    """As pandas holds them, and NumPy since version 2."""
    words = ["a", "b", "a"]
    for held in (np.array(words, dtype=object), np.array(words, dtype=np.dtypes.StringDType())):
        rows = from_arrays(numbers(3, 1), held, group=held)
        assert rows.data.c.tolist() == [[1, 0], [0, 1], [1, 0]]
        assert rows.group.tolist() == [0, 1, 0]
    with pytest.raises(TypeError, match=r"c must hold real numbers or strings, got .*None"):
        from_arrays(numbers(3, 1), np.array(["a", None, "b"], dtype=object))


@pytest.mark.parametrize("name", ["x1", "c"])
@pytest.mark.parametrize(
    "lost",
    [
        1_760_000_000_000_000_000 + np.arange(200)[:, None],
        2**63 + np.arange(200, dtype=np.uint64)[:, None],
        1e15 + np.arange(200.0)[:, None],
        numbers(200, 2) * 1e-46,
        numbers(200, 2) * 1e-50,
        numbers(200, 2) * 1e-170,
    ],
)
def test_distinct_rows_do_not_become_one(name, lost, tmp_path):
    """Of each of these, float32 keeps 1 row of 200."""
    arrays = {"x1": numbers(200, 2), "c": numbers(200, 2), name: lost}
    with pytest.raises(ValueError, match=f"{name} has values up to .* would merge them; subtract"):
        from_arrays(**arrays)
    with pytest.raises(ValueError, match=f"{name} has values up to .* would merge them; subtract"):
        read_data(saved(tmp_path, **arrays))
    above = lost - lost.min()
    arrays[name] = above / above.max()
    kept = getattr(from_arrays(**arrays).data, name)
    assert len(kept.unique(dim=0)) == 200


def test_a_sentinel_hides_no_rows_that_merge():
    """The column deviates by 7e8, but its other values by 60: float32 would keep 4 of 200."""
    times = np.where(np.arange(200) % 5, 1.7e9 + np.arange(200.0), -9999.0)[:, None]
    with pytest.raises(ValueError, match=r"x1 has values up to 1.7e\+09 .* would merge them"):
        from_arrays(times, numbers(200, 1))


def test_integers_that_float32_holds_are_taken_to_the_ends_of_their_range():
    ends = np.array([[-(2**63)], [2**63 - 1], [0]])
    assert from_arrays(numbers(3, 1), ends).data.c[:, 0].tolist() == [-(2.0**63), 2.0**63, 0.0]
    same = np.full((3, 1), 2**62 + 1)
    assert len(from_arrays(numbers(3, 1), same).data.c.unique()) == 1


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


def a_zarr(path, change=None, chunk=None, zarr_format=2):
    """A replay buffer whose arrays' metadata and chunks may be changed."""
    zarr = pytest.importorskip("zarr")
    group = zarr.open_group(path, mode="w", zarr_format=zarr_format)
    state, action, ends = episodes()
    for name, values in (("data/obs", state), ("data/action", action), ("meta/episode_ends", ends)):
        group.create_array(name, data=values)
    for file in path.glob("*/*/.zarray" if zarr_format == 2 else "*/*/zarr.json"):
        if change:
            file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
        for part in file.parent.rglob("0*") if chunk is not None else ():
            if part.is_file():
                part.write_bytes(chunk)
    return path


def test_a_zarr_group_is_found_wherever_it_lies(tmp_path):
    folder = a_zarr(tmp_path / "in" / "mine.zarr")
    flat = shutil.make_archive(str(tmp_path / "flat.zarr"), "zip", folder)
    deep = shutil.make_archive(str(tmp_path / "deep"), "zip", tmp_path / "in")
    (renamed := tmp_path / "renamed").mkdir()
    shutil.copytree(folder, renamed, dirs_exist_ok=True)
    for path in (folder, tmp_path / "in", flat, deep, renamed):
        rows = read_data(path, observe=1, predict=2)
        np.testing.assert_array_equal(rows.data.c, episodes()[0])


class Ran:
    """Writes a file when it is unpickled."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return Path.touch, (self.path,)


PICKLE = {"id": "pickle", "protocol": 5}
DELTA = {"id": "delta", "dtype": "<f8"}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"compressor": PICKLE}, ""),
        ({"filters": [DELTA, PICKLE]}, ""),
        ({"filters": [DELTA]}, "data/obs is stored with delta, which is not decoded"),
        ({"compressor": {"id": "lzma"}}, "data/obs is stored with lzma, which is not decoded"),
        ({"compressor": None, "filters": [PICKLE], "dtype": "|O", "fill_value": None}, ""),
    ],
)
def test_a_zarr_that_names_a_codec_which_could_run_code(tmp_path, monkeypatch, change, message):
    pickles = pytest.importorskip("numcodecs.pickles")
    monkeypatch.setattr(pickles, "ALLOW_UNSAFE_PICKLE_DECODE", True)
    code = pickle.dumps(Ran(ran := tmp_path / "ran"))
    path = a_zarr(tmp_path / "a.zarr", change, code)
    with pytest.raises(ValueError, match=rf"a\.zarr.*{message}"):
        read_data(path)
    assert not ran.exists()


@pytest.mark.parametrize(
    ("zarr_format", "change", "chunk"),
    [
        (2, {"compressor": {"id": "zlib"}}, b"garbage!" * 9),
        (2, {"compressor": {"id": "lzma"}}, b"garbage!" * 9),
        (2, {"compressor": {"id": "unknown"}}, b"garbage!" * 9),
        (2, {"compressor": None}, b"short"),
        (2, {"shape": "many"}, None),
        (2, {"dtype": "<U3", "fill_value": ""}, None),
        (3, {}, b"garbage!" * 9),
        (3, {"codecs": [{"name": "numcodecs.pickle", "configuration": {}}]}, None),
        (3, {"codecs": [{"name": "vlen-bytes"}]}, None),
    ],
)
def test_damaged_and_foreign_zarrs_are_named(tmp_path, zarr_format, change, chunk):
    path = a_zarr(tmp_path / "a.zarr", change, chunk, zarr_format)
    with pytest.raises(ValueError, match=r"a\.zarr"):
        read_data(path)


def test_one_damaged_byte_of_an_npz_is_refused_by_name(tmp_path):
    path = tmp_path / "mine.npz"
    np.savez_compressed(path, x1=numbers(60, 2), c=numbers(60, 3))
    whole = path.read_bytes()
    for place in range(0, len(whole), 7):
        damaged = bytearray(whole)
        damaged[place] ^= 0x55
        path.write_bytes(damaged)
        with contextlib.suppress(ValueError):  # the only error there is
            read_data(path)
    np.save(tmp_path / "a.npy", numbers(3))
    (tmp_path / "a.npy").rename(path)
    with pytest.raises(ValueError, match=r"mine\.npz is no \.npz file"):
        read_data(path)


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
        (tmp_path / "text.npz", ValueError, r"text\.npz is no \.npz file"),
        (tmp_path / "empty", ValueError, "no known layout: expected an .npz"),
        (tmp_path / "broken.zarr", ValueError, "broken.zarr"),
        (objects, ValueError, r"x1 holds Python objects, .*save words as x1\.astype\(str\)"),
    ):
        with pytest.raises(error, match=message):
            read_data(path)


def test_hidden_files_beside_a_lerobot_table(tmp_path):
    folder = lerobot(tmp_path / "mine")
    (folder / "data" / "._file-000.parquet").write_bytes(b"of macOS")
    assert len(read_data(folder).data) == 9
    (only := tmp_path / "only" / "data").mkdir(parents=True)
    (only / "._file-000.parquet").touch()
    with pytest.raises(ValueError, match="no known layout"):
        read_data(only.parent)


@pytest.mark.parametrize("name", ["episode_index", "frame_index"])
@pytest.mark.parametrize("wrong", [None, "a", 0.5, [1]])
def test_indices_of_a_lerobot_folder_that_are_no_integers(tmp_path, name, wrong):
    kind = type(wrong)
    values = [wrong] * 9 if kind in (str, list) else [wrong, *range(1, 9)]
    values = [float(v) for v in values] if kind is float else values
    with pytest.raises(ValueError, match=rf"mine: {name} must hold an integer in each frame"):
        read_data(lerobot(tmp_path / "mine", **{name: values}))


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


def test_arrays_that_are_not_read_are_named(tmp_path):
    """Rows of one episode were split between training and test."""
    path = saved(tmp_path, x1=numbers(8), c=numbers(8), groups=np.arange(8) // 2)
    with pytest.raises(ValueError, match="has an array groups, which is not read: call it group"):
        read_data(path)
    path = saved(tmp_path, x1=numbers(8), c=numbers(8), when=np.arange(8))
    assert "Not read: when." in read_data(path).notes
