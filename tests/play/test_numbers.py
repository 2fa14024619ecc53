"""In a real browser: what the page computes is what SciPy, torch and the library compute."""

import math

import numpy as np
import pytest
import torch
from scipy.optimize import linear_sum_assignment

from cotlearn.diagnostics import linear_skew, prior_skew
from cotlearn.diagnostics.frontier import NEIGHBOURS, _places
from cotlearn.diagnostics.spread import local_variance
from cotlearn.metrics import squared_w2
from cotlearn.play import content, networks
from cotlearn.play.script import joined

pytestmark = pytest.mark.slow  # starts a browser


@pytest.fixture(scope="module")
def page(browser):
    """A page with all modules and nothing else."""
    page = browser.new_page()
    page.goto("about:blank")
    page.add_script_tag(content=joined("page"))
    yield page
    page.close()


def call(page, body, value):
    return page.evaluate(f"(given) => {{ const play = cotlearn_play; {body} }}", value)


@pytest.mark.parametrize("rows", [1, 2, 7, 64, 128])
def test_the_assignment_costs_what_scipy_s_does(page, rows):
    cost = np.random.default_rng(rows).random((rows, rows))
    body = "return Array.from(play.assignment.assign(Float64Array.from(given[0]), given[1]));"
    found = call(page, body, [cost.ravel().tolist(), rows])
    assert sorted(found) == list(range(rows))
    best = cost[linear_sum_assignment(cost)].sum()
    assert cost[np.arange(rows), found].sum() == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("weight", [0.0, 3.0, math.inf])
@pytest.mark.parametrize("labelled", [True, False])
def test_pairs_cost_what_the_library_s_cost(page, weight, labelled):
    rng = np.random.default_rng(3)
    x0, x1 = rng.normal(size=(2, 60, 2))
    c = np.eye(3)[rng.integers(3, size=60)] if labelled else rng.uniform(-1, 1, size=(60, 1))
    order = rng.permutation(60)
    body = """
      const [x0, x1, c] = given.slice(0, 3).map((rows) => Float64Array.from(rows));
      const batch = { x0, x1, c, k: given[3], order: Int32Array.from(given[4]) };
      return Array.from(play.assignment.pair(batch, given[5]));
    """
    flat = [values.ravel().tolist() for values in (x0, x1, c)]
    found = call(page, body, [*flat, c.shape[1], order.tolist(), weight])
    apart = ((c[order][:, None] - c[None]) ** 2).sum(2)
    w = 1e9 if weight == math.inf else weight
    cost = ((x0[:, None] - x1[None]) ** 2).sum(2) + w * apart
    best = cost[linear_sum_assignment(cost)].sum()
    assert sorted(found) == list(range(60))
    assert cost[np.arange(60), found].sum() == pytest.approx(best, rel=1e-9, abs=1e-6)


@pytest.mark.parametrize("name", list(networks.DATA))
def test_networks_agree_with_torch(page, name):
    data = networks.DATA[name]()
    generator = torch.Generator().manual_seed(0)
    _, c = data.sample(200, generator)
    x = 3 * torch.randn(200, 2, generator=generator)
    t = torch.rand(200, generator=generator)
    sizes = content.samples()["networks"]["sizes"][name]
    for coupling, parts in networks.shipped()[name].items():
        model = networks.empty(data)
        model.load_state_dict(dict(zip(model.state_dict(), parts, strict=True)))
        body = """
          const [weights, sizes, t, x, c] = given;
          const network = new play.network.Network(play.data.numbers(weights), sizes);
          const k = sizes[0] - 3;
          return t.map((now, i) => Array.from(network.velocity(now, x, 2 * i, c, i * k)));
        """
        weights = content.samples()["networks"]["weights"][name][coupling]
        flat = [values.flatten().tolist() for values in (t, x, c)]
        found = np.array(call(page, body, [weights, sizes, *flat]))
        with torch.no_grad():
            expected = model(t, x, c).numpy()
        assert np.abs(found - expected).max() < 1e-4, coupling


@pytest.mark.parametrize("labelled", [True, False])
def test_the_numbers_agree_with_the_diagnostics(page, labelled):
    rng = np.random.default_rng(5)
    c = np.eye(4)[rng.integers(4, size=400)] if labelled else rng.uniform(-1, 1, size=(400, 1))
    x0 = rng.normal(size=(400, 2)) + c[:, :1]
    x1 = x0**2 + rng.normal(size=(400, 2))
    generator = torch.Generator().manual_seed(8)
    drawn = np.random.default_rng(int(torch.randint(2**62, (1,), generator=generator)))
    rows, shuffle = drawn.permutation(400), drawn.permutation(200)
    body = """
      const [x0, x1, c, rows, shuffle] = given.map((values) => Float64Array.from(values));
      const k = c.length / rows.length;
      const { explained, skew, oneStepVariance } = play.measures;
      return [
        explained(x0, c, k),
        skew(x0, c, k, Int32Array.from(rows), Int32Array.from(shuffle)),
        oneStepVariance(x0, x1, c, k),
      ];
    """
    flat = [np.ravel(values).tolist() for values in (x0, x1, c, rows, shuffle)]
    found = call(page, body, flat)
    noise, data, given = (torch.from_numpy(values) for values in (x0, x1, c))
    again = torch.Generator().manual_seed(8)

    class Rows:
        pass

    pairs = Rows()
    pairs.x0, pairs.c = noise, given
    variance = local_variance(_places(pairs, noise, given), x1, NEIGHBOURS).mean()
    expected = [
        linear_skew(noise, given).explained,
        prior_skew(noise, given, generator=again).statistic,
        variance,
    ]
    assert found == pytest.approx(expected, abs=1e-9)
    body = "return play.measures.squaredW2(...given.map((rows) => Float64Array.from(rows)));"
    distance = call(page, body, [x0[:100].ravel().tolist(), x1[:100].ravel().tolist()])
    assert distance == pytest.approx(squared_w2(noise[:100], data[:100]), rel=1e-9)
