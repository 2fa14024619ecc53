"""Imported once by the server from which the processes of questions start: all that takes time."""

from __future__ import annotations

import os
import threading

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ["MPLBACKEND"] = "agg"
os.environ["COTLEARN_PROGRESS"] = "0"

import matplotlib.pyplot  # noqa: E402, F401
import numpy  # noqa: E402
import torch  # noqa: E402
from tqdm import tqdm  # noqa: E402

import cotlearn.diagnostics  # noqa: E402
import cotlearn.homework.registry  # noqa: E402
import cotlearn.metrics  # noqa: E402, F401

assert numpy
torch.set_num_threads(1)
tqdm.set_lock(threading.RLock())  # its own is between processes, and outlives one that is killed
