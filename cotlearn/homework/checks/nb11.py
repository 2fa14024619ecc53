"""The checks of notebook 11."""

import torch

from cotlearn.homework.checks.common import Case, Cases, table


@table("11.place")
def place(g: torch.Generator) -> Cases:
    """The mean position under a softmax over the cells of a grid."""
    for height, width in ((4, 4), (3, 7)):
        h = 2 * torch.randn(5, height, width, generator=g)
        x, y = torch.linspace(-1, 1, width), torch.linspace(-1, 1, height)
        share = h.flatten(1).softmax(dim=1).view_as(h)
        of_all = h.flatten().softmax(dim=0).view_as(h)
        largest = h.flatten(1).argmax(dim=1)
        hard = torch.stack([x[largest % width], y[largest // width]], dim=1)
        right = _mean(share, x, y)
        cells = _mean(share, torch.arange(width).float(), torch.arange(height).float())
        wrong = {
            "y and x have changed places: columns are x, rows are y": right.flip(1),
            "that is the strongest cell; its place jumps, and nothing can be learned by it": hard,
            "these are not shares yet: softmax makes them positive with sum 1": _mean(h, x, y),
            "the shares of each grid sum to 1: softmax over its cells only": _mean(of_all, x, y),
            "count places from -1 (left, top) to 1 (right, bottom)": cells,
        }
        hint = "these are not the mean places of the softmax"
        yield Case((h,), right, wrong, hint, "the places, x and y of each grid,")


def _mean(share: torch.Tensor, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    return torch.stack([share.sum(dim=1) @ x, share.sum(dim=2) @ y], dim=1)


@table("11.components", seed=1)
def components(g: torch.Generator) -> Cases:
    """Principal components (pixels - mean) basis^T with the fitted mean."""
    pixels, mean = torch.rand(6, 20, generator=g), torch.rand(20, generator=g)
    basis = torch.linalg.qr(torch.randn(20, 3, generator=g)).Q.T.contiguous()
    centred = pixels - pixels.mean(dim=0)
    wrong = {
        "that centres by the batch's own mean, the slip of the published code: the same picture "
        "would have other components in another batch; use the fitted mean": centred @ basis.T,
        "subtract the fitted mean first": pixels @ basis.T,
        "the mean is subtracted, not added": (pixels + mean) @ basis.T,
        "pixels minus mean, not mean minus pixels": (mean - pixels) @ basis.T,
        "every pixel has its own mean: subtract the whole vector": (pixels - mean[:1]) @ basis.T,
    }
    hint = "these are not the components of the centred pixels"
    right = (pixels - mean) @ basis.T
    yield Case((pixels, mean, basis), right, wrong, hint, "the components, (n, 3),")
