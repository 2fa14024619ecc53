"""The masters, their student versions, and what students import."""

import ast
import json
from pathlib import Path

import pytest

import cotlearn
from cotlearn.course import assignments, release, submissions
from cotlearn.course.checking import exercises

ROOT = Path(__file__).parents[2]
MASTERS = assignments.masters()
#: Names that student copies of this minor version import; they stay until the next one.
HELPERS = {
    "cotlearn.couplings": {"ConditionalOT"},
    "cotlearn.diagnostics": {"frontier"},
    "cotlearn.flows": {"VelocityMLP"},
    "cotlearn.course": {"check", "find_data", "passed"},
    "cotlearn.course.push_t_twist": {"Twist", "play"},
    "cotlearn.metrics": {"paired_bootstrap", "squared_w2"},
    "cotlearn.mixtures": {"petals"},
    "cotlearn.policies.policy": {"ChunkPolicy"},
    "cotlearn.policies.samplers": {"FlowSampler"},
    "cotlearn.robots.push_t": {"GOAL"},
    "cotlearn": {"plots"},
}
OUTSIDE = {"matplotlib.pyplot", "numpy", "scipy.optimize", "torch"}


def student(master: Path) -> Path:
    return master.parent / "student" / master.name


def test_they_are_numbered():
    assert [path.stem for path in MASTERS] == [f"hw{n + 1}" for n in range(len(MASTERS))]
    assert len(MASTERS) >= 4


each_master = pytest.mark.parametrize("master", MASTERS, ids=lambda path: path.stem)


@each_master
def test_the_student_version_is_that_of_the_master(master):
    stamp = json.loads(student(master).read_text(encoding="utf-8"))["metadata"]["cotlearn"]
    made = {"assignment": master.stem, "version": cotlearn.__version__}
    assert stamp == {**made, "master": release.fingerprint(master)}, "run: make homework"


@each_master
def test_students_see_no_solution_and_no_hidden_test(master):
    text = student(master).read_text(encoding="utf-8")
    for word in ("SOLUTION", "BEGIN TEST", "hidden: ", "seed = "):
        assert word not in text.replace("seed = 0", "")
    questions = []
    for cell in json.loads(text)["cells"]:
        if "exercise" in cell["metadata"].get("tags", []):
            questions.append(cell["metadata"]["cotlearn"]["question"])
            assert cell["source"][-1].strip() == "..."
    assert questions == [asked.name for asked in assignments.read(master, master.stem).questions]


@each_master
def test_questions_have_checks_and_seeded_tests(master):
    for question in assignments.read(master, master.stem).questions:
        assert question.name in exercises()
        assert len(question.tests) >= 2
        for test in question.tests:
            assert "    seed = " in test.source
            assert test.points > 0
        assert sum("require(" in test.source for test in question.tests) == 1


def test_what_handed_out_copies_import_is_there():
    for module, names in HELPERS.items():
        exec(f"from {module} import {', '.join(names)}")


def test_a_release_promises_what_students_import():
    """Until its heading has a date, a new assignment need not be listed in `HELPERS`."""
    imported: dict[str, set[str]] = {}
    for master in MASTERS:
        for cell in submissions.read(student(master)).cells:
            for node in ast.walk(ast.parse(cell.source)):
                if isinstance(node, ast.ImportFrom):
                    names = {item.name for item in node.names}
                    imported.setdefault(str(node.module), set()).update(names)
                elif isinstance(node, ast.Import):
                    imported.update({item.name: set() for item in node.names})
    ours = {module: names for module, names in imported.items() if module not in OUTSIDE}
    assert all(module.partition(".")[0] == "cotlearn" for module in ours)
    heading = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8").split("\n## ")[1]
    assert "(not yet released)" in heading.splitlines()[0] or ours == HELPERS
