"""Items prepared in the background: the same, in order, errors in place, and the thread ends."""

import itertools
import os
import threading
import time

import pytest
import torch

from cotlearn.flows import prefetch as module
from cotlearn.flows.prefetch import has_spare_core, prefetch

THREAD = "cotlearn-pairs"


def threads():
    return [t for t in threading.enumerate() if t.name.startswith(THREAD)]


@pytest.fixture(autouse=True)
def _no_thread_is_left():
    before = len(threads())
    yield
    wait_until(lambda: len(threads()) == before)


def wait_until(holds):
    deadline = time.monotonic() + 5
    while not holds() and time.monotonic() < deadline:
        time.sleep(0.005)
    assert holds()


@pytest.mark.parametrize("ahead", [1, 2, 4, 100])
@pytest.mark.parametrize("n", [0, 1, 3, 57])
def test_the_same_items_in_the_same_order(monkeypatch, n, ahead):
    monkeypatch.setattr(module, "AHEAD", ahead)
    items = [object() for _ in range(n)]
    assert list(prefetch(iter(items))) == items


def test_none_and_exceptions_are_items_like_others():
    items = [None, StopIteration(), ValueError("only an item"), None]
    assert list(prefetch(iter(items))) == items


@pytest.mark.parametrize("error", [KeyError, KeyboardInterrupt])
def test_an_error_is_raised_where_its_item_would_have_been(error):
    def failing():
        yield 1
        yield 2
        raise error("third")

    items = prefetch(failing())
    assert [next(items), next(items)] == [1, 2]
    with pytest.raises(error, match="third"):
        next(items)
    with pytest.raises(StopIteration):
        next(items)


def test_it_runs_ahead_and_no_further():
    made = []

    def count():
        for i in itertools.count():
            made.append(i)
            yield i

    items = prefetch(count())
    assert made == []  # nothing before the first is asked for
    assert next(items) == 0
    most = module.AHEAD + 1  # with the one in use
    wait_until(lambda: len(made) == most)
    time.sleep(0.15)
    assert len(made) == most
    items.close()


def test_closing_stops_the_thread_of_an_endless_iterator():
    items = prefetch(itertools.count())
    next(items)
    assert len(threads()) >= 1
    items.close()
    assert threads() == []


def test_closing_before_the_first_item_starts_nothing():
    prefetch(itertools.count()).close()
    assert threads() == []


def test_a_finished_iterator_leaves_no_thread():
    assert list(prefetch(iter(range(3)))) == [0, 1, 2]
    assert threads() == []


def test_an_error_of_the_reader_stops_the_thread():
    with pytest.raises(RuntimeError, match="reader"):  # noqa: PT012
        for item in prefetch(itertools.count()):
            if item == 3:
                raise RuntimeError("reader")


def test_items_are_made_while_others_are_used():
    """Ten times 30 ms of making beside 30 ms of using take 0.33 s, one after the other 0.6 s."""

    def slow():
        for i in range(10):
            time.sleep(0.03)
            yield i

    started = time.monotonic()
    for _ in prefetch(slow()):
        time.sleep(0.03)
    assert time.monotonic() - started < 0.5


def test_a_core_is_spare_only_where_torch_leaves_one(monkeypatch):
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1}, raising=False)
    for threads, spare in ((1, True), (2, False), (3, False)):
        monkeypatch.setattr(torch, "get_num_threads", lambda threads=threads: threads)
        assert has_spare_core() is spare
