"""Results that `evaluate(...).save` wrote, anybody's: what does not add up is refused.

They lie below `<results_dir>/submissions`, where those of `run_dir` are copied to.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

from labyrinth_core.data.errors import DatasetError, one_line
from labyrinth_core.data.splits import SPLITS
from labyrinth_core.data.storage import write_bytes
from labyrinth_core.evaluation.description import Description
from labyrinth_core.evaluation.results import FORMAT, KIND
from labyrinth_core.evaluation.scores import Scores
from pipeline.machinery.evaluation_file import CONFIG, FIGURES, FINGERPRINT, RESULTS
from pipeline.machinery.schema import (
    COUNT,
    Each,
    Maybe,
    Named,
    Newer,
    Number,
    Text,
    check,
    read_json,
)
from pipeline.studies.results.known import AtHand
from pipeline.studies.results.outcomes import Rules, scores_of

SUBMISSIONS = "submissions"
"""The folder of the files, below that of the tables."""

LARGEST = 4 * 1024 * 1024
"""The largest file that is read, in bytes; one of 18 splits of 100 labyrinths has 60 thousand."""

_COUNTED = Number(1, whole=True)
_TEXT = Text(r"(?s).*")

# Files of this format are new enough to have all figures.
_COMPLETE = {name: of.of if isinstance(of, Newer) else of for name, of in FIGURES.items()}
_SPLIT = _COMPLETE | {
    "aer_interval": (FIGURES["aer"], FIGURES["aer"]),
    # These are more than 1 where a labyrinth is to blame, which has to be named.
    "path_efficiency": Maybe(Number(0)),
    "spl": Number(0),
    "labyrinth_ids": Each(Text(r"[0-7][0-9a-f]{15}")),
    "distance": Each(_COUNTED),
    "step_limit": _COUNTED,
    "outcomes": Each(Text("[slwi]*")),
    "moves": Each(Each(_COUNTED)),
}

_SHAPE = {
    "kind": KIND,
    "format": FORMAT,
    "method": {
        **{each.name: _TEXT for each in fields(Description)},
        "details": Named(_TEXT, COUNT),
    },
    "dataset": {
        "source": _TEXT,
        "revision": Maybe(_TEXT),
        "config": CONFIG,
        "fingerprint": FINGERPRINT,
    },
    "evaluated": {
        "observation": Text("image|vector|text"),
        "image_size": Maybe(_COUNTED),
        "way": Text("look-ups|steps"),
        "episodes": _COUNTED,
        "seed": Number(whole=True),
        "version": Text(r"[\w.+-]{1,50}"),
    },
    "splits": Named(Text("|".join(SPLITS)), _SPLIT),
}


@dataclass(frozen=True, eq=False)
class Submission:
    """What a policy achieves, as a file tells it that adds up."""

    path: Path
    method: Description
    config: str
    fingerprint: str
    evaluated: Mapping[str, Any]
    """How it was evaluated, as `Results.save` has it."""
    scores: dict[str, Scores]
    """The scores on each split, which follow from outcome and moves of each episode."""
    compared: bool
    """Whether its labyrinths and their shortest routes are those of the dataset at hand."""


def read_submission(path: Path, at_hand: AtHand) -> Submission:
    """Return the results in a file.

    Raises:
        DatasetError: It cannot be read, or does not add up; the message says in one line where.
    """
    try:
        if not path.is_file():
            raise ValueError("it is no file")
        if path.stat().st_size > LARGEST:
            raise ValueError(f"it has more than {LARGEST:,} bytes")
        return _checked(path, read_json(path), at_hand)
    except (OSError, ValueError, RecursionError) as error:
        raise DatasetError(f"{path} is refused: {one_line(error):.400}") from error


def _checked(path: Path, content: Any, at_hand: AtHand) -> Submission:
    check(content, _SHAPE)
    about, evaluated = content["dataset"], content["evaluated"]
    method = Description(
        **{each.name: content["method"][each.name] for each in fields(Description)}
    )
    rules = Rules.of(about["config"], evaluated["way"], evaluated["episodes"])
    if not content["splits"]:
        raise ValueError("it has results on no split")
    known = at_hand(about["config"])
    if known is not None and about["fingerprint"] != known.fingerprint:
        raise ValueError(
            f"it is of another dataset than {known.place}: their fingerprints are "
            f"{about['fingerprint']:.16} and {known.fingerprint:.16} (dataset= names another one)"
        )
    return Submission(
        path=path,
        method=method,
        config=about["config"],
        fingerprint=about["fingerprint"],
        evaluated=evaluated,
        scores={
            split: scores_of(split, told, rules, known) for split, told in content["splits"].items()
        },
        compared=known is not None,
    )


def gather(run_dir: Path, results_dir: Path, at_hand: AtHand) -> list[str]:
    """Copy the results of policies to where they are kept, and return which are refused and why.

    What was kept before of one that is refused stays.
    """
    refused = []
    for path in sorted(run_dir.glob(f"*/*/{RESULTS}")):
        try:
            read_submission(path, at_hand)
        except DatasetError as error:
            refused.append(str(error))
            continue
        target = results_dir / SUBMISSIONS / path.parts[-3] / f"{path.parts[-2]}.json"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(target, path.read_bytes())
    return refused


def read_all(results_dir: Path, at_hand: AtHand) -> tuple[list[Submission], list[str]]:
    """Return the results that are kept and add up, and which are refused and why."""
    found: dict[tuple[str, str, str], Submission] = {}
    refused = []
    for path in sorted((results_dir / SUBMISSIONS).rglob("*.json")):
        try:
            each = read_submission(path, at_hand)
            other = found.setdefault((each.config, each.fingerprint, each.method.name), each)
            if other is not each:
                raise DatasetError(
                    f"{path} is refused: {other.path} has the same name, "
                    f"{each.method.name}, on the same dataset"
                )
        except DatasetError as error:
            refused.append(str(error))
    return list(found.values()), refused
