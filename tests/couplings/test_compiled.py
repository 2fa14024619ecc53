"""Compiled loops run where nothing can be written."""

import errno
import importlib.util
import warnings
from pathlib import Path

import numba
import numpy as np
import pytest
from numba.core.caching import CompileResultCacheImpl, IndexDataCacheFile

import cotlearn
from cotlearn.couplings import compiled as module
from cotlearn.couplings.compiled import at_rank, compiled


def test_without_a_folder_for_the_code_loops_are_compiled_anew(monkeypatch):
    monkeypatch.setattr(CompileResultCacheImpl, "_locator_classes", [])

    @compiled(fastmath=True)
    def doubled(x):
        return 2 * x

    assert doubled(3.0) == 6.0
    assert doubled.targetoptions["nogil"]
    assert doubled.targetoptions["fastmath"]


LOOPS = """from cotlearn.couplings.compiled import compiled
@compiled()
def doubled(x):
    return 2 * x
@compiled(inline="always")
def tripled(x):
    return 3 * x
@compiled()
def sixfold(x):
    return tripled(doubled(x))
"""


@pytest.fixture
def loops(tmp_path, monkeypatch):
    """Loads loops anew, as another process would; their code is kept in a folder."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "kept"))
    monkeypatch.setattr(module, "_warned", False, raising=False)
    (tmp_path / "loops.py").write_text(LOOPS)

    def load():
        spec = importlib.util.spec_from_file_location("loops", tmp_path / "loops.py")
        loaded = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(loaded)
        return loaded

    return load


def test_compiling_is_announced_once(loops, monkeypatch, capsys):
    monkeypatch.setenv("COTLEARN_PROGRESS", "1")
    monkeypatch.setattr(module, "_announced", False)
    first, again = loops(), loops()
    assert first.sixfold(1.0) == 6.0
    said = capsys.readouterr().err
    assert (said.count("compiling the pairing loops"), said.count("\n")) == (1, 1)
    monkeypatch.setattr(module, "_announced", False)
    assert again.sixfold(1.0) == 6.0  # found on disk
    assert capsys.readouterr().err == ""


def test_code_is_kept(loops):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert loops().sixfold(3.0) == 18.0
        again = loops()
        assert again.sixfold(3.0) == 18.0
    assert sum(again.sixfold.stats.cache_hits.values()) == 1


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EACCES, errno.EIO])
def test_a_full_disk_costs_only_time_and_one_warning(loops, monkeypatch, number):
    def full(self, path):
        raise OSError(number, "no", path)

    monkeypatch.setattr(IndexDataCacheFile, "_open_for_write", full)
    with pytest.warns(RuntimeWarning, match=r"not kept in .*kept") as said:
        assert loops().sixfold(3.0) == 18.0
    assert len(said) == 1


@pytest.mark.parametrize("kind", ["nbi", "nbc"])
def test_damaged_code_is_compiled_anew_and_kept_whole(loops, tmp_path, monkeypatch, kind):
    loops().sixfold(3.0)
    for file in (tmp_path / "kept").rglob(f"*sixfold*.{kind}"):
        file.write_bytes(file.read_bytes()[:20])
        damaged = file
    assert damaged
    loaded = loops()
    with pytest.warns(RuntimeWarning, match="not kept"):
        assert loaded.sixfold(3.0) == 18.0
    last = loops()
    assert last.sixfold(3.0) == 18.0
    assert sum(last.sixfold.stats.cache_hits.values()) == 1


def test_all_loops_are_compiled_that_way():
    sources = Path(cotlearn.__file__).parent.rglob("*.py")
    assert {path.name for path in sources if "njit" in path.read_text()} == {"compiled.py"}


@pytest.mark.parametrize("values", [np.zeros(7), np.arange(9.0) % 3, np.array([5.0])])
def test_a_rank_is_that_of_the_sorted_values(values):
    random = np.random.default_rng(0).normal(size=(3, 40))
    for some in (values, -values, *random, np.array([np.inf, 1.0, -np.inf])):
        ranked = [at_rank(some, place) for place in range(len(some))]
        assert ranked == sorted(some)


def test_a_change_of_this_file_compiles_anew(loops, monkeypatch):
    """Loops of other files call `at_rank`, which is part of their code."""
    loops().sixfold(3.0)
    monkeypatch.setattr(module, "__file__", __file__)
    changed = loops()
    assert changed.sixfold(3.0) == 18.0
    assert not changed.sixfold.stats.cache_hits
