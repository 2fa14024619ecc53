"""The checks of notebook 14."""

import numpy as np
import torch

from .common import Case, Cases, table


@table("14.look_up")
def look_up(g: torch.Generator) -> Cases:
    """The chunk of the nearest condition on file."""
    for m, n, k in ((4, 9, 3), (1, 6, 2)):
        c, seen = torch.randn(m, k, generator=g), torch.randn(n, k, generator=g)
        chunks = torch.randn(n, 5, generator=g)
        far = torch.cdist(c, seen)
        product = c @ seen.T
        of_file = far.argmin(dim=0).remainder(m)
        wrong = {
            "those are the chunks of the farthest conditions": chunks[far.argmax(dim=1)],
            "look for the nearest of the conditions on file, for each new one": chunks[of_file][:m],
            "compare conditions by distance, not by inner products": chunks[product.argmax(1)],
            "a look-up returns one chunk on file, not the mean of all": chunks.mean(0).expand(m, 5),
        }
        yield Case((c, seen, chunks), chunks[far.argmin(dim=1)], wrong, what="the chunks")


@table("14.paired_error")
def paired_error(g: torch.Generator) -> Cases:
    """The standard error over episodes of a mean difference, averaged over networks first."""
    for networks, n in ((3, 40), (2, 25)):
        easy = torch.rand(n, generator=g)
        ours, theirs = (
            (torch.rand(networks, n, generator=g) < easy).double().numpy() for _ in range(2)
        )
        apart = ours - theirs
        one = apart.mean(axis=0)
        right = one.std(ddof=1) / n**0.5
        alone = np.hypot(*(x.mean(axis=0).std(ddof=1) / n**0.5 for x in (ours, theirs)))
        wrong = {
            "take the difference in each episode first: some are hard for both methods": alone,
            "networks share their episodes: take the mean over networks first": apart.std(ddof=1)
            / apart.size**0.5,
            "that is the spread of one episode; the mean of n has a smaller error": one.std(ddof=1),
            "divide by the root of the number of episodes": one.std(ddof=1) / n,
            "that is the error over networks, not over episodes": apart.mean(axis=1).std(ddof=1)
            / networks**0.5,
            "the deviation of a sample divides by n - 1": one.std() / n**0.5,
            "that is the mean difference, not its error": one.mean(),
        }
        yield Case((ours, theirs), right, wrong)


@table("14.balance")
def balance(g: torch.Generator) -> Cases:
    """The mean over forks of the share of episodes that take the rarer way there."""
    for forks, draws in ((2, 8), (5, 12)):
        left = torch.rand(forks, draws, generator=g) < torch.linspace(0.1, 0.9, forks)[:, None]
        share = left.double().mean(dim=1)
        rarer = torch.minimum(share, 1 - share)
        pooled = torch.minimum(share.mean(), 1 - share.mean())
        wrong = {
            "a policy that always goes left at one fork and right at the next would look balanced: "
            "take the rarer way at each fork, then the mean": pooled,
            "that is the share of the more frequent way": 1 - rarer.mean(),
            "that is the share that goes left": share.mean(),
            "that is the smallest fork: take the mean over forks": rarer.min(),
        }
        yield Case((left,), rarer.mean(), wrong)
