"""What the reference lists, and which of it takes arrays."""

import fnmatch
import importlib
import inspect
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

_DOCS = Path(__file__).resolve().parents[2] / "docs"
sys.path.insert(0, str(_DOCS / "extensions"))
from modules import module_names, public_names  # noqa: E402

#: In an annotation, as it was written or as Python spells its value.
_ARRAY = re.compile(r"\b(Tensor|Arrays?|ArrayLike|NDArray|ndarray|_SupportsArray|Pairs)\b")
_FUNCTION = re.compile(r"Callable\[(\[.*?\]|\.\.\.), [^\]]*\]")  # takes arrays itself, and is none

#: Patterns of what has no case, and why.
WITHOUT = {
    "couplings.Coupling.*": "abstract: the couplings are tried",
    "couplings.FixedPairs*": "keeps pairs that were made; tests/couplings/test_reflow.py",
    "couplings.Pairs.cat": "puts pairs together, which have been checked",
    "couplings.*.match": "a part of a call, which has looked at everything",
    "couplings.*.candidates": "called by the frontier with batches of a stream",
    "diagnostics.skew.check_conditioned": "the check itself",
    "diagnostics.skew.enough_rows": "the check itself",
    "diagnostics.skew.nearest": "a part of prior_skew",
    "diagnostics.skew.unit_variance": "a part of prior_skew",
    "diagnostics.spread.local_variance": "a part of between_within",
    "couplings.*.project": "a part of labels",
    "couplings.*.weight": "a part of a call",
    "couplings.ModelAligned.errors": "a part of a call",
    "couplings.ModelAligned.row_errors": "a part of a call",
    "*.load_state_dict": "takes back what state_dict gave; tests/test_damage.py",
    "*.forward": "not a door: the inside of a network",
    "flows.*loss": "not a door: `fit` looks at its first batch",
    "flows.FlowMatching.__call__": "not a door: a loss",
    "flows.one_step.*.__call__": "not a door: a loss",
    "flows.one_step.LearnedSource.*": "not a door: a network",
    "flows.one_step.MeanVelocity.*": "not a door: a network",
    "flows.LabelDropout.__call__": "not a door: a loss",
    "flows.Guided.__call__": "not a door: a velocity, called by `integrate`",
    "flows.flow_matching_step": "not a door: the innermost line of a training loop",
    "flows.interpolate": "not a door: a line of a loss",
    "flows.diffusion.predict": "not a door: calls a network",
    "potentials.*loss": "not a door: `fit` looks at its first batch",
    "potentials.optimal_flow_matching_loss_at": "not a door: a loss",
    "potentials.*.gradient": "not a door: the inside of a network",
    "potentials.*.hessian": "not a door: the inside of a network",
    "potentials.*.value": "not a door: the formula",
    "potentials.*.given": "not a door: fills in a condition",
    "potentials.*.derivatives": "not a door: the inside of a network",
    "potentials.*.velocity": "not a door: called by `integrate`",
    "potentials.OptimalField.__call__": "not a door: a velocity, called by `integrate`",
    "potentials.ConditionalGaussian.moments": "a part of `transport`",
    "policies.samplers.*": "called by ChunkPolicy.draw, which has looked",
    "policies.policy.ChunkPolicy": "keeps what a coupling had fitted",
    "policies.policy.ChunkPolicy.draw": "a part of `chunk`, which has looked at the history",
    "policies.windows.*": "not a door: episodes and policies have checked",
    "robots.plane.*": "not a door, as the arm",
    "robots.arm.*": "not a door: environments and rollouts have checked states and actions",
    "robots.push_t.*": "not a door, as the arm",
    "robots.task.*": "records of the package's own tasks, and the check of actions itself",
    "robots.experts.*": "demonstrators see states of their own simulation only",
    "robots.episodes.Episodes.select": "numpy's own indexing",
    "robots.episodes.checked.window_rows": "indices that its two callers have checked",
    "robots.episodes.lerobot.*": "parts of the reader, which has checked the columns",
    "robots.episodes.npz.write_arrays": "stores any arrays; tests/test_damage.py",
    "policies.rollout.with_derived": "called with outcomes of the worlds",
    "policies.pixels.*": "networks and their loss: not doors; `fit` and `act` have checked c",
    "plots.*": "draws what it is given, and is no door; tests/plots",
    "storage.digest": "takes any tensors; tests/flows/test_fit.py, by `fingerprint`",
    "storage.save_tensors": "stores any tensors; tests/test_storage.py",
} | dict.fromkeys(
    (
        "mixtures.Components",
        "gaussian.AffineFlow",
        "diagnostics.FrontierPoint",
        "flows.FitResult",
        "flows.Solution",
        "potentials.Inversion",
        "report.Rows",
        "report.Trial",
        "policies.rollout.Rollouts",
        "policies.training.Trained",
    ),
    "a record that functions of the package return",
)


def public() -> dict[str, Any]:
    """Name -> what the reference lists: functions, classes, and their methods, own or inherited."""
    found: dict[str, Any] = {}
    seen: set[int] = set()
    for page in sorted((_DOCS / "reference" / "api").glob("*.md")):
        for block in re.findall(r"\.\. modules::\n\n(.*?)```", page.read_text("utf-8"), re.DOTALL):
            for name in (n for p in block.split() for n in fnmatch.filter(module_names(), p)):
                module = importlib.import_module(name)
                for key in public_names(module):
                    value = getattr(module, key)
                    if callable(value) and id(value) not in seen:
                        seen.add(id(value))
                        path = f"{name.removeprefix('cotlearn.')}.{key}"
                        found |= {path: value, **dict(_methods(path, value))}
    return found


def _methods(path: str, value: Any) -> Iterator[tuple[str, Any]]:
    if not inspect.isclass(value):
        return
    for name in dir(value):
        method = getattr(value, name)
        own = (getattr(method, "__module__", None) or "").startswith("cotlearn")
        if own and inspect.isroutine(method) and (name == "__call__" or name[0] != "_"):
            yield f"{path}.{name}", method


def that_take_arrays() -> set[str]:
    """The names of those with an argument that is an array, but protocols: they do nothing."""
    listed = public()
    protocols = {name for name, value in listed.items() if getattr(value, "_is_protocol", False)}
    return {
        name
        for name, value in listed.items()
        if _takes_arrays(value) and not {name, name.rpartition(".")[0]} & protocols
    }


def _takes_arrays(value: Callable[..., Any]) -> bool:
    try:
        arguments = inspect.signature(value).parameters.values()
    except (TypeError, ValueError):  # of some exceptions and enumerations
        return False
    return any(_ARRAY.search(_FUNCTION.sub("", str(a.annotation))) for a in arguments)
