"""Networks, losses, integration; metrics."""

from functools import partial

import numpy as np
import torch

from array_cases.base import NETWORK, X0, X1, C, D, N, add, g
from cotlearn import flows, metrics
from cotlearn.flows import diffusion, one_step

_integrate, _diffusion = partial(flows.integrate, NETWORK), diffusion.Diffusion(4)
add("flows.integrate", partial(_integrate, nfe=2), x0=X0, c=C)
add("flows.integrate, dopri5", partial(_integrate, method="dopri5"), x0=X0, c=C)
add("flows.sampler", lambda c: flows.sampler(NETWORK, nfe=1)(c, generator=g()), c=C)
add("flows.diffusion.Diffusion.ddim", partial(_diffusion.ddim, NETWORK, nfe=2), x=X0, c=C)
_noise = torch.randn(3, N, D, generator=g())
add("flows.diffusion.Diffusion.ddpm", partial(_diffusion.ddpm, NETWORK), x=X0, c=C, noise=_noise)
JUMPS = one_step.MeanVelocity(flows.VelocityMLP(D, C.shape[1] + 1, width=8, depth=1, seed=0))
add("flows.one_step.jump", lambda x0, c: one_step.jump(JUMPS, x0, c, nfe=2), x0=X0, c=C)
add("flows.one_step.Drifting.sample", partial(one_step.Drifting().sample, NETWORK), x0=X0, c=C)
add("flows.one_step.TwoPasses.sample", partial(one_step.TwoPasses().sample, NETWORK), x0=X0, c=C)

# --- metrics ---

add("metrics.squared_w2", metrics.squared_w2, a=X0, b=X1)
add("metrics.joint_squared_w2", metrics.joint_squared_w2, a=X0, b=X1, c=C)
add("metrics.l2_uvp", metrics.l2_uvp, mapped=X0, truth=X1)
add("metrics.energy_distance", metrics.energy_distance, a=X0, b=X1)
add("metrics.straightness", lambda x0, c: metrics.straightness(NETWORK, x0, c), x0=X0, c=C)
add("metrics.bootstrap_interval", metrics.bootstrap_interval, values=np.arange(5.0))
add("metrics.paired_bootstrap", metrics.paired_bootstrap, first=np.eye(3), second=np.ones((3, 3)))
for _name in ("energy_score", "energy_scores"):
    _score = getattr(metrics, _name)
    add(f"metrics.{_name}", _score, samples=torch.stack([X0, X1, X0 + X1]), truth=X1)
add("metrics.mode_entropy", metrics.mode_entropy, modes=np.array([[0, 1, 1, 2], [0, 0, 0, 0]]))
