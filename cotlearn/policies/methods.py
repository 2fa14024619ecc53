"""The methods that are trained and compared: one row for each, and no list of them elsewhere.

Training, comparison and the help of the commands read `METHODS`. A new method is a class (of a
coupling, a loss or a sampler), its test, and a row here.
"""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from cotlearn import couplings
from cotlearn.couplings import Coupling, EmbeddedClusters, Independent, StratifiedOT
from cotlearn.datasets import Dataset
from cotlearn.flows import diffusion, matching
from cotlearn.flows.diffusion import predict, regression_loss
from cotlearn.flows.matching import FlowMatching, Loss, velocity_of
from cotlearn.flows.one_step import Drifting, MeanFlow, MeanVelocity, Shortcut, TwoPasses
from cotlearn.flows.solvers import integrate
from cotlearn.policies import samplers
from cotlearn.policies.options import Options
from cotlearn.policies.pixels import CameraNetwork
from cotlearn.policies.windows import Windows
from cotlearn.randomness import Purpose, generator_for
from cotlearn.validation import check_choice

if TYPE_CHECKING:
    from cotlearn.policies.training import Run


@dataclass(frozen=True)
class Method:
    """A row of the table.

    Attributes:
        name: as in `cotlearn train --coupling NAME`, and in the table of looks of `plots.style`;
            one that is not there gets a free look.
        description: one line, for the help.
        coupling: makes the coupling from the options and the clusters of pictures that were asked
            for; None where there is no camera.
        loss: makes the loss from the options.
        sampler: makes the sampler of most evaluations from the options and the largest value in the
            chunks.
        predictions: that the network can be trained to make, the default first.
        open_option: the option that the frontier chooses where it is None.
        pictures: how many clusters of a camera's pictures the coupling is given; None: none.
        network: wraps the network of the options.
        columns: that it adds to the condition.
        cost: of a gradient step in units of flow matching; the training has fewer steps instead.
        prepare: changes a training before it starts: by a regression, by pairs of a teacher.
    """

    name: str
    description: str
    coupling: Callable[[Options, EmbeddedClusters | None], Coupling] = lambda *_: Independent()
    loss: Callable[[Options], Loss] = lambda o: FlowMatching(o.share_at_t0, o.prediction)
    sampler: Callable[[Options, float], samplers.Sampler] = lambda options, clip: (
        samplers.FlowSampler(16, prediction=options.prediction)
    )
    predictions: tuple[str, ...] = matching.PREDICTIONS
    open_option: str = ""
    pictures: Callable[[Options], int | None] | None = None
    network: Callable[[nn.Module], nn.Module] = lambda plain: plain
    columns: int = 0
    cost: float = 1.0
    prepare: Callable[[Run], None] | None = None

    def make_network(self, options: Options, windows: Windows, *, seed: int) -> nn.Module:
        """The network of the options, wrapped; that of a camera wraps its own head."""
        network = options.make_network(windows, columns=self.columns, seed=seed)
        return network if options.camera else self.network(network)

    def fitted_pictures(
        self, options: Options, data: Dataset, windows: Windows
    ) -> EmbeddedClusters | None:
        """The clusters of pictures that the coupling is given, fitted to the data."""
        clusters = self.pictures(options) if self.pictures else None
        if options.camera is None or clusters is None or data.c is None:
            return None
        return options.camera.condition(data.c, windows, clusters=clusters)

    def settle(self, options: Options) -> Options:
        """Fill in the prediction: the default if the options leave it open or there is no other.

        Raises:
            ValueError: the method has several, but not that of the options.
        """
        one = len(self.predictions) == 1 or not options.prediction
        wanted = self.predictions[0] if one else options.prediction
        name = f"prediction of {self.name}"
        return replace(options, prediction=check_choice(wanted, name, self.predictions))


def _conditional(options: Options, pictures: EmbeddedClusters | None) -> Coupling:
    weight = "balanced" if options.condition_weight is None else options.condition_weight
    return couplings.ConditionalOT(weight, condition=pictures)


def _stratified(
    options: Options, pictures: EmbeddedClusters | None, *, residual: bool = False
) -> StratifiedOT:
    if options.clusters is None:
        raise ValueError("clusters must be an integer, got None: choose it with `with_choice`")
    return StratifiedOT(pictures or options.clusters, residual=residual)


def _centre(run: Run) -> None:
    """Pair noise with the residuals of a regression of the chunks on the condition.

    The regression is trained for a fifth of the steps only: one that memorises the rows would
    leave no residual.
    """
    first = replace(run, coupling=Independent(), loss=regression_loss)
    first.options = replace(run.options, steps=max(1, run.options.steps // 5))
    network, dim = first.fit("regression_").network, run.data.dim

    def mean(c: Tensor) -> Tensor:
        parts = (predict(network, o.new_zeros(len(o), dim), o) for o in c.split(8192))
        return torch.cat(list(parts))

    run.coupling, run.seconds = couplings.centred(run.coupling, mean), first.seconds


def _distil(run: Run, *, inverted: bool = False) -> None:
    """Trains a teacher; the student starts from its weights, and learns pairs that it made.

    The pairs are noise and the teacher's chunk from it, or, inverted, a demonstrated chunk and the
    noise from which the teacher would make it. Backwards, Euler's method is not enough: where data
    vary little, the noise would stay too near to 0 (`benchmarks/inversion.py`).
    """
    run.network = run.fit("teacher_").network
    started = time.perf_counter()
    camera = run.network if isinstance(run.network, CameraNetwork) else None
    velocity = velocity_of(camera.head if camera else run.network, run.options.prediction)
    nfe = run.options.reflow_nfe

    def backwards(t: Tensor, x: Tensor, c: Tensor | None) -> Tensor:
        return -velocity(1 - t, x, c)

    @torch.no_grad()
    def ends(field: Any, starts: Tensor, c: Tensor, **solver: Any) -> Tensor:
        parts = zip(starts.split(4096), c.split(4096), strict=True)
        found = []
        for x, some in parts:
            seen = camera.encode(some) if camera else some  # once for all evaluations
            found.append(integrate(field, x, seen, **solver).x1)
        return torch.cat(found)

    if inverted:
        x1, c = run.data.x1, run.data.c
        assert c is not None
        x0 = ends(backwards, x1, c, nfe=4 * nfe, method="midpoint")
    else:
        rng = generator_for(run.seed, 0, Purpose.TEACHER)
        _, c = run.data.sample(run.options.reflow_pairs, generator=rng)
        assert c is not None
        x0 = torch.randn(len(c), run.data.dim, generator=rng)
        x1 = ends(velocity, x0, c, nfe=nfe)
    run.data = Dataset(x1, c, name=f"{run.data.name}, paired by a teacher")
    run.coupling = couplings.FixedPairs(x0)
    run.seconds += time.perf_counter() - started


RESIDUAL: dict[str, Any] = {
    "coupling": functools.partial(_stratified, residual=True),
    "open_option": "clusters",
    "pictures": lambda options: options.clusters,
}
ADAPTIVE = Method(
    "adaptive_weights",
    "flow matching with the weights of mean flows: large errors count less",
    loss=lambda o: FlowMatching(o.share_at_t0, o.prediction, power=1.0),
)
#: Uniform times, and jumps on a quarter of the rows of a shortcut model: held-out demonstrations of
#: the arm prefer them (`study(source="jump_choices_arm_ring")`, and "jump_choices_arm_avoid").
MEAN_FLOW = Method(
    "mean_flow",
    "mean velocities by a forward-mode product (MeanFlow)",
    loss=lambda options: MeanFlow(uniform=True, prediction=options.prediction),
    sampler=lambda options, clip: samplers.JumpSampler(prediction=options.prediction),
    predictions=("velocity",),
    network=MeanVelocity,
    columns=1,
    cost=4 / 3,
)
#: A row of its own, because all stored tables of "mean_flow" predict velocities.
MEAN_FLOW_DATA = replace(
    MEAN_FLOW,
    name="mean_flow_data",
    description="as mean_flow, but the network predicts the chunk (pMF)",
    predictions=("data",),
)
SHORTCUT = replace(
    MEAN_FLOW,
    name="shortcut",
    description="shortcut model: a jump equals two of half its length",
    loss=lambda options: Shortcut(share=0.25),
    cost=7 / 6,
)
DIFFUSION = Method(
    "diffusion",
    "DDPM with 100 levels",
    loss=lambda options: samplers.diffusion_of(options.prediction).loss,
    sampler=lambda options, clip: samplers.DDPMSampler(clip=clip, prediction=options.prediction),
    predictions=diffusion.PREDICTIONS,
)


def _on_residuals(method: Method) -> Method:
    """A row with the loss and the sampler of another one, on the pairs of "residual"."""
    words = f"{method.description}, on the pairs of 'residual'"
    return replace(method, name=f"{method.name}_residual", description=words, **RESIDUAL)


_ROWS = (
    Method("independent", "flow matching, independent pairs"),
    Method("minibatch_ot", "naive minibatch OT", coupling=lambda *_: couplings.MinibatchOT()),
    Method(
        "conditional_ot",
        "flow matching, COT with a condition weight",
        coupling=_conditional,
        open_option="condition_weight",
        pictures=lambda options: options.camera.condition_clusters if options.camera else None,
    ),
    Method(
        "stratified",
        "flow matching, one assignment for each cluster of conditions and epoch",
        coupling=_stratified,
        open_option="clusters",
        pictures=lambda options: options.clusters,
    ),
    Method(
        "residual",
        "as stratified, on the residuals of a linear regression in each cluster",
        **RESIDUAL,
    ),
    Method(
        "centred",
        "as stratified, on the residuals of one regression that is trained before",
        coupling=_stratified,
        open_option="clusters",
        prepare=_centre,
    ),
    Method(
        "aligned",
        "flow matching, model-aligned pairs (MAC, weighted)",
        coupling=lambda options, _: couplings.ModelAligned(warmup_steps=options.steps // 5),
        predictions=("velocity",),
    ),
    Method(
        "reflow", "rectified flow on the pairs of a flow with independent pairs", prepare=_distil
    ),
    Method(
        "reflow_inverted",
        "as reflow, with the teacher's noise for demonstrated chunks",
        predictions=("velocity",),
        prepare=functools.partial(_distil, inverted=True),
    ),
    ADAPTIVE,
    _on_residuals(ADAPTIVE),
    MEAN_FLOW,
    _on_residuals(MEAN_FLOW),
    MEAN_FLOW_DATA,
    _on_residuals(MEAN_FLOW_DATA),
    SHORTCUT,
    _on_residuals(SHORTCUT),
    Method(
        "drifting",
        "one answer that drifts to the chunks of its stratum, and away from other answers",
        coupling=lambda _, pictures: couplings.StratifiedBatches(clusters=pictures),
        loss=lambda options: Drifting(),
        sampler=lambda options, clip: samplers.DriftSampler(),
        predictions=("data",),
        pictures=lambda options: options.clusters,
    ),
    Method(
        "two_passes",
        "regression that refines its answer once (MIP)",
        loss=lambda options: TwoPasses(),
        sampler=lambda options, clip: samplers.TwoPassSampler(),
        predictions=("data",),
        cost=2.0,
    ),
    Method(
        "behaviour_cloning",
        "regression of the chunk, mean squared error",
        loss=lambda options: regression_loss,
        sampler=lambda options, clip: samplers.MeanSampler(),
        predictions=("data",),
    ),
    DIFFUSION,
    _on_residuals(DIFFUSION),
)
METHODS: dict[str, Method] = {method.name: method for method in _ROWS}


def find_method(method: str | Method) -> Method:
    """Look up a method by name; a `Method` is returned unchanged.

    Raises:
        ValueError: there is none of this name.
    """
    if isinstance(method, Method):
        return method
    return METHODS[check_choice(method, "method", tuple(METHODS))]
