"""Right answers get full marks in whichever way a notebook was written."""

import handed_in
import pytest
from handed_in import EULER

from cotlearn.homework.isolation import Limits
from cotlearn.homework.marking import mark

pytestmark = pytest.mark.slow
STEP = EULER.replace("x = x0", "x = x0 * ONE")
HONEST = {
    "a dictionary filled later": (
        ("d = {}", 'd["one"] = 1'),
        EULER.replace("x = x0", 'x = x0 * d["one"]'),
    ),
    "a list filled later": (
        ("L = []", "L.append(1)"),
        EULER.replace("x = x0", "x = x0 * sum(L)"),
    ),
    "a number that grows": (("ONE = 0", "ONE += 1"), STEP),
    "an attribute": (
        ("class A: pass", "A.one = 1"),
        EULER.replace("x = x0", "x = x0 * A.one"),
    ),
    "a star": (
        ("from torch import *",),
        EULER.replace("torch.full", "full").replace("range(nfe)", "arange(nfe).tolist()"),
    ),
    "match": (
        ('match "a":\n    case str(word):\n        ONE = 1\n    case _:\n        ONE = 2',),
        STEP,
    ),
    "display": ((), EULER.replace("x = x0", "x = x0\n    display(nfe)")),
    "get_ipython": (
        (),
        f'get_ipython().run_line_magic("matplotlib", "inline")\n{EULER}',
    ),
    "magics": (("%%capture words\nONE = 1", "%time two = 2 * ONE"), STEP),
    "a shell": (("one = !echo 1",), EULER.replace("x = x0", "x = x0 * int(one[0])")),
    "one's own check": ((), f'{EULER}\nfrom cotlearn.homework import check\ncheck(1, "hw1.euler")'),
}


@pytest.fixture(scope="module")
def masters(tmp_path_factory):
    return handed_in.masters(tmp_path_factory.mktemp("masters"))


@pytest.mark.parametrize("name", HONEST)
def test_it_gets_all_points(tmp_path, masters, name):
    before, euler = HONEST[name]
    answers = {"euler": euler}
    path = tmp_path / "hw1.ipynb"
    handed_in.write(path, handed_in.homework(answers, extra=("this fails", *before)))
    limits = Limits(seconds=5, gigabytes=1)
    [found] = mark(path, hidden=True, masters=masters, limits=limits).marks
    assert (found.sentence, found.points, found.hints) == ("correct", 4, [])
