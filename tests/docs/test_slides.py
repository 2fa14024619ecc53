"""Slides have the texts of figures, and are without checks and solutions."""

import re

import pytest


@pytest.fixture(scope="module")
def page(slides):
    return (slides / "00_start_here.slides.html").read_text("utf-8")


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
