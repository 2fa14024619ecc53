"""How numbers and tables reach the browser: JSON, compressed, as letters."""

import base64
import gzip
import json
from typing import Any

import numpy as np
from numpy.typing import ArrayLike


def pack(value: Any) -> str:
    """JSON, gzip, base64; `unpack` in data.js reads it. The same value gives the same text."""
    plain = json.dumps(value, separators=(",", ":"), allow_nan=False).encode()
    return base64.b64encode(gzip.compress(plain, mtime=0)).decode("ascii")


def numbers(values: ArrayLike, kind: str = "<f4") -> str:
    """Numbers as base64: float32 ("<f4") or int16 ("<i2"); `numbers` in data.js reads it.

    Raises:
        ValueError: a value is out of the range of int16.
    """
    array = np.asarray(values)
    if kind == "<i2":
        array = np.round(array)
        if array.size and np.abs(array).max() > 32767:
            raise ValueError(f"values must lie within +-32767, got {np.abs(array).max():g}")
    return base64.b64encode(array.astype(kind).tobytes()).decode("ascii")
