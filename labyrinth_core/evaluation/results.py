"""The results of a policy on the splits of a dataset: printed as a table, kept as JSON."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.description import Description
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.scores import Scores
from labyrinth_core.version import __version__

KIND = "labyrinth-results"
FORMAT = 2

HEADINGS = ("split", "SR", "95%", "n x n", "SPL", "known / new", "AER", "failures")
NOTE = """\
n x n: SR within as many steps as there are cells. SPL: success weighted by path length.
known / new: SR where train demonstrates an optimal route, and where it does not."""


@dataclass(frozen=True, eq=False)
class Results:
    """What a policy achieves on the splits of a dataset."""

    dataset: str
    """The folder, or the id on the Hub."""
    revision: str | None
    config: str
    fingerprint: str
    """The fingerprint of the dataset's rows, from its manifest."""
    observation: str
    """What the policy is shown: image, vector or text."""
    image_size: int | None
    """Pixels on each side of a picture; None for other observations."""
    way: str
    """`look-ups` for a policy that remembers nothing, `steps` in lock-step for any other."""
    episodes: int
    """The number of episodes in each labyrinth."""
    seed: int
    """What settles the generator that a policy may take."""
    splits: Mapping[str, Scores]
    """The scores on each split."""
    baselines: Mapping[str, Mapping[str, Mapping[str, float]]]
    """The figures of what needs no learning, by name and split; under partial observability also
    of the replanner with memory and without."""

    def __str__(self) -> str:
        """Return the figures as a table, a line for each split."""
        rows = [list(HEADINGS)]
        rows += [[split, *_cells(scores)] for split, scores in self.splits.items()]
        lines = [self._title(), *_aligned(rows), NOTE, ""]
        rows = [["SR / SPL", *(name.replace("_", " ") for name in self.baselines)]]
        for split in self.splits:
            rows.append([split, *(_pair(found[split]) for found in self.baselines.values())])
        lines += _aligned(rows)
        if REPLANNERS[0] in self.baselines:
            lines.append("replanner: planning anew after each step, with all that is out of sight")
            lines.append("taken for open; with memory, and without")
        return "\n".join(lines)

    def _title(self) -> str:
        shown = self.observation
        if self.image_size is not None:
            shown += f" of {self.image_size} x {self.image_size}"
        count = "one episode" if self.episodes == 1 else f"{self.episodes} episodes"
        return f"{self.config} of {self.dataset}: {shown}, {count} a labyrinth, by {self.way}"

    def save(
        self,
        path: str | Path,
        *,
        name: str,
        author: str = "",
        url: str = "",
        date: str = "",
        budget: str = "",
        details: Mapping[str, int] | None = None,
    ) -> None:
        """Write the results as JSON, whole or not at all.

        Each labyrinth is listed with the outcome and the moves of its episodes, from which all
        figures follow. `docs/evaluation.md` describes the format.

        Args:
            path: The file; its folder is made.
            name: What the policy is called in tables.
            author: Who made it.
            url: Where it is described, as `https://...`.
            date: When it was evaluated, as `2026-11-30`; no clock is asked.
            budget: What it has learnt from, such as "100 demonstrations of train".
            details: The same in numbers: `labyrinths` that it has learnt from, `steps` in
                environments, `parameters`; each may be left out.

        Raises:
            ValueError: The name is empty, or one of the others is none of what is allowed.
        """
        content = self.to_json(Description(name, author, url, date, budget, details or {}))
        place = Path(path).expanduser()
        place.parent.mkdir(parents=True, exist_ok=True)
        write_text(place, _as_text(content))

    def to_json(self, method: Description) -> dict[str, Any]:
        """Return what `save` writes, in plain types."""
        return {
            "kind": KIND,
            "format": FORMAT,
            "method": asdict(method),
            "dataset": {
                "source": self.dataset,
                "revision": self.revision,
                "config": self.config,
                "fingerprint": self.fingerprint,
            },
            "evaluated": {
                "observation": self.observation,
                "image_size": self.image_size,
                "way": self.way,
                "episodes": self.episodes,
                "seed": self.seed,
                "version": __version__,
            },
            "splits": {split: _described(scores) for split, scores in self.splits.items()},
            "baselines": {name: dict(found) for name, found in self.baselines.items()},
        }


def _described(scores: Scores) -> dict[str, Any]:
    """Return the figures, and what they follow from: each episode in each labyrinth."""
    outcomes = np.atleast_2d(scores.episodes.outcomes)
    return scores.figures() | {
        "labyrinth_ids": [f"{number:016x}" for number in scores.labyrinth_ids.tolist()],
        "distance": scores.distance.tolist(),
        "step_limit": scores.episodes.step_limit,
        "outcomes": ["".join(name[0] for name in row) for row in outcomes.tolist()],
        "moves": np.atleast_2d(scores.episodes.moves).tolist(),
    }


def _cells(scores: Scores) -> list[str]:
    figures = scores.figures()
    low, high = figures["sr_interval"]
    failures = (f"{count} {name}" for name, count in figures["failures"].items())
    return [
        f"{scores.sr:.1%}",
        f"{100 * low:.0f}-{100 * high:.0f}",
        _percent(scores.sr_within_cells),
        _percent(scores.spl),
        f"{_percent(scores.sr_known_route)} / {_percent(scores.sr_new_route)}",
        f"{scores.aer:.2f} ± {figures['aer_std']:.2f}",
        ", ".join(failures) or "none",
    ]


def _pair(figures: Mapping[str, float]) -> str:
    return f"{_percent(figures['sr'])} / {_percent(figures['spl'])}"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table: the first column to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        padded = (f"{text:>{width}}" for text, width in zip(others, widths[1:], strict=True))
        lines.append("  ".join([f"{first:<{widths[0]}}", *padded]))
    return lines


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{share:.1%}"


def _as_text(content: Mapping[str, Any]) -> str:
    """Return JSON with a line for each entry of the first three levels."""

    def lines(value: Any, depth: int) -> str:
        if not (isinstance(value, dict) and value and depth < 3):
            return json.dumps(value, ensure_ascii=False)
        indent = " " * (depth + 1)
        inner = (
            f"{indent}{json.dumps(key)}: {lines(each, depth + 1)}" for key, each in value.items()
        )
        return "{\n" + ",\n".join(inner) + "\n" + " " * depth + "}"

    return lines(content, 0) + "\n"
