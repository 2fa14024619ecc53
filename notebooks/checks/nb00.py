"""The checks of notebook 00."""

from typing import Any

import torch

from cotlearn.course.checking import NotYet, exercise
from cotlearn.mixtures import petals

from .common import Case, Cases, call, same, table, tensor

_SELF_TEST: dict[str, tuple[Any, str]] = {
    "shape": ((256, 6), "dim=1 puts the columns side by side and keeps the rows"),
    "gradient": (12, "use the chain rule: the outer square, then the inner factor 3"),
    "best_constant": (0, "set the derivative of the mean of (x - b)^2 to zero"),
    "mean": (2, "average the two conditional means, each with its probability"),
    "euler": (0.25, "one step is x + h * (-x) with h = 1/2, and there are two"),
}


@exercise("00.self_test")
def self_test(answer: Any) -> None:
    """Five short answers in a dict; an answer that is still `...` is not attempted."""
    if not isinstance(answer, dict) or answer.keys() != _SELF_TEST.keys():
        more = set(answer) - set(_SELF_TEST) if isinstance(answer, dict) else set()
        also = f"; remove {', '.join(sorted(map(repr, more)))}" if more else ""
        raise NotYet(f"self_test must stay a dict with these keys: {', '.join(_SELF_TEST)}{also}")
    left = [name for name in _SELF_TEST if answer[name] in (None, ...)]
    if len(left) == len(_SELF_TEST):
        raise NotImplementedError
    given = {k: known for k, known in _SELF_TEST.items() if k not in left}
    wrong = [f"{k} ({hint})" for k, (x, hint) in given.items() if not same(answer[k], x, 1e-6)]
    said = [f"{len(given) - len(wrong)} of 5 right"]
    said += [f"look again at {'; '.join(wrong)}"] * bool(wrong)
    said += [f"still open: {', '.join(left)}"] * bool(left)
    if wrong or left:
        raise NotYet("; ".join(said))


@table("00.perfect_one_step")
def perfect_one_step() -> Cases:
    """The mean squared distance between the samples of a petal and its centre."""
    right = 1.44 + 2 * 0.25**2
    wrong = {
        "this is the distance of a mode; the score is a mean of squared distances": 1.2,
        "the modes are right; each of them also has a variance in both coordinates": 1.44,
        "the spread counts in both coordinates, not in one": 1.44 + 0.25**2,
        "0.25 is the standard deviation; the variance is its square": 1.44 + 2 * 0.25,
        "0.25 is the standard deviation; the variance is its square, twice": 1.44 + 0.25,
        "nearly; do not round, let Python add up the terms": lambda x: abs(x - right) < 0.05,
    }
    hint = "add the squared distance of a mode and the variance of each coordinate"
    yield Case(None, right, wrong, hint, tolerance=2.35e-3)


@exercise("00.deaf_sampler")
def deaf_sampler(answer: Any) -> None:
    """Samples of p(x1) that ignore c and depend only on the generator."""
    n = 2000
    clouds = []
    for k, seed in ((0, 7), (2, 7), (2, 8)):
        c = torch.eye(4)[k].expand(n, -1)
        x = call(answer, c, generator=torch.Generator().manual_seed(seed))
        clouds.append(tensor(x, (n, 2), f"for c of shape ({n}, 4) the result"))
    if (clouds[0].mean(dim=0) - clouds[1].mean(dim=0)).norm() > 0.5:
        raise NotYet("your samples change with c; a deaf sampler must not listen to it")
    modes = petals().components(torch.eye(4)).means.reshape(8, 2)
    share = torch.cdist(clouds[0].float(), modes).argmin(dim=1).bincount(minlength=8) / n
    if (share < 0.06).any() or abs(float(clouds[0].norm(dim=1).mean()) - 4.18) > 0.15:
        raise NotYet("draw from all four petals alike: data.sample returns x1 and its condition")
    if not torch.equal(clouds[0], clouds[1]) or torch.equal(clouds[1], clouds[2]):
        raise NotYet("pass the generator on to data.sample: its seed alone decides the samples")
