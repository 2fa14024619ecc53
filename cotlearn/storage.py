"""Tensors on disk: safetensors files, written atomically, with a digest that detects damage."""

import hashlib
import json
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import Tensor

from cotlearn.files import atomic_path, reading

_KEY = "cotlearn"


def save_tensors(path: str | Path, tensors: dict[str, Tensor], about: dict[str, Any]) -> None:
    """Write named tensors and a JSON-compatible description `about` atomically."""
    # Clones, because safetensors refuses tensors that share memory, as tied weights do.
    tensors = {name: value.detach().cpu().clone().contiguous() for name, value in tensors.items()}
    about = json.loads(json.dumps(about))  # as it will be read back: {1: 0.5} becomes {"1": 0.5}
    record = json.dumps({"about": about, "sha256": digest(tensors, about)})
    with atomic_path(path) as temporary:
        try:
            save_file(tensors, temporary, metadata={_KEY: record})
        except SafetensorError as error:  # of the operating system: a full disk, say
            raise OSError(f"{path} cannot be written: {error}") from error


def load_tensors(path: str | Path) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Read the tensors and the description that `save_tensors` wrote.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: the file is damaged, or was not written by `save_tensors`.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no such file: {path}")
    with reading(path, "was not written by cotlearn"):
        with safe_open(path, framework="pt") as file:
            record = json.loads((file.metadata() or {})[_KEY])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        about: dict[str, Any] = record["about"]
        whole = record["sha256"] == digest(tensors, about)
    if not whole:
        raise ValueError(f"{path} is damaged: its contents do not match their SHA-256")
    return tensors, about


def digest(tensors: dict[str, Tensor], about: dict[str, Any]) -> str:
    """The SHA-256 of tensors and a JSON-compatible description, in hexadecimal digits."""
    found = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name in sorted(tensors):
        value = tensors[name].detach().cpu().contiguous()
        found.update(f"{name} {value.dtype} {tuple(value.shape)}".encode())
        found.update(value.reshape(-1).view(torch.uint8).numpy().tobytes())
    return found.hexdigest()
