"""The results of a policy on the splits of a dataset: printed as tables, saved as JSON."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, fields, replace
from math import prod
from pathlib import Path
from textwrap import fill
from typing import Any, ClassVar

import numpy as np

from labyrinth_core import typed
from labyrinth_core.data import SPLITS
from labyrinth_core.errors import DatasetError, one_line, printable_line
from labyrinth_core.evaluation.baselines import REPLANNERS, WITHOUT_LEARNING
from labyrinth_core.evaluation.description import Description, Judgement, Origin, TrainedRun
from labyrinth_core.evaluation.memorised import Receipt
from labyrinth_core.evaluation.results_form import (
    Evaluated,
    KnownDataset,
    ResultsFile,
    check_receipt,
)
from labyrinth_core.evaluation.scores import OUTCOMES, Scores, interval, over_seeds, solved_by
from labyrinth_core.language import parse_size
from labyrinth_core.listing import files_in
from labyrinth_core.storage import File, LocalFile
from labyrinth_core.version import __version__

COLUMNS = 80
"""The width of tables and legends, which fits a terminal."""

HEADINGS = ("split", "SPL", "n x n", "SR", "95%", "known", "new", "AER")
FAILURES = "Failed episodes by kind:"
BASELINES_LEGEND = "SPL/SR of baselines without learning; the optimum has 100/100:"
REPLANNER_LEGEND = """\
replanner: replans after each step and assumes that unseen passages are open;
with memory, and without."""


@dataclass(frozen=True, eq=False, repr=False)
class Results:
    """The results of a policy on the splits of a dataset."""

    FILE: ClassVar[str] = "results.json"
    """The name of the file that the stage `evaluate` writes."""
    LARGEST: ClassVar[int] = 1 << 28
    """The largest file that is read, in bytes; five splits of 100,000 labyrinths take 16 MB."""
    WITHOUT_LEARNING: ClassVar[tuple[str, ...]] = WITHOUT_LEARNING
    """The names of the baselines, in the order of the columns of tables."""
    WHY_SPL: ClassVar[str] = (
        "SPL (success weighted by path length) comes before SR (success rate), because SR rewards "
        "wandering:\nwithin 40 steps per cell even random steps solve most labyrinths."
    )
    """The sentence printed with every table of scores."""
    LEGEND: ClassVar[tuple[str, str]] = (
        fill(" ".join(WHY_SPL.split()), COLUMNS),
        "n x n: SR within as many steps as cells. 95%: the confidence interval of SR.\n"
        "known: SR where an optimal route is part of a route that train demonstrates;\n"
        "new: SR elsewhere. All in percent, except AER, the average episodic return.",
    )

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
    """`look-ups` for a policy that remembers nothing, `steps` (in lock-step) for any other."""
    episodes: int
    """The number of episodes in each labyrinth."""
    seed: int
    """The seed of the generator that a policy may take."""
    splits: Mapping[str, Scores]
    """The scores on each split."""
    baselines: Mapping[str, Mapping[str, Mapping[str, float]]]
    """The figures of the baselines, by name and split; under partial observability also those of
    the replanner with memory and without."""
    version: str = __version__
    """The version of this package that evaluated it."""
    run: TrainedRun | None = None
    """The run of `stages=train` that made the policy; None for other policies."""
    method: Description | None = None
    """The description of the policy in the file that was read; None for new results."""
    judged: Judgement | None = None
    """What the judge of a season signs; None for other results."""
    policy: Origin | None = None
    """The files of the policy if `open_policy` opened it and neither `run` nor `judged` names
    them."""
    memorised: Receipt | None = None
    """Whether the policy follows its own train; None if that was not asked."""

    def __repr__(self) -> str:
        """Return the figures as tables with a line for each split, and the legend."""
        return "\n".join([self.tables(), "", *self.legend()])

    def tables(self) -> str:
        """Return the figures as tables with a line for each split."""
        figures = [list(HEADINGS)]
        figures += [[split, *_cells(scores)] for split, scores in self.splits.items()]
        shown = self.observation
        if self.image_size is not None:
            shown += f" of {self.image_size} x {self.image_size}"
        count = "one episode" if self.episodes == 1 else f"{self.episodes} episodes"
        lines = [
            f"{self.config} of {printable_line(self.dataset)}",
            f"{shown}, {count} per labyrinth, by {self.way}",
            *_aligned(figures),
        ]
        failures = {split: each.figures()["failures"] for split, each in self.splits.items()}
        kinds = [kind for kind in OUTCOMES if any(kind in each for each in failures.values())]
        if kinds:
            rows = [["split", *kinds]]
            for split, counts in failures.items():
                rows.append([split, *(f"{counts.get(kind, 0):,}" for kind in kinds)])
            lines += ["", FAILURES, *_aligned(rows)]
        beside = {name: by_split for name, by_split in self.baselines.items() if name != "oracle"}
        if beside:
            rows = [["split", *(name.replace("_", " ") for name in beside)]]
            for split in self.splits:
                figures_of = (each[split] for each in beside.values())
                shares = (f"{100 * each['spl']:.0f}/{100 * each['sr']:.0f}" for each in figures_of)
                rows.append([split, *shares])
            lines += ["", BASELINES_LEGEND, *_aligned(rows)]
        return "\n".join(lines)

    def legend(self) -> list[str]:
        """Return what the columns of `tables` mean, in parts."""
        return [*Results.LEGEND, *[REPLANNER_LEGEND] * (REPLANNERS[0] in self.baselines)]

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

        The file lists the outcome and the moves of each episode in each labyrinth, from which all
        figures follow. `docs/evaluation.md` describes the format.

        Args:
            path: The file; its folder is created if necessary.
            name: What the policy is called in tables.
            author: Who made it.
            url: Where it is described, as `https://...`.
            date: When it was evaluated, as `2026-11-30`; not filled in automatically.
            budget: What it has learnt from, such as "100 demonstrations of train".
            details: Numbers, each optional: `labyrinths` that it has learnt from, `steps` in
                environments, `parameters`.

        Raises:
            ValueError: The name is empty, or another argument has a value that is not allowed.
        """
        text = self.to_text(Description(name, author, url, date, budget, details or {}))
        target = Path(path).expanduser()
        target.parent.mkdir(parents=True, exist_ok=True)
        File(LocalFile(target).target()).write_text(text)

    def to_text(self, about: Description) -> str:
        """Return the content of the file that `save` writes; raise ValueError like `save`."""
        text = _as_text(self.to_json(about))
        typed.read_as(ResultsFile, json.loads(text))  # Else it could not be read.
        return text

    @classmethod
    def load(
        cls, path: str | Path, datasets: Callable[[str], KnownDataset | None] | None = None
    ) -> Results:
        """Return the results in a file that `save` wrote; the file need not be trusted.

        All figures but accuracies and baselines are recomputed from the outcomes. If the dataset
        is known, labyrinths, known routes, accuracies and baselines are checked against it.

        Args:
            path: The file.
            datasets: Returns the dataset of a config, such as `5x5`; None if it is not available.
                A dataset with another fingerprint than the results is not compared.

        Raises:
            DatasetError: The file cannot be read or is inconsistent; the message has one line.
        """
        file = Path(path).expanduser()
        try:
            if not file.is_file():
                raise ValueError("it is not a file")
            if file.stat().st_size > cls.LARGEST:
                raise ValueError(f"it has more than {cls.LARGEST:,} bytes")
            return cls.from_json(File(file).read_json(), datasets)
        except (OSError, ValueError, RecursionError) as error:
            raise DatasetError(f"{file} is refused: {one_line(error):.400}") from error

    @classmethod
    def from_json(
        cls, content: Any, datasets: Callable[[str], KnownDataset | None] | None = None
    ) -> Results:
        """Return the results from the form of `to_json`; raise ValueError for anything else.

        For `datasets` see `load`.
        """
        file: ResultsFile = typed.read_as(ResultsFile, content)
        cells = prod(parse_size(file.dataset.config.partition("-")[0]))
        splits = {}
        for split, played in file.splits.items():
            with _of(split):
                splits[split] = played.scores(cells, file.evaluated.episodes)
        missing = [split for split in SPLITS.evaluated if split not in splits]
        if not splits or (file.run is not None and missing):
            raise ValueError(f"it has no results on {', '.join(missing)}")
        for name, by_split in file.baselines.items():
            if lacking := splits.keys() - by_split.keys():
                raise ValueError(f"it.baselines.{name} has no {min(lacking)}")
        if file.memorised is not None:
            check_receipt(file.memorised, splits, cells)
        results = cls(
            dataset=file.dataset.source,
            revision=file.dataset.revision,
            config=file.dataset.config,
            fingerprint=file.dataset.fingerprint,
            **vars(file.evaluated),
            splits=splits,
            baselines={
                name: {split: vars(by_split[split]) for split in splits}
                for name, by_split in file.baselines.items()
            },
            run=file.run,
            method=file.method,
            judged=file.judged,
            policy=file.policy,
            memorised=file.memorised,
        )
        known = None if datasets is None else datasets(results.config)
        if known is not None and known.fingerprint == results.fingerprint:
            results._compare_with(known)
        return results

    @classmethod
    def files_of_runs(cls, run_dir: Path) -> list[Path]:
        """Return the results files of all runs in a folder of runs, without hidden folders."""
        return sorted(run_dir.glob(f"[!.]*/[!.]*/{cls.FILE}"))

    @staticmethod
    def submitted_files(folder: Path) -> list[tuple[Path, str]]:
        """Return the results files below a folder of submissions, and why each cannot be read.

        A folder in the place of a file, or a link that leads nowhere, is returned too.
        """
        folders = [
            (path, "it is not a file") for path in folder.rglob("[!.]*.json") if path.is_dir()
        ]
        files = ((path, why) for path, why in files_in(folder) if why or path.suffix == ".json")
        return sorted([*files, *folders])

    @property
    def about(self) -> Description:
        """The description of the policy; the results have to be from a file."""
        assert self.method is not None
        return self.method

    def signed(self, **judgement: Any) -> Results:
        """Return the results as the judge of a season signs them; fields as in `Judgement`."""
        signature = Judgement(**judgement)
        return replace(
            self,
            dataset=f"season:{signature.season}",
            version=signature.versions["labyrinth-datasets"],
            judged=signature,
            policy=None,  # The signature names it.
        )

    @staticmethod
    def over_seeds(runs: Sequence[Results], split: str) -> dict[str, Any]:
        """Return the figures of results that differ only in their seed; see `scores.over_seeds`."""
        return over_seeds([each.splits[split] for each in runs])

    @staticmethod
    def gap(runs: Sequence[Results]) -> tuple[float, float, float]:
        """Return SR on train minus SR on test over seeds, and the ends of its interval."""
        train, test = (
            solved_by([each.splits[split] for each in runs]) for split in ("train", "test")
        )
        return float(train.mean() - test.mean()), *interval(train, test)

    def require_dataset(self, known: KnownDataset) -> None:
        """Raise ValueError if the results are of another dataset."""
        if self.fingerprint != known.fingerprint:
            raise ValueError(
                f"it is of another dataset than {known.name}: their fingerprints are "
                f"{self.fingerprint:.16} and {known.fingerprint:.16} (dataset= chooses another)"
            )

    def _compare_with(self, known: KnownDataset) -> None:
        """Check what follows from the dataset: labyrinths, known routes, accuracies, baselines."""
        run = self.run
        if run is not None and (run.fingerprint, run.config) != (self.fingerprint, self.config):
            raise ValueError(
                f"its policy learnt from another dataset than {known.name}, on which it is judged"
            )
        for split, scores in self.splits.items():
            right = known.split(split, None if run is None else run.first_labyrinths)
            beside = {name: by_split[split] for name, by_split in self.baselines.items()}
            with _of(split):
                right.require_same(scores, beside, blind=run is not None)

    def to_json(self, method: Description) -> dict[str, Any]:
        """Return what `save` writes, in plain types."""
        beside = {name: getattr(self, name) for name in ("run", "judged", "policy", "memorised")}
        return {
            "kind": "labyrinth-results",
            "format": 2,
            "method": asdict(method),
            "dataset": {
                "source": self.dataset,
                "revision": self.revision,
                "config": self.config,
                "fingerprint": self.fingerprint,
            },
            "evaluated": {each.name: getattr(self, each.name) for each in fields(Evaluated)},
            **{name: asdict(each) for name, each in beside.items() if each is not None},
            "splits": {split: _described(scores) for split, scores in self.splits.items()},
            "baselines": {name: dict(by_split) for name, by_split in self.baselines.items()},
        }


@contextmanager
def _of(split: str) -> Iterator[None]:
    """Name the split in the message of a ValueError."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{split}: {error}") from error


def _described(scores: Scores) -> dict[str, Any]:
    """Return the figures and the data behind them: each episode in each labyrinth."""
    return scores.figures() | {
        "labyrinth_ids": [f"{number:016x}" for number in scores.labyrinth_ids.tolist()],
        "distance": scores.distance.tolist(),
        "step_limit": scores.episodes.step_limit,
        "outcomes": scores.episodes.letters,
        "moves": np.atleast_2d(scores.episodes.moves).tolist(),
    }


def _cells(scores: Scores) -> list[str]:
    figures = scores.figures()
    low, high = figures["sr_interval"]
    shares = (scores.spl, scores.sr_within_cells, scores.sr)
    return [
        *map(_percent, shares),
        f"{100 * low:.0f}-{100 * high:.0f}",
        _percent(scores.sr_known_route),
        _percent(scores.sr_new_route),
        f"{scores.aer:.2f} ± {figures['aer_std']:.2f}",
    ]


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return the lines of a table, with the first column left-aligned and the others right-aligned.

    Columns that exceed the width `COLUMNS` continue below, beside a copy of the first column.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    blocks: list[list[int]] = [[]]
    for column in range(1, len(widths)):
        if widths[0] + sum(2 + widths[each] for each in [*blocks[-1], column]) > COLUMNS:
            blocks.append([])
        blocks[-1].append(column)
    lines: list[str] = []
    for block in blocks:
        lines += [""] * bool(lines)
        for row in rows:
            padded = (f"{row[each]:>{widths[each]}}" for each in block)
            lines.append("  ".join([f"{row[0]:<{widths[0]}}", *padded]).rstrip())
    return lines


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.1f}"


def _as_text(content: Mapping[str, Any]) -> str:
    """Return JSON with a line for each entry of the first three levels."""

    def lines(value: Any, depth: int) -> str:
        if not (isinstance(value, dict) and value and depth < 3):
            return json.dumps(value, ensure_ascii=False, allow_nan=False)
        indent = " " * (depth + 1)
        inner = (
            f"{indent}{json.dumps(key)}: {lines(each, depth + 1)}" for key, each in value.items()
        )
        return "{\n" + ",\n".join(inner) + "\n" + " " * depth + "}"

    return lines(content, 0) + "\n"
