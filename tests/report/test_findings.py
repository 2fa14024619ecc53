"""The report: its numbers, its page and its model."""

import ast
import html
import math
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from matplotlib.figure import Figure
from sklearn.datasets import load_digits
from typer.testing import CliRunner

from cotlearn.cli import app
from cotlearn.couplings import ConditionalOT, Independent, OwnUnits, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.diagnostics import Recommendation, between_within, frontier, recommendation
from cotlearn.report import FewStepModel, examine, from_arrays, page, read_data, write_page
from cotlearn.report.findings import split
from cotlearn.report.names import MEANINGS


def two_modes(n=400, seed=0):
    """Labels that shift two far modes; in odd units."""
    rng = np.random.default_rng(seed)
    label = rng.integers(2, size=n)
    x1 = np.column_stack([1000 + 300 * rng.choice([-1, 1], n) + 20 * rng.normal(size=n), label])
    return x1 + 0.1 * rng.normal(size=(n, 2)), label


@pytest.fixture(scope="module")
def findings():
    rows = from_arrays(*two_modes(), name="a <b> & c")
    return examine(rows, steps=40, probe_steps=120, pairs=400)


@pytest.mark.slow
def test_the_trials(findings):
    assert findings.trials[0].name == "independent"
    assert findings.trials[-1].name == findings.advice.name
    for trial in findings.trials:
        assert trial.scores.shape == (4, len(findings.test))
        assert torch.isfinite(trial.scores).all()
    gain, error = findings.gain(1)
    assert gain == pytest.approx(findings.trials[0].at(1) - findings.trials[-1].at(1), abs=1e-6)
    assert error >= 0
    assert "one evaluation" in findings.verdict()
    falling = replace(findings.trials[0], scores=torch.tensor([[4.0, 4], [3, 3], [2, 2], [1, 1]]))
    assert "within 1 % of" not in replace(findings, trials=(falling,)).verdict()  # of itself


@pytest.mark.slow
@pytest.mark.parametrize(
    ("better", "row_by_row", "headline"),
    [
        (
            0.2,
            0.1,
            r"One step becomes better than sixteen with independent pairs, and 20.0 % better than "
            r"one with them \(95 % interval 18.2 to 21.8\): use COT",
        ),
        (0.01, 0.1, r"No gain shown, \+1.0 % .* use independent pairs"),
        (-0.05, 0.1, r"A loss, -5.0 % .* use independent pairs"),
    ],
)
def test_the_trial_decides_and_not_the_forecast(findings, better, row_by_row, headline, tmp_path):
    """Before, the recommended coupling's model was saved whatever its own trial had shown."""
    free = replace(findings.trials[0], scores=torch.ones(4, 100))
    wave = row_by_row * torch.linspace(-1.5, 1.5, 100)
    tried = replace(findings.trials[-1], name="COT", scores=1 - better - wave.expand(4, 100))
    advice = replace(findings.advice, name="COT")
    names = {p.name: p.name if p.name == "independent" else "COT" for p in advice.frontier}
    points = tuple(replace(p, name=names[p.name]) for p in advice.frontier)
    advice = replace(advice, frontier=replace(advice.frontier, points=points))
    found = replace(findings, trials=(free, tried), advice=advice)
    assert found.chosen is (tried if better == 0.2 else free)
    assert found.model is found.chosen.model
    assert re.match(headline, found.headline())
    text = write_page(found, tmp_path / "r.html", model="m").read_text("utf-8")
    assert found.headline() in text
    assert "groups that stay together" not in text  # none were given


@pytest.mark.slow
def test_a_sentinel_does_not_hide_its_column(two_candidates, tmp_path):
    """With 2 % of a column at -9999 the network scored .64 and .59 (two seeds), as without it."""
    rng = np.random.default_rng(0)
    label, where = np.eye(2)[rng.integers(2, size=800)], rng.uniform(-1, 1, (800, 1))
    x1 = np.hstack([where, label[:, :1]]) + 0.05 * rng.normal(size=(800, 2))
    lost = rng.random((800, 1)) < 0.02
    rows = from_arrays(x1, np.hstack([label, np.where(lost, -9999.0, where)]))
    found = examine(rows, steps=200, probe_steps=5, pairs=100)
    there = found.test.c[:, 2] > -3
    assert 0.9 < there.double().mean() < 1
    assert found.trials[0].scores[3][there].mean() < 0.2  # .094, and .094 without a sentinel
    found.model.save(tmp_path / "m.safetensors")
    again, g = FewStepModel.load(tmp_path / "m.safetensors"), torch.Generator()
    drawn = [m.sample(rows.data.c, generator=g.manual_seed(0)) for m in (found.model, again)]
    assert torch.equal(*drawn)


@pytest.mark.slow
def test_a_regression_that_wins_is_the_headline():
    x1, c = two_columns = np.random.default_rng(0).normal(size=(2, 400, 2))
    x1[:] = np.sin(c) + 0.001 * x1
    said = []
    found = examine(from_arrays(*two_columns), steps=5, probe_steps=5, pairs=100, say=said.append)
    assert [text.split()[0] for text in said][1:4] == ["comparing", "training", "testing"]
    assert found.advice.regression_wins
    assert found.headline().startswith("Use a regression")


@pytest.mark.slow
def test_a_regression_that_wins_for_want_of_rows_is_not_recommended():
    """Data that do not depend on c: the page said that they hardly vary."""
    x1, c = (np.random.default_rng(k).normal(size=(400, size)) for k, size in ((0, 2), (1, 16)))
    found = examine(from_arrays(x1, c), steps=5)
    assert found.advice.regression_wins
    assert found.headline().startswith("Too few rows")
    assert "between modes" in found.advice.reason


@pytest.mark.slow
def test_digits_whose_forecast_is_refuted_get_the_model_of_independent_pairs(monkeypatch):
    """The lower half given the upper half, where short and long trainings refute the probe."""
    strata = {"independent": Independent(), "strata": StratifiedOT(32)}

    def advise(x1, c, **options):
        found = frontier(x1, c, {**strata}, progress=False, **options)
        return Recommendation(
            "strata", strata["strata"], "", found, between_within(x1, c), 9.0, False
        )

    monkeypatch.setattr("cotlearn.report.findings.recommend", advise)
    image = load_digits().data
    found = examine(from_arrays(image[:, 32:], image[:, :32]), steps=100, probe_steps=5, pairs=100)
    assert found.trials[-1].name == "strata"
    assert found.model is found.trials[0].model
    assert found.headline().startswith("A loss")
    assert "the training shows a loss" in found.verdict()


@pytest.mark.slow
def test_labels_that_are_only_held_out_are_named():
    """Groups that are the labels: each held-out label was never trained, without a word."""
    x1, _ = two_modes()
    label = np.arange(len(x1)) % 8
    found = examine(from_arrays(x1, label, group=label), steps=5, probe_steps=5, pairs=200)
    (note,) = [note for note in found.rows.notes if "never trained" in note]
    assert re.fullmatch(r".*: \d, \d\.", note)


@pytest.mark.slow
def test_178_rows_get_an_answer():
    found = examine(from_arrays(*two_modes(178)), steps=5, probe_steps=5, pairs=100)
    assert len(found.train) == 134
    assert found.headline()


@pytest.mark.slow
def test_the_model_speaks_the_units_of_the_data_and_survives_the_disk(findings, tmp_path):
    path = tmp_path / "model.safetensors"
    findings.model.save(path)
    model = FewStepModel.load(path)
    c = torch.eye(2).repeat(50, 1)
    g = torch.Generator()
    draws = [m.sample(c, nfe=4, generator=g.manual_seed(0)) for m in (findings.model, model)]
    assert torch.equal(*draws)
    assert 500 < float(draws[0][:, 0].mean()) < 1500
    with pytest.raises(ValueError, match="c has 3 columns, expected 2"):
        model.sample(torch.zeros(1, 3))


@pytest.mark.slow
def test_the_page_is_whole_and_alone(findings, tmp_path):
    file = write_page(findings, tmp_path / "report.html", command="cotlearn report <x>")
    text = file.read_text("utf-8")
    assert not re.search(r"""(src|href)=["'](?!data:)""", text), "the page needs the network"
    assert "<script" not in text
    assert len(re.findall(r"<img alt=\"[^\"]{40,}\"", text)) == 3
    words = ["a &lt;b&gt; &amp; c", "cotlearn report &lt;x&gt;", "prefers-color-scheme: dark"]
    words += ['name="viewport"', "When to use none of this", findings.advice.reason.split(". ")[0]]
    assert [word for word in words if word not in text] == []
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]  # no part is left


@pytest.mark.slow
def test_the_snippet_of_the_page_is_python_for_any_name_of_a_model(findings, tmp_path):
    name = 'it"s\'); import os; print("a\\b.safetensors'
    text = write_page(findings, tmp_path / "report.html", model=name).read_text("utf-8")
    [snippet] = re.findall(r"FewStepModel.load\(.*", html.unescape(text))
    [load] = ast.parse(snippet).body
    assert ast.literal_eval(load.value.args[0]) == name


def with_strata(findings):
    """As `recommend` names and makes them for 1,500 training rows of 2,000."""
    names = ["independent", "naive OT", "COT x 0.1", "COT x 10", "residuals, 32 rows"]
    first = findings.advice.frontier["independent"]
    many = replace(findings.advice.frontier, points=tuple(replace(first, name=n) for n in names))
    coupling = StratifiedOT(1500 * 3 // 4 // 32, residual=True)
    advice = replace(findings.advice, name=names[-1], coupling=coupling, frontier=many)
    free = findings.trials[0]
    tried = replace(findings.trials[-1], name=names[-1], scores=free.scores - 1)
    train, data = (Dataset(torch.randn(n, 2), torch.eye(2)[[0] * n], "m") for n in (1500, 2000))
    rows = replace(findings.rows, data=data, group=np.arange(2000))
    return replace(findings, advice=advice, trials=(free, tried), train=train, rows=rows)


@pytest.mark.slow
def test_the_page_says_which_column_is_which_label(findings, tmp_path):
    """Zeros, which stood there, are no label at all: samples lay off the data."""
    file = write_page(findings, tmp_path / "report.html", model="m.safetensors")
    text = html.unescape(file.read_text("utf-8"))
    assert findings.rows.labels == ("0", "1")
    assert "labels = ['0', '1']  # a column of c each" in text
    assert "c = torch.eye(len(labels))[[0] * 10]" in text
    numbers = replace(findings, rows=replace(findings.rows, labels=()))
    text = write_page(numbers, tmp_path / "r.html", model="m.safetensors").read_text("utf-8")
    assert "c = torch.zeros(10, 2)  # your conditions" in text


@pytest.mark.slow
def test_the_page_explains_the_names_that_occur_and_the_number_of_strata(findings, tmp_path):
    """Before, nothing said what "residuals, 32 rows" are, nor why their code has a 35."""
    text = write_page(with_strata(findings), tmp_path / "r.html").read_text("utf-8")
    assert re.findall("<dt>(.*)</dt>", text) == [
        "independent",
        "naive OT",
        "COT x 0.1; COT x 10",
        "residuals, 32 rows",
    ]
    assert "The 35 in KMeansCondition(35) is the number of strata" in text
    assert "about 32 rows in each: three quarters of the 1500 training rows, in 35 parts" in text
    assert "all 1500 has about 43 in each" in text
    assert "2000 rows of your data, about 57." in text
    before, after = text.split("coupling = StratifiedOT(KMeansCondition(35), residual=True)")
    details = "In one step their samples"
    assert (details in before, details in after) == (False, True)


def test_every_name_that_is_compared_has_a_meaning():
    c = torch.randn(2000, 3)
    labels = torch.eye(3)[torch.arange(2000) % 3]
    for condition in (c, labels):
        for name in recommendation.candidates(torch.randn(2000, 2), condition):
            assert any(re.fullmatch(pattern, name) for pattern in MEANINGS)


@pytest.mark.slow
@pytest.mark.parametrize("width", [390, 1024, 1400])
def test_no_column_of_a_table_is_out_of_sight(findings, browser, tmp_path, width):
    """Before, two columns were cut at any width; in a narrow window, a line says so."""
    page = write_page(with_strata(findings), tmp_path / "r.html")
    tab = browser.new_page(viewport={"width": width, "height": 900})
    tab.goto(page.as_uri())
    over = """[...document.querySelectorAll(".scroll")]
        .some(part => part.scrollWidth > part.clientWidth)"""
    assert tab.evaluate(over) == (width < 800)
    assert tab.locator(".more").first.is_visible() == (width < 800)
    assert tab.evaluate("document.documentElement.scrollWidth") <= width
    tab.close()


@pytest.mark.parametrize("needed", [2, 4, None])
def test_the_first_sentence_says_how_many_steps_one_step_replaces(findings, needed):
    """In the place of the share of one score alone."""
    rows = {2: [3.0, 1, 1, 1], 4: [3.0, 2, 1, 1], None: [3.0, 2, 2, 2]}[needed]
    scores = torch.tensor(rows)[:, None].expand(4, 100)
    free = replace(findings.trials[0], scores=scores)
    tried = replace(findings.trials[-1], scores=torch.ones(4, 100))
    found = replace(findings, trials=(free, tried))
    words = {2: "as good as two", 4: "as good as four", None: "better than sixteen"}[needed]
    assert found.headline().startswith(
        f"One step becomes {words} with independent pairs, and 66.7 % better"
    )


COUPLINGS = [
    (Independent(), "Independent()"),
    (StratifiedOT(105), "StratifiedOT(KMeansCondition(105))"),
    (StratifiedOT(9, residual=True), "StratifiedOT(KMeansCondition(9), residual=True)"),
    (StratifiedOT(), "StratifiedOT()"),
    (ConditionalOT(2.880401), "ConditionalOT(2.88)"),
    (ConditionalOT(math.inf), 'ConditionalOT(float("inf"))'),
    (
        ConditionalOT(0.5, condition=OwnUnits.fit(torch.eye(3))),
        "ConditionalOT(0.5, condition=OwnUnits.fit(data.c))",
    ),
]


@pytest.mark.slow
@pytest.mark.parametrize(("coupling", "code"), COUPLINGS, ids=[code for _, code in COUPLINGS])
def test_the_loop_of_the_page_runs_for_any_coupling_and_file(coupling, code, findings, tmp_path):
    path = tmp_path / "it\"s'); raise SystemExit <b>.npz"
    x1, label = two_modes()
    np.savez(path, x1=x1, c=label)
    rows = read_data(path)
    trials = (
        findings.trials[0],
        replace(findings.trials[-1], scores=findings.trials[0].scores - 1),
    )
    advice = replace(findings.advice, coupling=coupling)
    settings = findings.settings | {"steps": 2}
    found = replace(findings, rows=rows, trials=trials, advice=advice, settings=settings)
    text = write_page(found, tmp_path / "r.html").read_text("utf-8")
    [loop] = re.findall(r"<pre>(import torch\n.*?)</pre>", text, re.DOTALL)
    assert f"coupling = {code}  # {trials[-1].name}" in html.unescape(loop)
    names = {}
    exec(compile(html.unescape(loop), "the page", "exec"), names)
    assert names["samples"].shape == (10, 2)


@pytest.mark.slow
def test_the_loop_for_arrays_says_whose_they_are(findings, tmp_path):
    text = write_page(findings, tmp_path / "r.html").read_text("utf-8")
    assert "rows = from_arrays(x1, c)  # your two arrays" in text


@pytest.mark.parametrize("columns", [1, 2, 5])
def test_samples_are_drawn_over_held_out_rows(findings, columns):
    """Of any number of columns; before, the page had no picture of what a model draws."""
    wide = Dataset(*(torch.randn(50, k) for k in (columns, 2)), "wide")
    drawn = torch.randn(4, 50, columns)
    trials = tuple(replace(t, drawn=drawn) for t in findings.trials)
    figure = Figure()
    page._samples(replace(findings, train=wide, test=wide, trials=trials), ax=figure)
    assert len(figure.axes) == 2 * len(trials)
    for panel in figure.axes:
        assert [len(dots.get_offsets()) for dots in panel.collections] == [50, 50]


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.04, "have about 4 % of the variance within a condition that the data have."),
        (1.004, "have about 100 % of the variance within a condition that the data have."),
        (5.27, "are spread more widely within a condition than the data: 527 % of the variance."),
        (math.inf, "vary within a condition, where the data do not."),
    ],
)
def test_the_spread_of_the_samples_is_that_of_the_table(findings, share, words):
    """Before, it was "at least" that, even of 527 %."""
    spread = torch.full((4,), share * findings.advice.spread.within)
    trials = tuple(replace(trial, spread=spread) for trial in findings.trials)
    said = replace(findings, trials=trials).verdict()
    assert f"In one step their samples {words}" in said


def test_no_word_of_the_workshop_is_left(findings):
    """The sign of the probe's forecast held: nobody outside knew what that says."""
    words = f"{findings.headline()} {findings.verdict()}"
    assert not re.search("probe|forecast|held\\.|sign of|refuted", words)


def test_a_group_is_never_split():
    x1, label = two_modes()
    group = np.arange(400) // 10
    train, test = split(from_arrays(x1, label, group=group))
    assert (len(train), len(test)) == (300, 100)
    assert not set(group[train]) & set(group[test])


def test_copies_are_held_out_together():
    """Of 30 rows, 40 times each, all were on both sides; a split without copies is as before."""
    x1, label = two_modes(30)
    rows = from_arrays(np.tile(x1, (40, 1)), np.tile(label, 40))
    train, test = split(rows)
    assert (len(train), len(test)) == (23 * 40, 7 * 40)
    assert not set(rows.group[train]) & set(rows.group[test])
    alone, given = (split(from_arrays(*two_modes(), group=g)) for g in (None, np.arange(400)))
    assert [part.tolist() for part in alone] == [part.tolist() for part in given]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (from_arrays(*two_modes(100)), "100 rows, 75 to train on .* at least 100"),
        (from_arrays(*two_modes(), group=np.zeros(400, int)), "1 group: at least 4"),
        (from_arrays(*np.tile(two_modes(2)[0], (2, 200, 1))), "2 groups: .* equal rows are in one"),
        (from_arrays(np.ones((400, 2)), two_modes()[1]), "x1 does not vary"),
    ],
)
def test_data_that_do_not_do(rows, message):
    with pytest.raises(ValueError, match=message):
        examine(rows, steps=1, probe_steps=1, pairs=100)


@pytest.mark.slow
def test_notes_are_in_the_terminal_and_on_the_page(tmp_path):
    """A condition that does not vary, before the trainings."""
    path, out = tmp_path / "mine.npz", tmp_path / "r.html"
    np.savez(path, x1=two_modes(200)[0], c=np.ones((200, 1)))
    result = CliRunner().invoke(app, ["report", str(path), "--out", str(out), "--steps", "2"])
    words = "ote: c does not vary: every coupling is then one without a condition"
    before, after = " ".join(result.output.split()).split(f"n{words}")
    assert ("training with" in before, "training with" in after) == (False, True)
    text = out.read_text("utf-8")
    assert f"<p>N{words}.</p>" in text
    assert "label" not in text.partition("<h2>The names")[0]


def test_the_command_stops_with_the_name_of_the_file(tmp_path):
    path = tmp_path / "mine.npz"
    np.savez(path, x1=np.zeros((3, 2)))
    for file, message in ((path, "has no array c"), (tmp_path / "none.npz", "no such file")):
        result = CliRunner().invoke(app, ["report", str(file), "--out", str(tmp_path / "r.html")])
        assert (result.exit_code, message in result.output) == (2, True)
        assert not (tmp_path / "r.html").exists()
