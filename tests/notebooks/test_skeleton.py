"""Every notebook keeps to the skeleton of the course; see CONTRIBUTING.md."""

import itertools
import json
import re
from pathlib import Path

import pytest

MACHINE_PATH = re.compile(
    r"(?<![\w.])/(?:home|root|Users|tmp|work|opt|private|var/folders)/|[A-Z]:\\Users|site-packages"
)
FENCED = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
TRAINS = re.compile(r"\bfit\(|\.backward\(")


def tagged(cells, tag):
    return [i for i, cell in enumerate(cells) if tag in cell.metadata.get("tags", [])]


def code(cells):
    return [(i, cell) for i, cell in enumerate(cells) if cell.cell_type == "code"]


def heading(cells, text):
    """Returns the index of the one cell with the heading `text`."""
    texts = [(i, prose(cell)) for i, cell in enumerate(cells) if cell.cell_type == "markdown"]
    lines = [i for i, words in texts for line in words.splitlines() if line == text]
    assert len(lines) == 1, f"expected one heading {text!r}, found {len(lines)}"
    return lines[0]


def prose(cell):
    """Returns a markdown cell without fenced code."""
    return re.sub(r"^```.*?^```", "", cell.source, flags=re.DOTALL | re.MULTILINE)


def is_figure(output):
    data = output.get("data", {})
    return any(kind.startswith("image/") for kind in data) or "<img" in data.get("text/html", "")


def test_the_first_four_notebooks_are_there():
    folder = Path(__file__).resolve().parent.parent.parent / "notebooks"
    numbers = [path.name[:2] for path in sorted(folder.glob("[0-9][0-9]_*.ipynb"))]
    assert numbers[:4] == ["00", "01", "02", "03"]
    assert len(numbers) == len(set(numbers))


def test_opening(cells, path, extra, room):
    assert cells[0].cell_type == "markdown"
    title, claim, *_ = [line for line in cells[0].source.splitlines() if line.strip()]
    number = f"Extra {int(path.name[:2])}" if extra else path.name[:2]
    number = f"Laboratory {number}" if room == "laboratory" else number
    assert re.fullmatch(rf"# {number} · \S.*", title), "title is '# NN · Title'"
    assert re.fullmatch(r"\*\*[^*].*\*\*", claim), "after the title: one bold sentence, the claim"
    first_code = code(cells)[0][0]
    opening = "\n\n".join(cell.source for cell in cells[:first_code])
    learn = opening.split("**You will learn**", 1)
    assert extra or len(learn) == 2, "'**You will learn**' is missing"
    bullets = re.findall(r"^[-*] \S", learn[-1].split("**Time**")[0], flags=re.MULTILINE)
    assert extra or len(bullets) == 3, f"'You will learn' has {len(bullets)} bullets, not 3"
    assert re.search(r"\*\*Time\*\*.*\d", opening), "'**Time**' with numbers is missing"
    assert re.search(r"\*\*Needs\*\*.*\w", opening), "'**Needs**' is missing"


def test_predict_comes_before_the_first_training(cells):
    predict = heading(cells, "## Predict")
    assert "?" in cells[predict].source.split("## Predict")[1], "'Predict' asks no question"
    early = [i for i, cell in code(cells[:predict]) if TRAINS.search(cell.source)]
    assert not early, f"cells {early} train before the reader could predict"


def test_closing(cells):
    say = heading(cells, "## What you can now say")
    breaks = heading(cells, "## Where it breaks")
    assert say <= breaks <= heading(cells, "## Next")
    claims = tagged(cells, "claim")
    assert any(i > say for i in claims), "no cell tagged 'claim' after 'What you can now say'"
    for i in claims:
        assert "claim(" in cells[i].source, f"cell {i} is tagged 'claim' and claims nothing"


AS_IN_02 = "give it the metadata that notebook 02 has in the cell"
LESSONS = ("08", "10", "11", "13", "14")  #: with a table that is made before


def folded(cell):
    """Whether a cell shows one line of summary, on the site and in JupyterLab."""
    data = cell.metadata
    hidden = "hide-input" in data.get("tags", []), data.get("jupyter", {}).get("source_hidden")
    return all(hidden) and bool(data.get("mystnb", {}).get("code_prompt_show"))


def test_claims_are_folded(cells, extra):
    """A page ends in sentences, and not in the code that checks them."""
    if extra:
        pytest.skip("no lesson")
    for i in tagged(cells, "claim"):
        assert folded(cells[i]), f"cell {i} is not folded: {AS_IN_02} of its claims"


def test_imports_are_folded(cells):
    """A page begins with what it is about, and not with the names that it needs."""
    starts = ("import ", "from ")
    opening = list(itertools.takewhile(lambda x: x[1].source.startswith(starts), code(cells)))
    assert opening, "the first cell of code imports nothing"
    for i, _ in opening:
        assert folded(cells[i]), f"cell {i} is not folded: {AS_IN_02} of its imports"


def test_an_answer_that_is_wrong_stops_no_later_cell(cells, extra):
    """A wrong function met a simulator, whose traceback ended "Run All"."""
    if extra:
        pytest.skip("what an extra asks for, its own cell judges")
    stubs = [cells[i].source for i in tagged(cells, "exercise")]
    names = [name for stub in stubs for name in re.findall(r"^def (\w+)", stub, re.MULTILINE)]
    for number, cell in code(cells):
        for name in names:
            calls = re.findall(rf"^.*\b{name}\(.*$", cell.source, re.MULTILINE)
            own = f"def {name}(" in cell.source  # the stub, or the course's own answer
            assert own or not calls or "except Exception" in cell.source, f"cell {number}: {calls}"


def test_exercises(cells, extra):
    stubs = tagged(cells, "exercise")
    turns = [c for c in cells if c.cell_type == "markdown" and "### Your turn" in prose(c)]
    assert len(stubs) >= 2 - extra, f"{len(stubs)} exercises are too few"
    assert len(turns) == len(stubs), "each exercise has a heading '### Your turn'"
    for i in stubs:
        check, solution = cells[i + 1], cells[i + 2]
        assert "check" in check.metadata.get("tags", []), f"cell {i + 1} is not tagged 'check'"
        assert extra or "check(" in check.source
        assert solution.cell_type == "markdown", f"cell {i + 2} is not a solution"
        assert "<details><summary>Solution</summary>" in solution.source
        assert "```python" in solution.source
        assert "</details>" in solution.source


def test_extras_are_short(cells, extra):
    if not extra:
        pytest.skip("no extra")
    words = " ".join(prose(cell) for cell in cells if cell.cell_type == "markdown").split()
    assert len(cells) <= 20
    assert len(words) <= 900


def test_lessons_are_short(cells, path, room):
    """One story; everything else is in the laboratory."""
    if room != "notebooks":
        pytest.skip("no lesson")
    words = " ".join(prose(cell) for cell in cells if cell.cell_type == "markdown").split()
    assert len(cells) <= 40
    assert len(words) <= (2000 if path.name[:2] in LESSONS else 2500)


def test_code_needs_no_scrolling(cells):
    """On the site and on a phone a line has room for 80 characters; ruff looks at cells only."""
    for i, cell in enumerate(cells):
        parts = [cell.source] if cell.cell_type == "code" else FENCED.findall(cell.source)
        lines = [line for part in parts for line in part.splitlines() if len(line) > 80]
        assert not lines, f"cell {i} has a line of more than 80 characters: {lines[0]}"


def test_code_cells_are_short_and_were_run_in_order(cells):
    counts = []
    for i, cell in code(cells):
        lines = len(cell.source.splitlines())
        assert 1 <= lines <= (40 if folded(cell) else 25), f"cell {i} has {lines} lines"
        counts.append(cell.execution_count)
    assert counts == list(range(1, len(counts) + 1)), "not run once from top to bottom"


def test_figures_have_a_text_and_sentences_around_them(cells):
    for i, cell in code(cells):
        if any(is_figure(output) for output in cell.outputs):
            assert len(cell.metadata.get("alt", "")) >= 20, f"cell {i} has no 'alt' in its metadata"
            assert cells[i - 1].cell_type == "markdown", f"no sentence before figure {i}"
            assert cells[i + 1].cell_type == "markdown", f"no sentence after figure {i}"


def test_outputs_are_clean_and_small(cells, path):
    for i, cell in code(cells):
        for output in cell.outputs:
            assert output.output_type != "error", f"cell {i} stores an error"
            assert output.get("name") != "stderr", f"cell {i} stores a warning: {output.text[:200]}"
            bars = [kind for kind in output.get("data", {}) if "jupyter.widget" in kind]
            assert not bars, f"cell {i} stores a progress bar"
            texts = {k: v for k, v in output.get("data", {}).items() if k.startswith("text/")}
            text = output.get("text", "") + json.dumps(texts)
            found = MACHINE_PATH.search(re.sub(r"base64,[A-Za-z0-9+/=\\n]*", "", text))
            assert not found, f"cell {i} stores a path of a machine: {found[0]}"
    assert path.stat().st_size < 3_000_000, "3 MB of stored output or more"
