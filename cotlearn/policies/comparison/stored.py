"""The table of a comparison that was stored, to be read by method and number of evaluations."""

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from cotlearn.assets import find_data
from cotlearn.policies.comparison.cells import COOLED
from cotlearn.results import Values

#: Samplers that stand for a method with a number of evaluations; each method has one of them.
_OWN = ("euler-{}", "ddim-{}-trailing", "jump-{}", "two-passes", "mean")


@dataclass(frozen=True)
class Comparison:
    """A stored table.

    Attributes:
        rows: by method and name of the sampler, as `summarise` writes them.
        about: the rest of the file.
    """

    rows: dict[tuple[str, str], Values]
    about: Values

    @property
    def methods(self) -> list[str]:
        """Names of the methods, in the order of the table of methods."""
        return list(dict.fromkeys(method for method, _ in self.rows))

    def at(self, method: str, nfe: int, *, cooled: bool = False) -> Values | None:
        """The row of a method with its own sampler; None if there is none.

        A flow's is Euler's method, diffusion's DDIM with trailing levels, that of mean velocities
        equal jumps; regression has one evaluation, and two passes have two.

        Args:
            method: a name in `methods`.
            nfe: evaluations of the network for a chunk.
            cooled: at the temperature that exploration starts chose.
        """
        names = (name.format(nfe) + COOLED * cooled for name in _OWN)
        found = [self.rows[method, name] for name in names if (method, name) in self.rows]
        return next((row for row in found if row["nfe"] == nfe), None)

    def table(
        self,
        *scores: str,
        methods: Iterable[str] | None = None,
        nfes: Sequence[int] = (1, 2, 16),
        cooled: bool = False,
    ) -> list[dict[str, Any]]:
        """One row for each method, to be shown by `plots.table`.

        Args:
            scores: such as "coverage", a column each for every number of evaluations.
            methods: names; all that have such a row if None.
            nfes: numbers of evaluations.
            cooled: as in `at`.
        """
        listed = []
        for method in self.methods if methods is None else methods:
            found = {nfe: self.at(method, nfe, cooled=cooled) for nfe in nfes}
            row: dict[str, Any] = {"method": method}
            for score in scores:
                word = score.removesuffix("_95")
                row |= {f"{word} {nfe}": one and one[score] for nfe, one in found.items()}
            if any(found.values()):
                listed.append(row)
        return listed

    def curves(
        self, score: str, *, methods: Iterable[str] | None = None, nfes: Sequence[int] = (1, 2, 16)
    ) -> dict[str, dict[str, dict[int, Any]]]:
        """The arguments `scores` and `intervals` of `plots.score_against_nfe`.

        Args:
            score: such as "success_95".
            methods: names; all if None.
            nfes: numbers of evaluations.
        """
        drawn: dict[str, dict[str, dict[int, Any]]] = {"scores": {}, "intervals": {}}
        for method in self.methods if methods is None else methods:
            found = {nfe: row for nfe in nfes if (row := self.at(method, nfe))}
            for key, part in (("scores", "of_seeds"), ("intervals", "interval")):
                drawn[key][method] = {nfe: row[f"{score}_{part}"] for nfe, row in found.items()}
        return drawn


def stored_comparison(name: str) -> Comparison:
    """Read a table of the folder `data/results`, such as "push_t".

    Raises:
        ValueError: there is no such file.
    """
    about = json.loads(find_data(f"results/{name}.json").read_text(encoding="utf-8"))
    rows = {(row["method"], row["sampler"]): row for row in about.pop("rows")}
    return Comparison(rows, about)
