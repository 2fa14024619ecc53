"""Atomic writes: a reader sees either the complete old file or the complete new one."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path that replaces `path` when the block ends without an error.

    A killed process leaves the old file unchanged. Missing folders are created. The new file gets
    the permissions of the old one, or the default ones.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.parent / f".{path.name[:40]}.{uuid.uuid4().hex}"
    temporary.touch(exist_ok=False)
    mode = (path if path.exists() else temporary).stat().st_mode
    try:
        yield temporary
        temporary.chmod(mode)  # safetensors lets only the owner read
        os.replace(temporary, path)
    except OSError as error:  # a full disk gives no name
        if error.errno and not error.filename:
            error.filename = str(path)
        raise
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str, *, encoding: str = "utf-8") -> None:
    """Writes `text` atomically, with the same line endings on every system."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding=encoding, newline="")
