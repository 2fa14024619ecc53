"""Slides are made from the notebooks, with every figure and its text, and without solutions."""

import sys
from pathlib import Path

import nbformat
import pytest

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs"))

import slides  # noqa: E402

from cotlearn.assets import find_notebook  # noqa: E402

NOTEBOOK = ROOT / "notebooks" / "00_start_here.ipynb"


@pytest.fixture(scope="module")
def marked():
    return slides.as_slides(nbformat.read(NOTEBOOK, as_version=4))


def kinds(notebook):
    return [cell.metadata["slideshow"]["slide_type"] for cell in notebook.cells]


def test_headings_start_slides(marked):
    shown = [c for c, kind in zip(marked.cells, kinds(marked), strict=True) if kind == "slide"]
    first = [cell.source.splitlines()[0] for cell in shown]
    assert first[0].startswith("# 00")
    assert "## Predict" in first
    assert all(line.startswith(("# ", "## ")) for line in first)


def test_solutions_and_checks_are_left_out(marked):
    for cell, kind in zip(marked.cells, kinds(marked), strict=True):
        hidden = "<details>" in cell.source or "check" in cell.metadata.get("tags", [])
        assert (kind == "skip") == hidden


def test_figures_have_slides_of_their_own(marked):
    pictures = [k for c, k in zip(marked.cells, kinds(marked), strict=True) if "alt" in c.metadata]
    assert pictures
    assert set(pictures) == {"subslide"}


@pytest.mark.parametrize("name", ["03", "08"])
def test_slides_fit_the_screen(name):
    """By the estimate; only what cannot be divided may be higher."""
    notebook = nbformat.read(find_notebook(name), as_version=4)
    cells = slides.as_slides(notebook).cells
    heights = [[]]
    for cell in cells:
        kind = cell.metadata["slideshow"]["slide_type"]
        if kind != "-":
            heights.append([])
        heights[-1] += [slides.height_of(cell)] * (kind != "skip")
    assert all(len(slide) < 2 or sum(slide) <= slides.SCREEN for slide in heights)
    assert sum(len(slide) == 1 and slide[0] > 1.2 * slides.SCREEN for slide in heights) <= 1
    assert "from cotlearn import" not in "".join(c.source for c in cells), "that is folded"
    said, shown = (
        "".join(o.text for c in some for o in c.get("outputs", []) if "text" in o)
        for some in (notebook.cells, cells)
    )
    assert said == shown


def test_the_page_has_the_texts_of_the_figures(tmp_path, monkeypatch):
    monkeypatch.setattr(slides, "OUT", tmp_path)
    assert slides.main(["00"]) == 0
    page = (tmp_path / "00_start_here.slides.html").read_text("utf-8")
    assert slides.NO_ALT not in page
    assert 'alt="Scatter plot: dark noise' in page
