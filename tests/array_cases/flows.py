"""Networks, losses, integration; metrics."""

from __future__ import annotations

import numpy as np
import torch

from array_cases.base import NETWORK, PAIRS, PETALS, X0, X1, C, D, K, N, add, g, pairs, rows
from cotlearn import flows, metrics
from cotlearn.flows import diffusion, networks

add(
    "flows.interpolate",
    flows.interpolate,
    bare=("x0", "x1", "t"),
    x0=X0,
    x1=X1,
    t=torch.linspace(0, 1, N),
)
add("flows.integrate", lambda x0, c: flows.integrate(NETWORK, x0, c, nfe=2), x0=X0, c=C)
add(
    "flows.integrate, dopri5",
    lambda x0, c: flows.integrate(NETWORK, x0, c, method="dopri5"),
    x0=X0,
    c=C,
)
add("flows.sampler", lambda c: flows.sampler(NETWORK, nfe=1)(c, generator=g()), c=C)
_nets = {
    "VelocityMLP": NETWORK,
    "networks.ResidualMLP": networks.ResidualMLP(D, K, width=8, blocks=1, context=4, seed=0),
    "networks.TemporalUNet": networks.TemporalUNet(4, 2, K, widths=(8, 16), context=8, seed=0),
}
for _name, _net in _nets.items():
    add(
        f"flows.{_name}.forward",
        _net,
        bare=("t", "x", "c"),
        t=torch.linspace(0, 1, N),
        x=rows(N, 8) if "UNet" in _name else X0,
        c=C,
    )
add(
    "flows.Guided.__call__",
    flows.Guided(NETWORK, 2.0),
    bare=("t", "x", "c"),
    t=torch.linspace(0, 1, N),
    x=X0,
    c=C,
)
add(
    "flows.networks.ImageEncoder.forward",
    networks.ImageEncoder(3, filters=(8, 8), seed=0),
    bare=("images",),
    images=torch.rand(2, 3, 8, 8, generator=g()),
)
_losses = {
    "flows.conditional_flow_matching_loss": flows.conditional_flow_matching_loss,
    "flows.EarlyFlowMatching.__call__": flows.EarlyFlowMatching(0.3),
    "flows.LabelDropout.__call__": flows.LabelDropout(0.5),
    "flows.diffusion.regression_loss": diffusion.regression_loss,
    "flows.diffusion.Diffusion.loss": diffusion.Diffusion(4).loss,
}
for _name, _loss in _losses.items():
    add(
        _name,
        lambda x0, x1, c, f=_loss: f(NETWORK, pairs(x0, x1, c), g()),
        bare=("x0", "x1", "c"),
        **PAIRS,
    )
add(
    "flows.diffusion.predict",
    lambda x, c: diffusion.predict(NETWORK, x, c),
    bare=("x", "c"),
    x=X0,
    c=C,
)
add(
    "flows.diffusion.Diffusion.ddim",
    lambda x, c: diffusion.Diffusion(4).ddim(NETWORK, x, c, nfe=2),
    x=X0,
    c=C,
)
add(
    "flows.diffusion.Diffusion.ddpm",
    lambda x, c, noise: diffusion.Diffusion(4).ddpm(NETWORK, x, c, noise=noise),
    x=X0,
    c=C,
    noise=torch.randn(3, N, D, generator=g()),
)

# --- metrics ---

add("metrics.squared_w2", metrics.squared_w2, a=X0, b=X1)
add("metrics.joint_squared_w2", metrics.joint_squared_w2, a=X0, b=X1, c=C)
add(
    "metrics.conditional_squared_w2",
    lambda conditions: metrics.conditional_squared_w2(
        PETALS.sample_given, PETALS, conditions=conditions, n=8, generator=g()
    ),
    conditions=C[:3],
)
add("metrics.l2_uvp", metrics.l2_uvp, mapped=X0, truth=X1)
add("metrics.energy_distance", metrics.energy_distance, a=X0, b=X1)
add("metrics.straightness", lambda x0, c: metrics.straightness(NETWORK, x0, c, nfe=4), x0=X0, c=C)
add("metrics.bootstrap_interval", metrics.bootstrap_interval, values=np.arange(5.0))
add("metrics.paired_bootstrap", metrics.paired_bootstrap, first=np.eye(3), second=np.ones((3, 3)))
for _name in ("energy_score", "energy_scores"):
    _score = getattr(metrics, _name)
    add(f"metrics.{_name}", _score, samples=torch.stack([X0, X1, X0 + X1]), truth=X1)
add("metrics.mode_entropy", metrics.mode_entropy, modes=np.array([[0, 1, 1, 2], [0, 0, 0, 0]]))
