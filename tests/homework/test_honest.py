"""Right answers get full marks in whichever way a notebook was written."""

import handed_in
import pytest
from handed_in import EULER

from cotlearn.homework.isolation import Limits
from cotlearn.homework.marking import mark

pytestmark = pytest.mark.slow
STAR = EULER.replace("torch.full", "full").replace("range(nfe)", "arange(nfe).tolist()")
MATCH = 'match "a":\n    case str(word):\n        ONE = 1\n    case _:\n        ONE = 2'


def times(factor):
    return EULER.replace("x = x0", f"x = x0 * {factor}")


HONEST = {
    "a dictionary filled later": (("d = {}", 'd["one"] = 1'), times('d["one"]')),
    "a list filled later": (("L = []", "L.append(1)"), times("sum(L)")),
    "a number that grows": (("ONE = 0", "ONE += 1"), times("ONE")),
    "an attribute": (("class A: pass", "A.one = 1"), times("A.one")),
    "a star": (("from torch import *",), STAR),
    "match": ((MATCH,), times("ONE")),
    "display": ((), EULER.replace("x = x0", "x = x0\n    display(nfe)")),
    "get_ipython": ((), f'get_ipython().run_line_magic("matplotlib", "inline")\n{EULER}'),
    "magics": (("%%capture words\nONE = 1", "%time two = 2 * ONE"), times("ONE")),
    "a shell": (("one = !echo 1",), times("int(one[0])")),
    "one's own check": ((), f'{EULER}\nfrom cotlearn.homework import check\ncheck(1, "hw1.euler")'),
}


@pytest.mark.parametrize("name", HONEST)
def test_it_gets_all_points(tmp_path, masters, name):
    before, euler = HONEST[name]
    path, limits = tmp_path / "hw1.ipynb", Limits(seconds=5, gigabytes=1)
    handed_in.write(path, handed_in.homework({"euler": euler}, extra=("this fails", *before)))
    [found] = mark(path, hidden=True, masters=masters, limits=limits).marks
    assert (found.sentence, found.points, found.hints) == ("correct", 4, [])
