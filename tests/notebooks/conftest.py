from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parent.parent.parent
NOTEBOOKS = sorted(ROOT.glob("notebooks/[0-9][0-9]_*.ipynb"))
NOTEBOOKS += sorted(ROOT.glob("notebooks/laboratory/*.ipynb"))
NOTEBOOKS += sorted(ROOT.glob("notebooks/extras/*.ipynb"))


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: f"{path.parent.name}-{path.stem}")
def path(request):
    return request.param


@pytest.fixture
def room(path):
    """The folder: "notebooks" for the path, "laboratory" or "extras" for what stands beside it."""
    return path.parent.name


@pytest.fixture
def extra(room):
    """Whether it is one of the short notebooks around the subject."""
    return room == "extras"


@pytest.fixture
def cells(path):
    return nbformat.read(path, as_version=4).cells
