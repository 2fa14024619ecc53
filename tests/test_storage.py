"""Tensors on disk: exact, whole or not at all, and never quietly damaged."""

import json
import os

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from cotlearn.storage import load_tensors, save_tensors

TENSORS = {
    "weights": torch.randn(4, 3, generator=torch.Generator().manual_seed(0)),
    "count": torch.tensor(7),
    "empty": torch.zeros(0, 3),
    "double": torch.tensor([1 / 3], dtype=torch.float64),
    "half": torch.tensor([0.5], dtype=torch.bfloat16),
    "flags": torch.tensor([True, False]),
}
ABOUT = {"plan": {"steps": 3, "ema": 0.99}, "names": ["a", "ü"], "none": None}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "some.safetensors"


def test_what_is_read_is_what_was_written(path):
    save_tensors(path, TENSORS, ABOUT)
    tensors, about = load_tensors(path)
    assert about == ABOUT
    assert tensors.keys() == TENSORS.keys()
    for name, value in TENSORS.items():
        assert tensors[name].dtype == value.dtype
        assert torch.equal(tensors[name], value)


def test_numbers_as_keys_are_read_as_words(path):
    """Of 2 and 16 it said that the file was damaged: numbers and words sort differently."""
    save_tensors(path, {}, {"success": {2: 0.5, 16: 0.7}})
    assert load_tensors(path)[1] == {"success": {"2": 0.5, "16": 0.7}}


def test_views_transposed_tensors_and_shared_memory(path):
    whole = torch.arange(12.0).reshape(3, 4)
    views = {"columns": whole[:, 1:3], "turned": whole.T, "same": whole, "again": whole}
    save_tensors(path, {**views, "learned": whole.clone().requires_grad_()}, {})
    tensors, _ = load_tensors(path)
    assert all(torch.equal(tensors[name], value) for name, value in views.items())
    assert not tensors["learned"].requires_grad


def test_folders_are_made_and_nothing_is_left_behind(tmp_path):
    path = tmp_path / "a" / "b" / "some.safetensors"
    save_tensors(path, TENSORS, ABOUT)
    save_tensors(str(path), {"new": torch.ones(1)}, {})
    assert load_tensors(str(path))[0]["new"] == 1
    assert [p.name for p in path.parent.iterdir()] == [path.name]


@pytest.mark.skipif(os.name == "nt", reason="permissions of Unix")
def test_a_file_has_the_permissions_of_any_new_file(path, tmp_path):
    save_tensors(path, TENSORS, ABOUT)
    (other := tmp_path / "other").touch()
    assert path.stat().st_mode == other.stat().st_mode


def test_what_cannot_be_written_keeps_the_old_file(path):
    save_tensors(path, TENSORS, ABOUT)
    before = path.read_bytes()
    with pytest.raises(TypeError):
        save_tensors(path, TENSORS, {"not": object()})
    assert path.read_bytes() == before


def test_every_flipped_byte_is_found_or_does_no_harm(path):
    """Each byte of the file, one after another."""
    tensors = {"w": torch.arange(6.0).reshape(2, 3), "n": torch.tensor(3)}
    save_tensors(path, tensors, ABOUT)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    harmless = 0
    for place in range(len(whole)):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            read, about = load_tensors(path)
        except ValueError as error:
            assert str(path) in str(error)  # noqa: PT017
        else:
            harmless += 1
            assert about == ABOUT
            assert read.keys() == tensors.keys()
            assert all(torch.equal(read[name], tensors[name]) for name in tensors)
    assert harmless < 10  # padding


def test_every_truncation_is_found(path):
    save_tensors(path, {"w": torch.arange(6.0)}, ABOUT)
    whole = path.read_bytes()
    for length in range(len(whole)):
        path.write_bytes(whole[:length])
        with pytest.raises(ValueError, match="damaged"):
            load_tensors(path)
    path.write_bytes(whole + b"\0")
    with pytest.raises(ValueError, match="damaged"):
        load_tensors(path)


def test_files_of_others_are_refused(path):
    save_file({"w": torch.zeros(2)}, path)
    with pytest.raises(ValueError, match="was not written by cotlearn"):
        load_tensors(path)
    for record in ("{", "[]", "3", "null", '{"about": {}}', '{"sha256": "0", "about": 3}'):
        save_file({"w": torch.zeros(2)}, path, metadata={"cotlearn": record})
        with pytest.raises(ValueError, match="damaged"):
            load_tensors(path)
    path.write_text(json.dumps({"w": [0, 0]}))
    with pytest.raises(ValueError, match="damaged"):
        load_tensors(path)


def test_no_such_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"no such file: .*nowhere"):
        load_tensors(tmp_path / "nowhere")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_tensors(tmp_path)
