"""Pages of `make course` and slides: without network, with the texts of figures, no solutions."""

import importlib.util
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest

from cotlearn.course import assets, execution, pages

pytestmark = pytest.mark.slow
ROOT = Path(__file__).resolve().parents[2]
LESSON = ROOT / "notebooks" / "03_conditions_break_it.ipynb"
FIRST = ROOT / "notebooks" / "00_start_here.ipynb"  # shows a picture from a file

#: Texts with a dollar sign that a reader sees, without those of code.
RAW = r"""() => {
    const texts = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT), found = [];
    for (let node; (node = texts.nextNode()); )
        if (node.data.includes("$") && !node.parentElement.closest("pre, code, script, style"))
            found.push(node.data);
    return found;
}"""
SHOWN = """() => [...document.querySelectorAll(".slides section:not(.stack)")]
    .filter(slide => slide.checkVisibility({visibilityProperty: true}) && !slide.hidden
                     && slide.classList.contains("present")
                     && !slide.parentElement.matches(".past, .future")).length"""


@pytest.fixture(scope="module")
def slides(tmp_path_factory):
    """The folder of the slides of notebooks 00 and 03."""
    folder = tmp_path_factory.mktemp("slides")
    command = [sys.executable, "docs/slides.py", str(folder), "00", "03"]
    subprocess.run(command, cwd=ROOT, check=True)
    return folder


def test_a_question_stands_beside_its_answers(slides):
    html = (slides / "03_conditions_break_it.slides.html").read_text("utf-8")
    shown = re.split(r"<section[^>]*>", html)
    asked = next(part for part in shown if "its own part of the noise?" in part)
    assert all(f"<strong>{letter}</strong>" in asked for letter in "ABC")


def test_a_number_without_a_notebook_gets_a_sentence(tmp_path):
    command = [sys.executable, "docs/slides.py", str(tmp_path), "99"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("error: there is no notebook '99'; available: 00_start_here")


@pytest.fixture
def tab(browser):
    """A tab without network; whatever it asks of it, or misses, is a problem."""
    context = browser.new_context()
    context.set_offline(True)
    tab, problems = context.new_page(), []
    tab.on("request", lambda r: r.url.startswith(("file:", "data:")) or problems.append(r.url))
    tab.on("requestfailed", lambda r: problems.append(r.url[:200]))
    tab.on("pageerror", lambda error: problems.append(str(error)))
    yield tab
    context.close()
    assert problems == []


def formulas(tab, page):
    """Opens a page; returns how many formulas were drawn."""
    tab.goto(page.as_uri())
    tab.evaluate("MathJax.startup.promise")
    assert tab.evaluate(RAW) == []
    assert tab.locator("[data-mjx-error]").count() == 0
    assert tab.evaluate("[...document.images].every(image => image.naturalWidth > 0)")
    return tab.locator("mjx-container svg").count()


def dead_links(folder):
    """Links of the pages of a folder to files that are not there."""
    links = [
        (page.name, link)
        for page in folder.glob("*.html")
        for link in re.findall(r'<a [^>]*href="([^"#]+)', page.read_text("utf-8"))
    ]
    return [(p, link) for p, link in links if ":" not in link and not (folder / link).exists()]


def test_slides_have_no_dead_links(slides):
    assert dead_links(slides) == []


def test_pages_of_the_course(tab, tmp_path):
    runs = [execution.Run(path, execution.read(path), 0, 0) for path in (LESSON, FIRST)]
    lesson, first = (pages.to_html(run, tmp_path) for run in runs)
    assert formulas(tab, lesson) > 3
    assert formulas(tab, first) == 0
    formulas(tab, pages.write_index(runs, tmp_path))
    assert not [page for page in tmp_path.glob("*.html") if "cdnjs" in page.read_text("utf-8")]
    assert dead_links(tmp_path) == []
    tab.goto(lesson.as_uri())
    assert not tab.locator("details.folded pre").first.is_visible()
    tab.locator("details.folded summary").first.click()
    assert tab.locator("details.folded pre").first.is_visible()


def test_slides_show_one_at_a_time(tab, slides):
    assert formulas(tab, slides / f"{LESSON.stem}.slides.html") > 3
    tab.locator(".reveal.ready").wait_for()
    for key, place in (("", [0, 0]), ("Right", [1, 0]), ("Right", [2, 0]), ("Down", [2, 1])):
        if key:
            tab.keyboard.press(f"Arrow{key}")
        tab.wait_for_function(
            "([h, v]) => Reveal.getIndices().h === h && Reveal.getIndices().v === v", arg=place
        )
        assert tab.evaluate(SHOWN) == 1
    tab.keyboard.press("o")
    assert tab.evaluate("Reveal.isOverview()")


#: Of each slide: its headings, whether it begins with one, and whether it is too large.
SIZES = """() => Reveal.getSlides().map(slide => {
    const {h, v} = Reveal.getIndices(slide);
    const inside = [...slide.querySelectorAll("pre, table, img")];
    Reveal.slide(h, v);
    const right = slide.getBoundingClientRect().right + 1;
    return {headings: slide.querySelectorAll("h1, h2, h3, h4").length,
            first: /^H/.test(slide.querySelector(".jp-RenderedHTMLCommon > *")?.tagName),
            high: slide.scrollHeight > 700,
            wide: inside.some(part => part.scrollWidth > part.clientWidth + 2
                                      || part.getBoundingClientRect().right > right)};
})"""


@pytest.mark.parametrize("notebook", [FIRST, LESSON], ids=["00", "03"])
def test_every_heading_starts_a_slide_and_slides_fit_the_screen(tab, slides, notebook):
    """Before, 12 of 20 slides were too high, and most headings stood in the middle of one."""
    tab.set_viewport_size({"width": 1280, "height": 720})
    formulas(tab, slides / f"{notebook.stem}.slides.html")
    tab.locator(".reveal.ready").wait_for()
    sizes = tab.evaluate(SIZES)
    texts = [cell.source for cell in execution.read(notebook).cells if cell.cell_type == "markdown"]
    code = re.compile("```.*?```", re.DOTALL)
    headings = sum(len(re.findall("^#+ ", code.sub("", text), re.MULTILINE)) for text in texts)
    assert sum(slide["headings"] for slide in sizes) == headings
    assert all(slide["headings"] == slide["first"] for slide in sizes)
    assert sum(slide["high"] for slide in sizes) <= len(sizes) / 10
    assert not any(slide["wide"] for slide in sizes)


def test_no_word_of_a_text_is_lost_on_slides():
    spec = importlib.util.spec_from_file_location("slides", ROOT / "docs" / "slides.py")
    spec.loader.exec_module(program := importlib.util.module_from_spec(spec))
    for path in assets.notebooks():
        for text in (c.source for c in execution.read(path).cells if c.cell_type == "markdown"):
            assert " ".join(program.PART.findall(text)).split() == text.split()


def test_a_slide_that_is_too_high_scrolls(tab, slides):
    formulas(tab, slides / f"{FIRST.stem}.slides.html")
    tab.locator(".reveal.ready").wait_for()
    high = """() => {
        Reveal.slide(1, 0);
        const slide = Reveal.getCurrentSlide(), block = document.createElement("div");
        block.style.height = "2000px";
        slide.append(block);
        slide.scrollTop = 1e6;
        return [slide.scrollTop, slide.clientHeight];
    }"""
    top, height = tab.evaluate(high)
    assert top > 0
    assert height <= 700


def test_without_the_package_a_page_asks_the_network(tmp_path, monkeypatch):
    def nothing(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(pages, "distribution", nothing)
    assert pages.mathjax(tmp_path) == pages.ELSEWHERE
    assert list(tmp_path.iterdir()) == []


@pytest.fixture(scope="module")
def page(slides):
    return (slides / "00_start_here.slides.html").read_text("utf-8")


def test_headings_start_slides_and_figures_have_their_texts(page):
    assert page.count("<section") > 8
    assert 'alt="Scatter plot: dark noise' in page
    assert "No description has been provided" not in page


def test_checks_and_folded_cells_are_left_out(page):
    text = re.sub(r"<[^>]+>", "", page)
    assert "Predict" in text
    assert "check(" not in text
    assert "from cotlearn import" not in text
