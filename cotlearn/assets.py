"""Finds the notebooks and data of the course by name, in a checkout or an installed wheel."""

from __future__ import annotations

import difflib
import re
import shutil
from pathlib import Path

_PACKAGE = Path(__file__).resolve().parent
_NUMBERED = re.compile(r"\d\d_.*\.ipynb")


def checkout() -> Path | None:
    """Returns the root of the checkout that this package is imported from; None for a wheel."""
    root = _PACKAGE.parent
    if (root / "pyproject.toml").is_file() and (root / "course.py").is_file():
        return root
    return None


def course_folder() -> Path:
    """Returns the folder that holds `notebooks/` and `data/`."""
    return checkout() or _PACKAGE / "_course"


def notebooks() -> list[Path]:
    """Returns the numbered notebooks of the course, in the order of reading."""
    folder = course_folder() / "notebooks"
    return sorted(path for path in folder.glob("*.ipynb") if _NUMBERED.fullmatch(path.name))


def find_notebook(name: str) -> Path:
    """Finds a notebook by number, name or path.

    Args:
        name: A number ("00"), a name ("00_start_here", with or without ".ipynb"), or the path of
            any notebook.

    Returns:
        The path of an existing notebook.

    Raises:
        ValueError: If there is none; the message lists near matches and those there are.
    """
    path = Path(name).expanduser()
    if path.suffix == ".ipynb" and path.is_file():
        return path
    available = {item.stem: item for item in notebooks()}
    stem = path.name.removesuffix(".ipynb")
    in_course = str(path.parent) in {".", "notebooks"}
    if in_course and stem in available:
        return available[stem]
    numbered = [item for key, item in available.items() if key.split("_")[0] == stem.zfill(2)]
    if in_course and stem.isdigit() and len(numbered) == 1:
        return numbered[0]
    raise ValueError(_not_found("notebook", name, list(available), wanted=stem))


def find_data(name: str) -> Path:
    """Finds a file of the course's `data/` folder.

    Args:
        name: The path relative to `data/`, with forward slashes.

    Returns:
        The path of an existing file.

    Raises:
        ValueError: If there is no such file or `name` leads out of the folder.
    """
    folder = (course_folder() / "data").resolve()
    path = (folder / name).resolve()
    if path.is_file() and path.is_relative_to(folder):
        return path
    files = [item.relative_to(folder).as_posix() for item in folder.rglob("*") if item.is_file()]
    raise ValueError(_not_found("data file", name, sorted(files), wanted=name))


def copy_notebooks(folder: Path) -> tuple[list[Path], list[Path]]:
    """Copies the notebooks into `folder`, and never over a file that is already there.

    Args:
        folder: Where to; made if it does not exist.

    Returns:
        The notebooks that were copied, and those that were kept as they are.

    Raises:
        ValueError: If `folder` is a file.
    """
    if folder.exists() and not folder.is_dir():
        raise ValueError(f"folder must be a directory, got the file {folder}")
    folder.mkdir(parents=True, exist_ok=True)
    copied, kept = [], []
    for source in notebooks():
        target = folder / source.name
        if target.exists():
            kept.append(target)
        else:
            shutil.copyfile(source, target)
            copied.append(target)
    return copied, kept


def _not_found(kind: str, name: str, available: list[str], *, wanted: str) -> str:
    lines = [f"there is no {kind} {name!r}"]
    near = difflib.get_close_matches(wanted, available, n=3, cutoff=0.5)
    if near:
        lines.append(f"did you mean: {', '.join(near)}?")
    lines.append(f"available: {', '.join(available)}" if available else "none are installed")
    return "; ".join(lines)
