"""One damaged byte: every kind of file that is read is refused by name, or gives what it gave.

Weights, checkpoints and demonstrations carry a sum of their contents, so every byte counts. Results
(JSON) and submissions are texts without a sum: of them only broken text can be seen. Files of the
course are damaged in tests/course/test_assets.py, hand-ins in tests/course/test_submissions.py.
"""

from functools import partial

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from cotlearn.results import Table
from cotlearn.robots.episodes.npz import read_arrays, write_arrays
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.storage import load_tensors, save_tensors


def weights(path):
    save_tensors(path, {"w": torch.arange(300.0).reshape(20, 15)}, {"steps": 3})


def demonstrations(path):
    rng = np.random.default_rng(0)
    rows = {"state": 5, "action": 2, "intention": 2}
    arrays = {name: rng.integers(0, 9000, (40, n)).astype("int16") for name, n in rows.items()}
    arrays |= {"episode_ends": np.array([15, 40]), "seed": np.array([3, 4], dtype="uint32")}
    write_arrays(path, arrays, {"task": PUSH_T.title, "seed": 0, "versions": {}})


def read_demonstrations(path):
    arrays, about = read_arrays(path)
    return [{name: array.tolist() for name, array in arrays.items()}, about]


def read_weights(path):
    tensors, about = load_tensors(path)
    return [tensors["w"].tolist(), about]


PAIRS = [(weights, read_weights), (demonstrations, read_demonstrations)]


@pytest.mark.parametrize(("write", "read"), PAIRS, ids=["weights", "demonstrations"])
def test_no_byte_can_change_what_is_read(tmp_path, write, read):
    path = tmp_path / "some.file"
    write(path)
    whole, right = path.read_bytes(), read(path)
    refused = 0
    for place in range(0, len(whole), max(1, len(whole) // 300)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            found = read(path)
        except ValueError as error:
            assert "some.file" in str(error), error  # noqa: PT017
            refused += 1
        else:
            assert found == right, f"byte {place} changed what was read"
    assert refused > 200


def test_json_that_is_too_deep(tmp_path):
    deep = "[" * 100_000
    save_file({"w": torch.zeros(1)}, tmp_path / "deep.safetensors", metadata={"cotlearn": deep})
    np.savez(tmp_path / "deep.npz", about=np.array(deep))
    (tmp_path / "deep.csv").write_text(f"# protocol: {deep}\n")
    table = partial(Table, question="", command="", protocol={})
    readers = {"safetensors": load_tensors, "npz": read_arrays, "csv": table}
    for kind, read in readers.items():
        with pytest.raises(ValueError, match=rf"deep\.{kind} is damaged"):
            read(tmp_path / f"deep.{kind}")
