"""The learner's own notebooks: copies beside the course's, which are made once.

In a checkout they lie in `my-course/`, which git ignores. A copy stands as deep as its original, so
links to other notebooks and to `../docs` lead to the same places. Outputs are cleared: those that
are stored would give away each prediction.
"""

import itertools
import json
from pathlib import Path

from cotlearn.course import assets
from cotlearn.files import write_text

FOLDER = "my-course"  #: in the checkout


def folder() -> Path:
    """Returns the folder of the copies, which may not exist yet."""
    return assets.course_folder() / FOLDER


def originals() -> dict[str, Path]:
    """Returns the course's notebook for each copy, by the copy's name in the folder.

    Homework goes beside the notebooks of the path, side rooms into folders of their names.
    """
    homework = assets.course_folder() / "notebooks" / "homework"
    found = [*assets.notebooks(), *sorted((homework / "student").glob("*.ipynb"))]
    found += [path for path in [homework / "challenge.ipynb"] if path.exists()]
    aside = {
        f"{room}/{path.name}": path for room in assets.ROOMS for path in assets.notebooks(room)
    }
    return {path.name: path for path in found} | aside


def make(to: Path, *, outputs: bool = False) -> tuple[list[Path], list[Path]]:
    """Copies the notebooks that are not there yet; nothing is overwritten.

    Args:
        to: The destination; created if it does not exist.
        outputs: Whether the copies keep the stored outputs.

    Returns:
        The paths that were copied, and the existing paths that were kept.

    Raises:
        ValueError: If `to` is a file.
    """
    if to.exists() and not to.is_dir():
        raise ValueError(f"to must be a folder, got the file {to}")
    copied, kept = [], []
    for name, original in originals().items():
        if (to / name).exists():
            kept.append(to / name)
        else:
            write_text(to / name, _text(original, outputs))
            copied.append(to / name)
    return copied, kept


def renew(name: str, to: Path, *, outputs: bool = False) -> tuple[Path, Path | None]:
    """Starts a copy over; the one that was there gets a name of its own.

    Args:
        name: The notebook: "03", "03_conditions_break_it", "laboratory/03", "hw1".
        to: The folder of the copies.
        outputs: Whether the copy keeps the stored outputs.

    Returns:
        The new copy, and the path of the old one, such as `03_conditions_break_it.backup-1.ipynb`;
        None if there was none.

    Raises:
        ValueError: If there is no such notebook.
    """
    known = originals()
    found = _named(name, known)
    if found is None:
        names = [known_name.removesuffix(".ipynb") for known_name in known]
        raise ValueError(assets.not_found("notebook", name, names))
    text, copy, old = _text(known[found], outputs), to / found, None
    if copy.exists():
        places = (copy.with_suffix(f".backup-{number}.ipynb") for number in itertools.count(1))
        old = next(place for place in places if not place.exists())
        copy.rename(old)
    write_text(copy, text)
    return copy, old


def find(name: str) -> Path:
    """Returns the learner's copy of a notebook if there is one, or else the course's notebook.

    Args:
        name: As for `renew`, or the path of any notebook.

    Raises:
        ValueError: If there is no such notebook.
    """
    known = originals()
    found = _named(name, known)
    if found is not None and not Path(name).is_file():
        own = folder() / found
        return own if own.is_file() else known[found]
    try:
        return assets.find_notebook(name)
    except ValueError:
        names = [copy.removesuffix(".ipynb") for copy in known]
        raise ValueError(assets.not_found("notebook", name, names)) from None


def course_or_homework(name: str) -> Path:
    """Returns the course's notebook of this name, or homework as `find` does.

    Args:
        name: As for `find`.

    Raises:
        ValueError: If there is no such notebook.
    """
    try:
        return assets.find_notebook(name)
    except ValueError:
        return find(name)


def _named(name: str, known: dict[str, Path]) -> str | None:
    """The full name of a copy, from a short one."""
    room, _, last = Path(name).as_posix().removesuffix(".ipynb").rpartition("/")
    room = room.removeprefix(FOLDER).removeprefix("notebooks").strip("/")
    last = last.zfill(2) if last.isdigit() else last
    for copy in known:
        stem = copy.rpartition("/")[2].removesuffix(".ipynb")
        number = stem[:2] if stem[:2].isdigit() else ""
        if last in {stem, number} - {""} and room == copy.rpartition("/")[0]:
            return copy
    return None


def _text(original: Path, outputs: bool) -> str:
    text = original.read_text(encoding="utf-8")
    if outputs:
        return text
    notebook = json.loads(text)
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            cell.update(outputs=[], execution_count=None)
    return json.dumps(notebook, indent=1, ensure_ascii=False) + "\n"
