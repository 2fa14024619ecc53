"""The site builds without a warning, and its pages hold what they promise."""

import json
import re
import sys
from html import unescape
from pathlib import Path

import pytest

pytest.importorskip("sphinx")

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
sys.path[:0] = [str(DOCS), str(DOCS / "extensions")]

import make  # noqa: E402
from alternative_text import with_alt  # noqa: E402
from docstrings import prepare  # noqa: E402

pytestmark = [pytest.mark.slow, pytest.mark.filterwarnings("ignore")]  # Sphinx's own are many
NOTEBOOKS = sorted((ROOT / "notebooks").glob("[0-9][0-9]_*.ipynb"))
ROOMS = ("laboratory", "extras")
BESIDE = [path for room in ROOMS for path in sorted((ROOT / "notebooks" / room).glob("*.ipynb"))]


def cells(path):
    return json.loads(path.read_text("utf-8"))["cells"]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The site, built once for this file; `make docs` does the same."""
    folder = tmp_path_factory.mktemp("docs") / "site"
    assert make.build(folder) == 0, "Sphinx warns; run `make docs` to see of what"
    return folder


def page(site, name):
    return (site / f"{name}.html").read_text("utf-8")


def images(html):
    """Returns the text and the address of every picture."""
    tags = [m[0] for m in re.finditer(r"<img\b[^>]*>", html)]
    return [unescape(re.search(r'alt="([^"]*)"', tag)[1]) for tag in tags]


def test_links_pictures_and_what_is_loaded(site):
    assert make.problems(site) == []


def test_no_word_is_misspelled(tmp_path):
    assert make.misspelled(tmp_path) == []


@pytest.mark.parametrize("path", [*NOTEBOOKS, *BESIDE], ids=lambda path: path.stem)
def test_a_chapter_shows_its_figures_with_their_texts(site, path):
    html = page(site, path.relative_to(ROOT).with_suffix("").as_posix())
    expected = []
    for cell in cells(path):
        if cell["cell_type"] == "markdown":
            expected += re.findall(r"!\[([^\]]+)\]\(", "".join(cell["source"]))
        for output in cell.get("outputs", []):
            if any(kind.startswith("image/") for kind in output.get("data", {})):
                expected.append(cell["metadata"]["alt"])
    assert images(html) == expected
    assert 'class="cell_output' in html, "the stored outputs are not shown"


def test_rows_of_panels_are_marked_as_wide(site):
    tags = re.findall(r"<img[^>]*>", page(site, "notebooks/01_flow_matching_in_2d"))
    [panels] = [tag for tag in tags if "Four panels" in tag]
    [chart] = [tag for tag in tags if "Two curves" in tag]
    assert 'class="wide' in panels
    assert "wide" not in chart


def test_every_notebook_is_a_chapter_in_order(site):
    pattern = r'href="\.\./notebooks/((?:\w+/)?\d\d_\w+)\.html"'
    found = list(dict.fromkeys(re.findall(pattern, page(site, "docs/index"))))
    assert [name for name in found if "/" not in name] == [path.stem for path in NOTEBOOKS]
    beside = [f"{path.parent.name}/{path.stem}" for path in BESIDE]
    assert [name for name in found if "/" in name] == beside


def test_the_first_page_leads_to_the_site(site):
    assert "docs/index.html" in page(site, "index")


def test_terms_are_linked_to_the_glossary_once_a_page(site):
    html = page(site, "notebooks/03_conditions_break_it")
    targets = re.findall(r'href="[^"]*/reference/glossary\.html#(term-[\w-]+)"', html)
    assert len(targets) >= 5
    assert len(targets) == len(set(targets))


def test_names_of_the_library_are_linked(site):
    html = page(site, "notebooks/03_conditions_break_it")
    assert "api/diagnostics.html#cotlearn.diagnostics.prior_skew" in html


@pytest.mark.parametrize(
    "name", ["couplings.ConditionalOT", "flows.fit", "metrics.squared_w2", "potentials.ICNN"]
)
def test_the_reference_has_it(site, name):
    folder = name.split(".")[0]
    assert f'id="cotlearn.{name}"' in page(site, f"docs/reference/api/{folder}")


def test_every_reference_of_the_bibliography_is_cited(site):
    keys = re.findall(r"^@\w+\{(\w+),", (DOCS / "reference/references.bib").read_text(), re.M)
    text = (DOCS / "reference/bibliography.md").read_text("utf-8")
    assert [key for key in keys if f"`{key}`" not in text] == []
    assert page(site, "docs/reference/bibliography").count("arXiv:") >= len(keys)


def test_a_broken_page_is_found(tmp_path):
    (tmp_path / "a.html").write_text(
        '<a href="b.html">gone</a> <a href="#nowhere">gone</a> <a href="c.html#x">gone</a>'
        '<img src="p.png"><script src="https://example.org/s.js"></script>'
        '<a href="c.html#here">there</a> <a href="https://example.org">not looked at</a>'
    )
    (tmp_path / "c.html").write_text('<p id="here">')
    assert make.problems(tmp_path) == [
        "a.html: a picture without a text (alt)",
        "a.html: loads https://example.org/s.js from elsewhere",
        "a.html: links to b.html, which does not exist",
        "a.html: links to #nowhere, which is a page without that place",
        "a.html: links to c.html#x, which is a page without that place",
    ]


def test_a_misspelled_word_is_found(tmp_path, monkeypatch):
    text = tmp_path / "text.md"
    text.write_text("A sentense about couplings.")
    monkeypatch.setattr(make, "prose", lambda folder: [text])
    [line] = make.misspelled(tmp_path)
    assert "sentense" in line
    assert ":1:" in line


def test_with_alt_replaces_what_was_there():
    html = with_alt('<p><img src="a.gif" alt="animation"/></p><img src="b.gif">', 'a "moving" T')
    assert html.count("alt=") == 2
    assert images(html) == ['a "moving" T'] * 2
    assert "animation" not in html


def test_docstrings_keep_formulas_code_and_lists():
    assert prepare(["Cost |x0 - x1|^2 and `a|b`:", "- one", "  of two", "- two", "End of x_."]) == [
        r"Cost \|x0 - x1\|^2 and `a|b`:",
        "",
        "- one",
        "  of two",
        "- two",
        "",
        r"End of x\_.",
    ]
    assert prepare(["As in::", "", "    a | b", "", "a | b"])[-3:] == ["    a | b", "", r"a \| b"]
