"""The paper's figures as printed (supplement, Tables 3 to 5), and which of them are impossible.

Every episode that fails returns -4, so AER = SR * r + (1 - SR) * (-4), where r is the mean return
of the episodes that succeed. A shortest route bounds r from above, but many cells imply more.
"""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from labyrinth_core.evaluation import RunName
from labyrinth_core.world import RULES
from pipeline.machinery import plain

METHODS = {
    "bc": "BC",
    "dagger": "DAgger",
    "gail": "GAIL",
    "bco": "BCO",
    "sqil": "SQIL",
    "iupe": "IUPE",
}
"""Method -> its name in print, in the order of the paper's tables."""


def name_of(method: str) -> str:
    """Return the name of a method in Markdown."""
    return METHODS.get(method) or plain(method)


def title_of(run: RunName) -> str:
    """Return the name of a run on the leaderboard, without its seed, such as `BC, cnn`."""
    name = METHODS.get(run.method, run.method)
    return name if run.setup == run.method else f"{name}, {run.setup}"


@dataclass(frozen=True)
class PaperFigure:
    """A cell of Tables 3 to 5."""

    size: int
    """The number of rows and of columns of the labyrinths."""
    split: str
    method: str
    aer: float
    aer_std: float
    sr: float
    """A share, not percent."""

    @property
    def greatest_return(self) -> float:
        """The maximum return of a solved labyrinth.

        From corner to corner of n x n cells a route has at least 2 (n - 1) moves; from another
        start it has at least n moves.
        """
        moves = self.size if self.split.startswith("s0") else 2 * (self.size - 1)
        return RULES.goal_reward - (moves - 1) * RULES.step_penalty / self.size**2

    @property
    def is_possible(self) -> bool:
        """Whether a policy can have this AER together with this SR."""
        truncated = -RULES.step_limit * RULES.step_penalty
        most = self.sr * self.greatest_return + (1 - self.sr) * truncated
        return self.aer <= most + 0.005  # AER is printed with two digits.


@cache
def paper_figures() -> dict[tuple[str, str, str], PaperFigure]:
    """Return all cells, by config (such as `5x5`), split and method."""
    text = Path(__file__).with_name("paper.csv").read_text(encoding="utf-8")
    return {
        (row["size"], row["split"], row["method"]): PaperFigure(
            size=int(row["size"].partition("x")[0]),
            split=row["split"],
            method=row["method"],
            aer=float(row["aer"]),
            aer_std=float(row["aer_std"]),
            sr=float(row["sr_percent"]) / 100,
        )
        for row in csv.DictReader(text.splitlines())
    }
