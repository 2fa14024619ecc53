"""Couplings and what they see of a condition; diagnostics."""

from functools import partial

import torch

from array_cases.base import PAIRS, X0, X1, C, D, N, add, g, labels, rows
from cotlearn import couplings, diagnostics


class _Still(torch.nn.Module):
    """A network for conditions of any size."""

    def forward(self, t, x, c=None):
        return torch.zeros_like(x)


_aligned = couplings.ModelAligned(warmup_steps=1)
_aligned.observe(_Still(), 5)
COUPLINGS = {
    "MinibatchOT, sinkhorn": couplings.MinibatchOT(plan="sinkhorn", sampling="replacement"),
    "ConditionalOT, source": couplings.ConditionalOT(2.0, label="source"),
    "AdaptiveConditionalOT": couplings.AdaptiveConditionalOT(0.9),
    "StratifiedOT, residual": couplings.StratifiedOT(2, residual=True),
    "SemidiscreteOT": couplings.SemidiscreteOT(1.0, iterations=20),
    "ModelAligned": _aligned,
    "Transformed": couplings.Transformed(couplings.MinibatchOT(), lambda x, c: -x, lambda x, c: -x),
    "Transformed, centred": couplings.centred(couplings.MinibatchOT(), lambda c: c[:, [0] * D]),
    "Reflow": couplings.Reflow(lambda x0, c: x0 + 1),
}


_tried = {name.partition(",")[0] for name in COUPLINGS} | {"Coupling", "FixedPairs"}
for _name in sorted(set(couplings.__all__) - _tried):  # a new one needs no line here
    _made = getattr(couplings, _name)
    if isinstance(_made, type) and issubclass(_made, couplings.Coupling):
        COUPLINGS[_name] = _made()

for _name, _coupling in COUPLINGS.items():
    _class, _comma, _variant = _name.partition(",")
    add(
        f"couplings.{_class}.__call__{_comma}{_variant}",
        lambda x0, x1, c, made=_coupling: made(x0, x1, c, generator=g()),
        **PAIRS,
    )
_index = {"source_index": torch.arange(N), "target_index": torch.arange(N)}
_pairs = {**PAIRS, **_index, "weight": torch.ones(N), "group": torch.arange(N)}
add("couplings.Pairs", couplings.Pairs, bare=tuple(_pairs), **_pairs)
add("couplings.SemidiscreteOT.fit", COUPLINGS["SemidiscreteOT"].fit, x1=X1, c=C)
add("couplings.KMeansCondition.fit", couplings.KMeansCondition(2).fit, c=C)
_images, _pca = torch.rand(N, 12, generator=g()), couplings.PCAKMeansCondition
add("couplings.PCAKMeansCondition.fit", lambda c: _pca(components=2, clusters=2).fit(c), c=_images)
for _name in ("__call__", "labels"):
    _fitted = couplings.KMeansCondition(2).fit(labels(40))
    add(f"couplings.KMeansCondition.{_name}", getattr(_fitted, _name), c=C)
    _fitted = _pca(components=2, clusters=2).fit(_images)
    add(f"couplings.PCAKMeansCondition.{_name}", getattr(_fitted, _name), c=_images)
for _name in ("fit", "__call__", "labels"):
    _fitted = couplings.EmbeddedClusters(torch.sin, couplings.KMeansCondition(2)).fit(labels(40))
    add(f"couplings.EmbeddedClusters.{_name}", getattr(_fitted, _name), c=C)
add("couplings.combine", lambda a, b: couplings.combine({"a": a, "b": b}), a=C, b=X0)

# --- diagnostics ---

_x, _c = rows(240, seed=5), labels(240)
add("diagnostics.between_within", diagnostics.between_within, x1=_x, c=_c)
add("diagnostics.prior_skew", diagnostics.prior_skew, x0=_x, c=_c)
add("diagnostics.linear_skew", diagnostics.linear_skew, x0=_x, c=_c)
_small = {"batch_size": 16, "rows": 100}
_frontier = partial(diagnostics.frontier, couplings={"i": couplings.Independent()}, repetitions=2)
add("diagnostics.frontier", partial(_frontier, **_small), x1=_x, c=_c)
_recommend = partial(diagnostics.recommend, probe_steps=2, **_small)
add("diagnostics.recommend", _recommend, x1=_x, c=_c)
