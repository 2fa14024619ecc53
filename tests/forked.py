"""Loaded once by the server from which the fixture `warm` forks commands."""

import os
import threading

os.environ |= {"OMP_NUM_THREADS": "1", "MPLBACKEND": "agg", "COTLEARN_PROGRESS": "0"}

import torch
from tqdm import tqdm

torch.set_num_threads(1)
tqdm.set_lock(threading.RLock())  # its own is between processes, and outlives one that is killed
