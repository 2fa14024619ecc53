"""The checks of notebook 11 and of its laboratory."""

import torch

from .common import Case, Cases, squares, table


@table("11.components", seed=1)
def components(g: torch.Generator) -> Cases:
    """Principal components (pixels - mean) basis^T with the fitted mean."""
    pixels, mean = torch.rand(6, 20, generator=g), torch.rand(20, generator=g)
    basis = torch.linalg.qr(torch.randn(20, 3, generator=g)).Q.T.contiguous()
    wrong = {
        "that centres by the batch's own mean, the slip of the published code: the same picture "
        "would have other components in another batch": (pixels - pixels.mean(dim=0)) @ basis.T,
        "subtract the fitted mean first": pixels @ basis.T,
        "the mean is subtracted, not added": (pixels + mean) @ basis.T,
        "pixels minus mean, not mean minus pixels": (mean - pixels) @ basis.T,
    }
    yield Case((pixels, mean, basis), (pixels - mean) @ basis.T, wrong, what="the components")


@table("11.inside")
def inside(g: torch.Generator) -> Cases:
    """The mean squared distance of a row from the mean of its cluster."""
    label = torch.tensor([0, 2, 70, 0, 70, 70, 70, 2, 70, 0])
    x = torch.randn(10, 2, generator=g) + 2 * (label % 3)[:, None]
    near = torch.stack([x[label == k].mean(dim=0) for k in label])
    right, whole = ((x - m).square().sum(dim=1).mean() for m in (near, x.mean(dim=0)))
    wrong = {"subtract the mean of a row's own cluster": whole}
    yield Case((label, x), right, wrong | squares(x - near))


@table("11.place")
def place(g: torch.Generator) -> Cases:
    """The mean position under a softmax over the cells of a grid."""
    h, x, y = torch.randn(5, 3, 7, generator=g), torch.linspace(-1, 1, 7), torch.linspace(-1, 1, 3)
    shares = h.flatten(1).softmax(dim=1).view_as(h), h.flatten().softmax(dim=0).view_as(h), h
    right, of_all, raw = (torch.stack([p.sum(1) @ x, p.sum(2) @ y], dim=1) for p in shares)
    wrong = {
        "y and x have changed places: columns are x, rows are y": right.flip(1),
        "these are not shares yet: softmax makes them positive with sum 1": raw,
        "the shares of each grid sum to 1: softmax over its cells only": of_all,
        "count from -1 (left, top) to 1 (right, bottom)": (right + 1) * torch.tensor([3, 1]),
    }
    yield Case((h,), right, wrong, "these are not the mean places", "the places of each grid,")


@table("11.correlation")
def correlation(g: torch.Generator) -> Cases:
    """The correlation of noise x0 with the mean chunks m of the rows that it is paired with."""
    for n, d in ((8, 3), (12, 5)):
        x0, m = torch.randn(2, n, d, generator=g) + 1
        raw, right = ((x0 * a).sum() / a.norm() / (n * d) ** 0.5 for a in (m, m - m.mean(dim=0)))
        wrong = {
            "subtract the average of m over the rows first": raw,
            "d is missing: the squared length of noise is d on average": d**0.5 * right,
            "the inner product is a sum over columns; the mean is over rows": right / d,
        }
        yield Case((x0, m), right, wrong)
