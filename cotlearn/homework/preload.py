"""Slow imports, done once by the server process from which the answers' processes are forked."""

import os
import threading

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(name, "1")
os.environ["MPLBACKEND"] = "agg"
os.environ["COTLEARN_PROGRESS"] = "0"

import IPython.core.interactiveshell  # noqa: E402, F401
import ot  # noqa: E402, F401
import sklearn.cluster  # noqa: E402, F401
import torch  # noqa: E402
from tqdm import tqdm  # noqa: E402

from cotlearn import diagnostics, plots  # noqa: E402, F401
from cotlearn.homework import exercises  # noqa: E402
from cotlearn.metrics import squared_w2  # noqa: E402

torch.set_num_threads(1)
tqdm.set_lock(threading.RLock())  # its own is between processes, and outlives one that is killed
squared_w2(torch.zeros(2, 2), torch.ones(2, 2))  # compiles what is not in numba's cache
exercises()
