"""Demonstrations: read, check, split and convert them.

``read(path)`` reads this course's `.npz` and, for Push-T, Diffusion Policy's zarr and LeRobot's
parquet layout.
"""

from cotlearn.robots.episodes.checked import Episodes, split
from cotlearn.robots.episodes.lerobot import read_lerobot, write_lerobot
from cotlearn.robots.episodes.store import read, write_pictures

__all__ = ["Episodes", "read", "read_lerobot", "split", "write_lerobot", "write_pictures"]
