"""Mixtures, rows, and the Gaussian case that is solved."""

from functools import partial

import numpy as np
import torch
from support import toys

from array_cases.base import PETALS, X0, X1, C, N, add, g, labels, rows
from cotlearn import datasets, flows, gaussian, report
from cotlearn.couplings.units import TamedStandardiser

DATA = datasets.Dataset(rows(40, seed=3), labels(40))
LINEAR = gaussian.LinearGaussian.example()
SPD = np.array([[2.0, 0.5], [0.5, 1.0]])


add("datasets.Dataset", datasets.Dataset, x1=X1, c=C)
add("datasets.Dataset.sample_given", lambda c: DATA.sample_given(c, generator=g()), c=C)
for _name, _data in toys().items():
    _c = _data.sample_conditions(N, generator=g())
    _key = f"mixtures.ConditionalGaussianMixture.{{}}, {_name}"
    add(_key.format("sample_given"), lambda c, d=_data: d.sample_given(c, generator=g()), c=_c)
    add(_key.format("log_density"), _data.log_density, x=X0, c=_c)
    add(_key.format("velocity"), partial(_data.velocity, 0.5), x=X0, c=_c)
_times = torch.full((N,), 0.5)
add("mixtures.ConditionalGaussianMixture.velocity", PETALS.velocity, t=_times, x=X0, c=C)

# --- the solvable case ---

_given = {name: getattr(LINEAR, name) for name in ("A", "b", "S", "S_c")}
add("gaussian.LinearGaussian", gaussian.LinearGaussian, **_given)
_flow, _ones = LINEAR.flow(1.0), {"x": np.ones((N, 2)), "c": np.ones((N, 1))}
add("gaussian.AffineFlow.law_after", _flow.law_after, c=np.array([0.3]))
add("gaussian.AffineFlow.velocity", partial(_flow.velocity, 0.5), **_ones)
add("gaussian.bures_map", gaussian.bures_map, source=SPD, target=np.eye(2))
add("gaussian.bures_squared", gaussian.bures_squared, first=SPD, second=np.eye(2))

# --- data of one's own ---

_scales = datasets.Standardiser.fit(X1), TamedStandardiser.fit(C)
_few = report.FewStepModel(flows.VelocityMLP(2, 3, width=8, depth=1, seed=0), *_scales, {})
add("report.FewStepModel.sample", lambda c: _few.sample(c, generator=g()), c=C)
add("report.from_arrays", report.from_arrays, x1=X1.numpy(), c=C.numpy(), group=np.arange(N))
