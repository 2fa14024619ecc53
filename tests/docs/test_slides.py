"""Slides are plain nbconvert's, with the texts of figures, and without checks and solutions."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("slides")
    command = [sys.executable, "-m", "nbconvert", "--to", "slides", "--config", "docs/slides.py"]
    command += ["--output-dir", str(folder), "notebooks/00_start_here.ipynb"]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True)
    return (folder / "00_start_here.slides.html").read_text("utf-8")


@pytest.mark.slow
def test_headings_start_slides_and_figures_have_their_texts(page):
    assert page.count("<section") > 8
    assert 'alt="Scatter plot: dark noise' in page
    assert "No description has been provided" not in page


@pytest.mark.slow
def test_checks_and_folded_cells_are_left_out(page):
    text = re.sub(r"<[^>]+>", "", page)
    assert "Predict" in text
    assert "check(" not in text
    assert "from cotlearn import" not in text
