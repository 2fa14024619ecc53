"""Demonstrations: record, read, check, split and convert them.

``read(path)`` reads this course's `.npz`, Diffusion Policy's zarr, and LeRobot's parquet layout of
the tasks that have one.
"""

from cotlearn.robots.episodes.checked import Episodes, split
from cotlearn.robots.episodes.lerobot import read_lerobot, write_lerobot
from cotlearn.robots.episodes.store import read

__all__ = ["Episodes", "read", "read_lerobot", "split", "write_lerobot"]
