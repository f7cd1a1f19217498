"""The paper's figures (supplement, Tables 3 to 5), as they are printed, and which cannot be.

Every episode that fails returns -4, so AER = SR * r + (1 - SR) * (-4), where r is the mean return
of those that succeed. It is at most that of a shortest route, and many a cell needs more.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from labyrinth_core.world.dynamics import GOAL_REWARD, STEP_LIMIT, STEP_PENALTY

METHODS = {
    "bc": "BC",
    "dagger": "DAgger",
    "gail": "GAIL",
    "bco": "BCO",
    "sqil": "SQIL",
    "iupe": "IUPE",
}
"""Those of the tables, in their order, and how they are written."""

FAILED = -STEP_LIMIT * STEP_PENALTY
"""Return of an episode that is cut."""

_HALF_A_DIGIT = 0.005
"""Of AER, as printed."""


@dataclass(frozen=True)
class PaperFigure:
    """A cell of Tables 3 to 5."""

    table: int
    size: int
    """Rows and columns of the labyrinths."""
    split: str
    method: str
    aer: float
    aer_std: float
    sr: float
    """A share, not percent."""

    @property
    def implied_return(self) -> float | None:
        """The mean return of the solved labyrinths that AER and SR imply; None if SR is 0."""
        return (self.aer - (1 - self.sr) * FAILED) / self.sr if self.sr else None

    @property
    def greatest_return(self) -> float:
        """What a solved labyrinth can return at most.

        From corner to corner of n x n cells are 2 (n - 1) moves; another start is at least n away
        from the goal or, where both are others, from each other.
        """
        moves = self.size if self.split.startswith("s0") else 2 * (self.size - 1)
        return GOAL_REWARD - (moves - 1) * STEP_PENALTY / self.size**2

    @property
    def is_possible(self) -> bool:
        """Whether some policy has this AER with this SR."""
        most = self.sr * self.greatest_return + (1 - self.sr) * FAILED
        return self.aer <= most + _HALF_A_DIGIT


@lru_cache(maxsize=1)
def paper_figures() -> dict[tuple[str, str, str], PaperFigure]:
    """Return all cells, by config such as `5x5`, split and method."""
    figures = {}
    path = Path(__file__).with_name("paper.csv")
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            figure = PaperFigure(
                table=int(row["table"]),
                size=int(row["size"].partition("x")[0]),
                split=row["split"],
                method=row["method"],
                aer=float(row["aer"]),
                aer_std=float(row["aer_std"]),
                sr=float(row["sr_percent"]) / 100,
            )
            figures[row["size"], figure.split, figure.method] = figure
    return figures
