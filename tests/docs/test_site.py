"""The site builds without a warning, and its pages hold what they promise."""

import json
import re
import subprocess
import sys
from html import unescape
from pathlib import Path
from urllib.parse import unquote, urlparse

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "extensions"))

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
    """The site, built once for this file; a warning, such as a link to nowhere, is an error."""
    folder = tmp_path_factory.mktemp("docs") / "site"
    command = [sys.executable, "-m", "sphinx", "-nqW", "--keep-going", "-c", "docs"]
    command += ["-d", str(folder.parent / "doctrees"), ".", str(folder)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return folder


def page(site, name):
    return (site / f"{name}.html").read_text("utf-8")


def images(html):
    """Returns the text and the address of every picture."""
    tags = [m[0] for m in re.finditer(r"<img\b[^>]*>", html)]
    return [unescape(re.search(r'alt="([^"]*)"', tag)[1]) for tag in tags]


def test_every_picture_has_a_text_and_nothing_is_loaded_from_elsewhere(site):
    for path in site.rglob("*.html"):
        html = path.read_text("utf-8")
        assert all(images(html)), path
        assert not re.search(r"<(?:script|img|iframe)[^>]* src=.https?:", html), path


#: What of a page ends right of its article, and in no box that scrolls; and how far a page does.
OUTSIDE = """() => {
    const article = document.querySelector("article"), edge = article.getBoundingClientRect().right;
    const scrolls = e => e !== article &&
        (/auto|scroll/.test(getComputedStyle(e).overflowX) || scrolls(e.parentElement));
    const out = [...article.querySelectorAll("table, pre, img, math, svg, iframe")].filter(e =>
        e.getBoundingClientRect().right > edge + 1 && !scrolls(e.parentElement));
    const wide = document.documentElement.scrollWidth - document.documentElement.clientWidth;
    return out.map(e => e.outerHTML.slice(0, 80)).concat(wide > 1 ? [`${wide} px`] : []);
}"""


def test_nothing_sticks_out_of_a_page(site, browser):
    """On a phone, a small laptop and a desktop."""
    pages = [path for part in ("docs", "notebooks") for path in (site / part).rglob("*.html")]
    pages = [path for path in pages if path.parent.name != "modules"]  # of functions: all alike
    tab, found = browser.new_page(), {}
    for path in pages:
        tab.goto(path.as_uri(), wait_until="domcontentloaded")
        for width in (390, 1024, 1400):
            tab.set_viewport_size({"width": width, "height": 900})
            if outside := tab.evaluate(OUTSIDE):
                found[path.name, width] = outside
    tab.close()
    assert found == {}
    assert len(pages) > 50


#: True once a frame has shown all of its page for half a second; after 20 s what is high instead.
SETTLED = """html => new Promise(done => {
    const begun = performance.now();
    let since = begun;
    const look = () => {
        const now = performance.now(), high = [html.scrollHeight, html.clientHeight];
        if (high[0] > high[1] || high[1] < 300) since = now;
        if (now - since > 500) done(true);
        else if (now - begun > 20000) done(high);
        else setTimeout(look, 50);
    };
    look();
})"""


@pytest.mark.parametrize("width", [390, 1400])
def test_frames_are_as_high_as_what_they_show(site, browser, width):
    """On a phone both panels of the first page were cut off."""
    tab = browser.new_page(viewport={"width": width, "height": 900})
    tab.goto((site / "docs" / "index.html").as_uri())
    tab.locator("iframe.robots").scroll_into_view_if_needed()
    for name in ("pairs", "robots"):
        frame = tab.frame_locator(f"iframe[src$='embed={name}']")
        frame.locator(".panel canvas").first.wait_for()
        assert frame.locator("html").evaluate(SETTLED) is True
    tab.close()


@pytest.mark.parametrize("paper", ["A4", "Letter"])
def test_the_cheat_sheet_is_one_page(site, browser, paper):
    tab = browser.new_page()
    tab.goto((site / "docs" / "reference" / "cheat_sheet.html").as_uri())
    printed = tab.pdf(format=paper)
    tab.close()
    assert re.findall(rb"/Count (\d+)", printed) == [b"1"]


def searched(site, browser, words):
    """The titles that the search page lists first."""
    tab = browser.new_page()
    tab.goto((site / "search.html").as_uri() + f"?q={words}")
    tab.wait_for_selector("#search-results li")
    titles = tab.locator("#search-results li").all_inner_texts()
    tab.close()
    return titles


@pytest.mark.parametrize(
    ("words", "first"), [("skew", "linear skew"), ("prior+skew", "prior skew"), ("cot", "cot")]
)
def test_the_search_finds_what_a_word_means_first(site, browser, words, first):
    """It listed a module first, and the glossary not among the first dozen."""
    titles = searched(site, browser, words)
    assert first in [title.splitlines()[0].partition(" (")[0] for title in titles[:3]], titles[:5]
    assert "Glossary" in titles[0]


def test_a_block_of_code_can_be_copied(site, browser):
    tab = browser.new_page()
    tab.goto((site / "docs/how_to/use_another_training_loop.html").as_uri())
    buttons = tab.locator("div.highlight > button.copy")
    assert buttons.count() >= 4
    writes = "navigator.clipboard.writeText = text => Promise.resolve(said.push(text))"
    tab.evaluate(f"() => {{window.said = []; {writes}}}")
    buttons.first.click(force=True)
    tab.wait_for_function("() => document.querySelector('button.copy').textContent === 'copied'")
    [text] = tab.evaluate("() => window.said")
    assert text.startswith("import torch\n")
    assert not text.endswith("\n")
    assert "copy" not in text
    tab.goto((site / "notebooks/00_start_here.html").as_uri())
    assert tab.locator(".cell_output button.copy").count() == 0
    tab.close()


@pytest.mark.parametrize("name", ["docs/index", "notebooks/00_start_here"])
def test_the_rooms_of_the_map_are_links(site, browser, name):
    tab = browser.new_page()
    tab.goto((site / f"{name}.html").as_uri())
    links = tab.locator("span.map > a")
    assert links.count() == len(NOTEBOOKS) + len(ROOMS)
    addresses = links.evaluate_all("all => all.map(a => a.href)")
    assert all(Path(unquote(urlparse(address).path)).is_file() for address in addresses)
    box = tab.locator("span.map > img").bounding_box()
    for place in links.evaluate_all("all => all.map(a => a.getBoundingClientRect().toJSON())"):
        assert box["x"] <= place["x"] < place["x"] + place["width"] <= box["x"] + box["width"] + 1
    with tab.expect_navigation():
        tab.get_by_label("04 Conditional couplings").click()
    assert tab.url.endswith("04_conditional_couplings.html")
    tab.close()


def test_a_page_of_the_reference_begins_with_a_table_and_sets_its_formulas(site):
    html = page(site, "docs/reference/api/modules/cotlearn.couplings")
    table = html.split('<table class="autosummary', 1)[1].split("</table>")[0]
    for name in ("ConditionalOT", "StratifiedOT", "centred"):
        assert f'href="#cotlearn.couplings.{name}"' in table
    assert "|x<sub>0</sub> - x<sub>1</sub>|<sup>2</sup>" in html
    assert "|^2" not in html


def test_no_word_is_misspelled():
    command = [sys.executable, "-m", "codespell_lib"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout


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


def test_every_notebook_is_a_chapter_in_order(site):
    pattern = r'href="\.\./notebooks/((?:\w+/)?\d\d_\w+)\.html"'
    found = list(dict.fromkeys(re.findall(pattern, page(site, "docs/index"))))
    assert [name for name in found if "/" not in name] == [path.stem for path in NOTEBOOKS]
    beside = [f"{path.parent.name}/{path.stem}" for path in BESIDE]
    assert [name for name in found if "/" in name] == beside


def test_the_first_page_leads_to_the_site(site):
    assert "docs/index.html" in page(site, "index")


def test_the_playground_stands_where_the_first_page_frames_it(site):
    assert (site / "playground.html").stat().st_size < 3e6
    frames = re.findall(
        r'<iframe[^>]* src="\.\./playground\.html#embed=(\w+)"', page(site, "docs/index")
    )
    assert frames == ["pairs", "robots"]


def test_terms_are_linked_to_the_glossary_once_a_page(site):
    html = page(site, "notebooks/03_conditions_break_it")
    targets = re.findall(r'href="[^"]*/reference/glossary\.html#(term-[\w-]+)"', html)
    assert len(targets) >= 5
    assert len(targets) == len(set(targets))


def test_an_everyday_word_is_a_term_only_in_italics(site):
    html = page(site, "notebooks/12_your_data")
    assert len(re.findall(r"\btrial\b", html)) > 5
    found = re.findall(r"(.{4})<a [^>]*#term-(?:trial|teacher|floor|frame|plan)\"", html)
    assert set(found) <= {"<em>"}


def test_names_of_the_library_are_linked(site):
    html = page(site, "notebooks/03_conditions_break_it")
    assert "cotlearn.diagnostics.html#cotlearn.diagnostics.prior_skew" in html


@pytest.mark.parametrize(
    "name", ["couplings.ConditionalOT", "flows.fit", "metrics.squared_w2", "potentials.ICNN"]
)
def test_the_reference_has_it(site, name):
    module = f"cotlearn.{name.split('.')[0]}"
    assert f'id="cotlearn.{name}"' in page(site, f"docs/reference/api/modules/{module}")


def test_every_reference_of_the_bibliography_is_cited(site):
    keys = re.findall(r"^@\w+\{(\w+),", (DOCS / "reference/references.bib").read_text(), re.M)
    text = (DOCS / "reference/bibliography.md").read_text("utf-8")
    assert [key for key in keys if f"`{key}`" not in text] == []
    assert page(site, "docs/reference/bibliography").count("arXiv:") >= len(keys)


def test_with_alt_replaces_what_was_there():
    html = with_alt('<p><img src="a.gif" alt="animation"/></p><img src="b.gif">', 'a "moving" T')
    assert html.count("alt=") == 2
    assert images(html) == ['a "moving" T'] * 2
    assert "animation" not in html


def test_docstrings_keep_formulas_code_and_lists():
    assert prepare(["Cost |x0 - x1|^2 and `a|b`:", "- one", "  of two", "- two", "End of x_."]) == [
        r"Cost \|x\ :sub:`0`\  - x\ :sub:`1`\ \|\ :sup:`2`\  and `a|b`:",
        "",
        "- one",
        "  of two",
        "- two",
        "",
        r"End of x\_.",
    ]
    assert prepare(["As in::", "", "    a | b", "", "a | b"])[-3:] == ["    a | b", "", r"a \| b"]
