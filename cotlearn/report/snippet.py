"""The lines that put a report's coupling into a training loop of one's own."""

import math
from dataclasses import MISSING, fields
from typing import Any

from cotlearn.couplings import Coupling, OwnUnits
from cotlearn.couplings.conditions import Clusters
from cotlearn.datasets import Dataset

LOOP = """\
import torch

from cotlearn.couplings import {names}
from cotlearn.couplings.units import TamedStandardiser
from cotlearn.datasets import Dataset, Standardiser
from cotlearn.flows import VelocityMLP
from cotlearn.report import {reader}

{read}
x1, c = rows.data.x1, rows.data.c
data = Dataset(Standardiser.fit(x1)(x1), TamedStandardiser.fit(c)(c))
network = VelocityMLP({dim}, {condition_dim})  # or your own
optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)

torch.set_num_threads(1)  # for small networks, more gain nothing
coupling = {coupling}{called}
batches = coupling.stream(data, batch_size={batch})
for _ in range({steps}):
    pairs = next(batches)  # noise x0, data x1 and condition c that belong together
    t = torch.rand(len(pairs.x0))
    x_t = torch.lerp(pairs.x0, pairs.x1, t[:, None])
    loss = (network(t, x_t, pairs.c) - (pairs.x1 - pairs.x0)).square().mean()
    optimizer.zero_grad()
    loss.backward()
    optimizer.step()

some = data.c[:10]
noise = torch.randn(len(some), {dim})
with torch.no_grad():
    samples = noise + network(torch.zeros(len(some)), noise, some)  # one step, standardised
print(Standardiser.fit(x1).inverse(samples))
"""


def own_loop(
    coupling: Coupling, data: Dataset, code: str, *, name: str, steps: int, batch: int
) -> str:
    """Python that reads the data again and trains on pairs of `coupling`.

    Args:
        coupling: of a report.
        data: its rows, for their numbers of columns.
        code: `Rows.code`; empty for data that are arrays x1 and c of the reader.
        name: of the coupling in the report.
        steps: gradient steps.
        batch: rows of a batch.
    """
    called = f"{name}, in the units of these data" if name.startswith("COT x") else name
    word = "read_data" if code else "from_arrays"
    read = f"rows = {code}" if code else "rows = from_arrays(x1, c)  # your two arrays"
    return LOOP.format(
        names=", ".join(sorted(names_in(coupling))),
        reader=word,
        read=read,
        dim=data.dim,
        condition_dim=data.condition_dim,
        coupling=as_code(coupling),
        called=f"  # {called}",
        batch=min(batch, len(data)),
        steps=steps,
    )


def as_code(value: Any) -> str:
    """A coupling as one would write it: options that have their default are left out.

    Numbers have four digits; units that were fitted to the conditions are fitted again.
    """
    if isinstance(value, OwnUnits):
        return "OwnUnits.fit(data.c)"
    if isinstance(value, float):
        return f"{value:.4g}" if math.isfinite(value) else 'float("inf")'
    if not isinstance(value, Coupling | Clusters):
        return repr(value)
    words: list[str] = []
    for position, field in enumerate(fields(value)):  # type: ignore[arg-type]
        given = getattr(value, field.name)
        if field.default is MISSING or given != field.default:
            first = position == 0
            words.append(as_code(given) if first else f"{field.name}={as_code(given)}")
    return f"{type(value).__name__}({', '.join(words)})"


def names_in(value: Any) -> set[str]:
    """What `as_code` of it imports from `cotlearn.couplings`."""
    if not isinstance(value, Coupling | Clusters | OwnUnits):
        return set()
    parts = [] if isinstance(value, OwnUnits) else fields(value)  # type: ignore[arg-type]
    return {type(value).__name__}.union(*(names_in(getattr(value, f.name)) for f in parts))
