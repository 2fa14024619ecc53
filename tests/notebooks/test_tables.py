"""The tables that notebooks store are those of the files: nobody forgot to run one again.

A cell that prints what `data/results` says runs here, after the earlier cells that it needs, and
must print what the notebook stores. A cell that needs anything live is left out: running the
notebook is its test.
"""

import ast
import contextlib
import io
import re
import symtable

import matplotlib.pyplot as plt
import pytest

#: What reads a file of results.
READS = ("read_table(", "results(", "study(", "episodes(")
#: What trains, measures or rolls out.
LIVE = {"fit", "train", "rollout", "frontier", "examine", "squared_w2", "ChunkPolicy"}


def scopes(table):
    """A scope, and all scopes inside it."""
    yield table
    for child in table.get_children():
        yield from scopes(child)


def names(source):
    """The names that a cell sets, and those that it takes from earlier cells."""
    top, *inner = scopes(symtable.symtable(source, "cell", "exec"))
    sets = {s.get_name() for s in top.get_symbols() if s.is_assigned() or s.is_imported()}
    takes = {s.get_name() for s in top.get_symbols() if s.is_referenced()}
    takes |= {s.get_name() for scope in inner for s in scope.get_symbols() if s.is_global()}
    entries = {  # an entry of an earlier dictionary is set: both
        node.value.id
        for node in ast.walk(ast.parse(source))
        if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store)
        if isinstance(node.value, ast.Name)
    }
    return sets | entries, (takes - sets) | (entries - sets)


def reads(cell):
    """Whether a cell reads a file of results."""
    return cell.cell_type == "code" and any(word in cell.source for word in READS)


def printed_from_files(cells):
    """Each cell that prints from files and needs nothing live, after the cells that it needs."""
    made, found = {}, []  # who makes a name, in order; None if something live does
    for i, cell in enumerate(cells):
        if cell.cell_type != "code":
            continue
        sets, takes = names(cell.source)
        before = [made[name] for name in takes if name in made]
        live = None in before or takes & LIVE
        needs = None if live else sorted({i}.union(*before))
        made |= dict.fromkeys(sets, needs)
        if needs and stored(cell) and any(reads(cells[k]) for k in needs):
            found.append(needs)
    return found


def stored(cell):
    """What a cell printed when the notebook was run, and the table that it ended in."""
    words = [output.text for output in cell.outputs if output.get("name") == "stdout"]
    results = [output.data for output in cell.outputs if output.output_type == "execute_result"]
    return "".join(words + [plain(data["text/html"]) for data in results if "text/html" in data])


def plain(page):
    """A table without the number that is drawn anew for each table."""
    return re.sub(r"T_[0-9a-f]{5}", "T", page).strip()


def run(cell, space):
    """What a cell prints, and the table that it ends in."""
    tree = ast.parse(cell.source)
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    with contextlib.redirect_stdout(io.StringIO()) as text:
        exec(compile(tree, "cell", "exec"), space)
        value = eval(compile(ast.Expression(last.value), "cell", "eval"), space) if last else None
    return text.getvalue() + (plain(value._repr_html_()) if hasattr(value, "_repr_html_") else "")


@pytest.mark.slow
def test_stored_tables_are_those_of_the_files(cells):
    if not any(map(reads, cells)):
        pytest.skip("reads no file of results")
    tables = printed_from_files(cells)
    assert tables, "no cell prints from a file alone"
    printed, space = {}, {"__name__": "__main__"}
    with plt.rc_context():
        for i in sorted(set().union(*tables)):
            printed[i] = run(cells[i], space)
    plt.close("all")
    for *_, i in tables:
        assert printed[i] == stored(cells[i]), f"cell {i} prints other numbers now: run it again"
