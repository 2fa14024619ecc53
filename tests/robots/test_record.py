import gc
import hashlib
import json
import re
import signal
import warnings

import numpy as np
import pytest
from typer.testing import CliRunner

from cotlearn import cli
from cotlearn.course import assets
from cotlearn.robots.episodes import read
from cotlearn.robots.episodes import record as recording
from cotlearn.robots.episodes.npz import read_arrays, write_arrays
from cotlearn.robots.push_t import Simulation, random_state
from cotlearn.robots.push_t.constants import SUCCESS
from cotlearn.robots.push_t.definition import PUSH_T
from cotlearn.robots.registry import TASKS
from cotlearn.robots.task import Demonstration

SHIPPED = PUSH_T.demonstrations


class Quick:
    """Episodes that cost nothing; every seventh seed fails."""

    calls = 0

    def episode(self, seed):
        type(self).calls += 1
        generator = np.random.default_rng(seed)
        steps = int(generator.integers(3, 9))
        intention = np.rint(generator.uniform(0, 512, (steps, 2)) * 32) / 32
        state = generator.uniform(0, 400, (steps, 5))
        state[:, 4] -= 200
        return Demonstration(state, intention, intention, success=seed % 7 != 0)


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(Quick, "calls", 0)
    monkeypatch.setitem(vars(PUSH_T), "expert", Quick)
    monkeypatch.setattr(recording, "PART", 4)
    return Quick


def interrupt(self, seed):
    raise KeyboardInterrupt


def make(path, **changes):
    return recording.record(path, **{"episodes": 10, "seed": 1, **changes})


def test_what_is_recorded_is_read_back(quick, tmp_path):
    about = make(tmp_path / "a.npz")
    found = read(tmp_path / "a.npz")
    assert read_arrays(tmp_path / "a.npz")[1] == about
    assert len(found) == len(found.seed) == about["episodes"] == 10
    assert about["replaced"] == quick.calls - 10 > 0
    begin = 0
    for seed, end in zip(found.seed, found.ends, strict=True):
        episode = Quick().episode(int(seed))
        assert episode.success
        rows = slice(begin, end)
        assert np.array_equal(found.action[rows], episode.action)
        assert np.abs(found.state[rows, :4] - episode.state[:, :4]).max() <= 1 / 64
        turn = np.abs(np.exp(1j * found.state[rows, 4]) - np.exp(1j * episode.state[:, 4])).max()
        assert turn < 5e-5
        begin = end
    assert not list(tmp_path.glob("*.parts"))


@pytest.mark.parametrize("when", [0, 1, 5, 9, 10])
def test_an_interrupted_recording_ends_in_the_same_bytes(quick, tmp_path, monkeypatch, when):
    make(tmp_path / "whole.npz")
    total = quick.calls
    calls = iter(range(100))
    original = Quick.episode

    def interrupted(self, seed):
        if next(calls) == when:
            raise KeyboardInterrupt
        return original(self, seed)

    with monkeypatch.context() as patch:
        patch.setattr(Quick, "episode", interrupted)
        with pytest.raises(KeyboardInterrupt):
            make(tmp_path / "broken.npz")
    assert not (tmp_path / "broken.npz").exists()
    quick.calls = 0
    make(tmp_path / "broken.npz")
    assert quick.calls <= total - when + 4 + 2  # a part, and replacements, are made again
    assert (tmp_path / "broken.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()


def test_a_ctrl_c_that_a_destructor_swallows_still_stops(quick, tmp_path, monkeypatch):
    """As pymunk's do; before, the recording ran on."""
    original = Quick.episode

    class Swallowing:
        def __del__(self):
            signal.raise_signal(signal.SIGINT)

    def interrupted(self, seed):
        if Quick.calls == 2:
            Swallowing()
        return original(self, seed)

    monkeypatch.setattr(Quick, "episode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        make(tmp_path / "made.npz")
    assert quick.calls <= 4  # the episode is finished, with its second try
    assert not (tmp_path / "made.npz").exists()


def test_a_damaged_part_is_made_anew_and_another_recording_refused(quick, tmp_path, monkeypatch):
    make(tmp_path / "whole.npz")
    with monkeypatch.context() as patch:
        patch.setattr(Quick, "episode", interrupt)
        with pytest.raises(KeyboardInterrupt):
            make(tmp_path / "a.npz")
    part = tmp_path / "a.npz.parts" / "000000-000004.npz"
    part.write_bytes(b"PK\x03\x04 torn")
    make(tmp_path / "a.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "whole.npz").read_bytes()

    (tmp_path / "b.npz.parts").mkdir()
    arrays, about = read_arrays(tmp_path / "whole.npz")
    write_arrays(tmp_path / "b.npz.parts" / part.name, arrays, about)
    with pytest.raises(ValueError, match="holds parts of another recording"):
        make(tmp_path / "b.npz")


def test_a_finished_recording_is_kept(quick, tmp_path):
    about = make(tmp_path / "a.npz")
    quick.calls = 0
    assert make(tmp_path / "a.npz") == about
    assert quick.calls == 0
    for change in ({"seed": 2}, {"episodes": 11}):
        with pytest.raises(ValueError, match="holds another recording: choose another file"):
            make(tmp_path / "a.npz", **change)
    with pytest.raises(ValueError, match="episodes must be at least 1, got 0"):
        make(tmp_path / "c.npz", episodes=0)
    with pytest.raises(TypeError, match="seed must be an integer"):
        make(tmp_path / "c.npz", seed=1.5)


def test_a_unit_that_is_too_small_for_16_bits_is_refused(quick, tmp_path, monkeypatch):
    monkeypatch.setitem(vars(PUSH_T), "state_units", (1 / 1024,) * 4 + PUSH_T.state_units[4:])
    with pytest.raises(ValueError, match=r"agent x reaches \d{6} units of 0.000976562, but a file"):
        make(tmp_path / "a.npz")


def test_the_command(quick, tmp_path, monkeypatch):
    def check(episodes, code, words):
        given = ["--out", str(tmp_path / "a.npz"), "--seed", "1", "--episodes", episodes]
        result = CliRunner().invoke(cli.app, ["demos", "push-t", *given])
        assert (result.exit_code, words in result.output) == (code, True), result.output

    with monkeypatch.context() as patch:
        patch.setattr(Quick, "episode", interrupt)
        check("5", 130, "run the same command again to go on")
    check("5", 0, "5 episodes")
    check("6", 2, "holds another recording")


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b""), "damaged or no file of"),
        (lambda path: path.write_bytes(path.read_bytes()[:-200]), "damaged or no file of"),
        (lambda path: path.write_bytes(b"col1,col2\n1,2\n"), "damaged or no file of"),
        (lambda path: change(path, state=None), "do not match their SHA"),
        (lambda path: change(path, action=lambda a: a + np.int16(1)), "do not match their SHA"),
        (lambda path: change(path, about=lambda a: np.array("[]")), "damaged"),
        (lambda path: change(path, state=lambda a: a.astype(object)), "damaged or no file of"),
    ],
)
def test_damaged_files_and_others(quick, tmp_path, damage, message):
    path = tmp_path / "a.npz"
    make(path)
    damage(path)
    with pytest.raises((ValueError, FileNotFoundError), match=message) as caught:
        read(path)
    assert str(path) in str(caught.value)


def test_a_truncated_file_is_closed_again(quick, tmp_path):
    path = tmp_path / "a.npz"
    make(path)
    path.write_bytes(path.read_bytes()[:-200])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ResourceWarning)
        with pytest.raises(ValueError, match="damaged"):
            read(path)
        gc.collect()
    assert not [str(warning.message) for warning in caught]


def change(path, **changes):
    with np.load(path) as file:
        arrays = dict(file)
    changed = {name: how(arrays[name]) for name, how in changes.items() if how}
    kept = {name: value for name, value in arrays.items() if name not in changes}
    np.savez(path, **kept, **changed)


# --- what the course ships --------------------------------------------------------------------


@pytest.mark.parametrize("name", [t.demonstrations for t in TASKS.values() if t.demonstrations])
def test_a_shipped_file_is_the_one_that_data_describes(name):
    path = assets.find_data(name)
    assert path.stat().st_size <= 8e6
    text = assets.find_data("README.md").read_text(encoding="utf-8")
    digest = re.search(r"`([0-9a-f]{64})`", text.split(f"## `{name}`")[1])[1]
    assert hashlib.sha256(path.read_bytes()).hexdigest() == digest
    arrays, about = read_arrays(path)
    assert json.dumps(about["versions"])
    assert len(set(arrays["seed"].tolist())) == len(arrays["seed"]) == about["episodes"] >= 4000


def test_shipped_episodes_can_be_replayed():
    """To the rounding of the file; on another machine sines may differ in the last digit."""
    found = read(assets.find_data(SHIPPED))
    for episode in (0, 1234, 3999):
        world = Simulation(random_state(np.random.default_rng(int(found.seed[episode]))))
        for row in range(found.starts[episode], found.ends[episode]):
            assert np.abs(np.array(world.state[:4]) - found.state[row, :4]).max() < 1 / 64 + 1e-3
            world.step(*found.action[row].tolist())
        assert world.coverage > SUCCESS
