"""Files written atomically: whoever reads one sees the old or the new file, whole."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path


@contextlib.contextmanager
def atomic_path(path: str | Path) -> Iterator[Path]:
    """A temporary path beside `path` that replaces it when the block ends without an error.

    A process that is killed leaves the old file as it was. Missing folders are made; the new file
    has the permissions of the old one, or of any new file.
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
    finally:
        temporary.unlink(missing_ok=True)


def write_text(path: str | Path, text: str, *, encoding: str = "utf-8") -> None:
    """Writes `text` atomically, with the same line ends on every system."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding=encoding, newline="")
