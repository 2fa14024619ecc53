"""Prepare the next items of an iterator in the background, while the current one is used."""

from __future__ import annotations

import os
import queue
import threading
from collections.abc import Generator, Iterator
from typing import TypeVar

import torch

from cotlearn.validation import check_count

T = TypeVar("T")


def has_spare_core() -> bool:
    """Whether this process may use more cores than torch computes on.

    Where torch computes on all of them, a thread that prepares pairs takes a core away from every
    step, and all other cores wait for it: on two cores steps took half as long again, against a
    fifth when pairs were made between the steps.
    """
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return torch.get_num_threads() < (cores or 1)


def running_ahead(items: Iterator[T], *, ahead: int = 4) -> Generator[T, None, None]:
    """Yield the same items in the same order, computed by one thread up to `ahead` in advance.

    The assignment solvers release Python's global lock, so that a second core does them while the
    first one trains. An error of the iterator is raised where its item would have been. Closing
    the generator stops the thread.
    """
    check_count(ahead, "ahead")
    ready: queue.Queue[tuple[T | None, BaseException | None]] = queue.Queue(maxsize=ahead)
    closed = threading.Event()

    def put(item: T | None, error: BaseException | None) -> None:
        while not closed.is_set():
            try:
                return ready.put((item, error), timeout=0.1)
            except queue.Full:
                continue

    def work() -> None:
        try:
            for item in items:
                put(item, None)
                if closed.is_set():
                    return
            put(None, StopIteration())
        except BaseException as error:  # whatever it is, the one who waits must hear of it
            put(None, error)

    thread = threading.Thread(target=work, daemon=True, name="cotlearn-pairs")
    thread.start()
    try:
        while True:
            item, error = ready.get()
            if isinstance(error, StopIteration):
                return
            if error is not None:
                raise error
            yield item  # type: ignore[misc]
    finally:
        closed.set()
        thread.join()
