"""Waiting for other processes on a machine that may be very busy."""

import os
import time


def soon():
    """Three seconds, or as much longer as this machine is busy."""
    return 3 * max(1, os.getloadavg()[0] / (os.cpu_count() or 1))


def until(condition, *, patience=120, every=0.05):
    """Wait until something is so; `patience` is seconds."""
    deadline = time.monotonic() + patience
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(every)
