"""The form of a results file, and the checks that it agrees with itself.

The file may come from anyone, so nothing in it is used before it is checked: first its fields and
their values, then that the outcomes are possible, and that all figures follow from them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import dataclass, fields
from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.baselines import BASELINES, REFERENCES
from labyrinth_core.evaluation.description import (
    CONTROLS,
    FRESH,
    MOST_EPISODES,
    MOST_SEED,
    Description,
    TrainedRun,
)
from labyrinth_core.evaluation.memorised import (
    COPIES,
    SPLITS_WITHOUT_TRAIN,
    Copy,
    Excess,
    Receipt,
)
from labyrinth_core.evaluation.playing import Episodes
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.schema import (
    COUNT,
    SHARE,
    Each,
    Maybe,
    Named,
    Number,
    OneOf,
    Text,
    check_shape,
)
from labyrinth_core.evaluation.scores import ACCURACIES, Scores
from labyrinth_core.language.source_text import parse_size
from labyrinth_core.pictures.observations import KINDS
from labyrinth_core.world.rules import Task

KIND = "labyrinth-results"
FORMAT = 2

_EXACT = 1e-12
"""Figures that differ by no more than this are equal; another processor may round the last of their
sixteen digits differently."""

_WORD = Text(r"\w[\w.-]{0,99}")
_TEXT = Text(r"(?s).*")
_CONFIG = Text(r"\d{1,4}x\d{1,4}(-\w{1,99})?")
_HASH = Text(r"[0-9a-f]{64}")
_LABYRINTH = Text(r"[0-7][0-9a-f]{15}")
_COUNTED = Number(1, whole=True)
_SEED = Number(0, MOST_SEED, whole=True)
_SPLIT_NAME = Text("|".join(SPLITS))

FIGURES = {
    "sr": SHARE,
    "sr_within_cells": SHARE,
    "spl": SHARE,
    "aer": Number(-1e6, 1),
    "aer_std": Number(0, 1e6),
}
"""The shape of the figures of a baseline."""

DERIVED = (
    *FIGURES,
    *("sr_known_route", "sr_new_route", "path_efficiency", "failures"),
)
"""The figures of a policy that are recomputed, whatever the file says."""

INTERVALS = {"sr_interval": "sr", "aer_interval": "aer"}
"""Interval -> its figure. Intervals are recomputed as well, but a file may have those of an earlier
version, which resampled."""

EVALUATED = {
    "observation": Text("|".join(["image", *KINDS])),
    "image_size": Maybe(_COUNTED),
    "way": Text("look-ups|steps"),
    "episodes": _COUNTED,
    "seed": _SEED,
    "version": Text(r"[\w.+-]{1,50}"),
}
"""The shape of how a policy was evaluated."""

METHOD = {each.name: _TEXT for each in fields(Description)} | {"details": Named(_TEXT, COUNT)}
"""The shape of a `Description`."""

_SHAPE = {
    "kind": KIND,
    "format": FORMAT,
    "method": METHOD,
    "dataset": {
        "source": _TEXT,
        "revision": Maybe(_TEXT),
        "config": _CONFIG,
        "fingerprint": _HASH,
    },
    "evaluated": EVALUATED,
    "splits": Named(
        _SPLIT_NAME,
        {
            **dict.fromkeys(DERIVED),
            **dict.fromkeys(INTERVALS, (Number(), Number())),
            "labyrinths": _COUNTED,
            "known_route": Text("[01]*"),
            "accuracy_on_demonstrations": Maybe(SHARE),
            "accuracy_elsewhere": Maybe(SHARE),
            "labyrinth_ids": Each(_LABYRINTH),
            "distance": Each(_COUNTED),
            "step_limit": _COUNTED,
            "outcomes": Each(Text("[slwi]*"), MOST_EPISODES),
            "moves": Each(Each(_COUNTED), MOST_EPISODES),
        },
    ),
    "baselines": Named(Text("|".join((*BASELINES, *REFERENCES, *REPLANNERS))), None),
}

TRAINING = {
    "epochs": COUNT,
    "seconds": Number(0),
    "selected": {"epoch": COUNT},
    "computed": {"device": _WORD},
}
"""The shape of how a policy was trained, in results and in the record of a run."""

RUN = {
    "method": _WORD,
    "encoder": _WORD,
    "protocol": _WORD,
    "train_labyrinths": Maybe(Number(1, whole=True, or_text=FRESH)),
    "seed": _SEED,
    "settings": Named(_WORD, None),
    "config": _CONFIG,
    "dataset": _TEXT,
    "revision": Maybe(_TEXT),
    "fingerprint": _HASH,
    "training": TRAINING,
    "evaluated": {"device": _WORD, "versions": Named(_TEXT, _TEXT), "weights": Maybe(_HASH)},
    "references_know": Maybe(_HASH),
    "as_tried": Maybe(Named(_SPLIT_NAME, Named(_WORD, Number()))),
}
"""The shape of a `TrainedRun`."""

ORIGIN = {
    "source": Text(r"(?s).{1,300}"),
    "commit": Maybe(Text(r"[0-9a-f]{40}")),
    "files": Named(_WORD, _HASH),
}
"""The shape of an `Origin`."""

JUDGEMENT = {
    "season": _WORD,
    "secret_sha256": _HASH,
    "submission": Text(r"(?s).{1,300}"),
    "commit": Maybe(Text(r"[0-9a-f]{40}")),
    "files": Named(_WORD, _HASH),
    "versions": Named(_WORD, Text(r".{1,100}")),
}
"""The shape of a `Judgement`."""


_EXCESS = {
    "excess": Number(),
    "interval": (Number(), Number()),
    "controls": (Number(), Number(0)),
    "p": SHARE,
    "most": Number(),
    "states": COUNT,
    "without_twin": COUNT,
}

_COPY = {
    "labyrinth": _LABYRINTH,
    "agent": COUNT,
    "has_key": OneOf((True, False)),
    "door_open": OneOf((True, False)),
    "train_labyrinth": _LABYRINTH,
    "twins": _COUNTED,
    "differences": COUNT,
    "passages": Each((COUNT, COUNT)),
    **dict.fromkeys(("did", "shown", "consensus"), (SHARE,) * 4),
    "optimal": (OneOf((True, False)),) * 4,
}

MEMORISED = _EXCESS | {
    "split": Text("|".join(SPLITS_WITHOUT_TRAIN)),
    "drawn": Number(*CONTROLS, whole=True),
    "shared": SHARE,
    "own_way": _EXCESS,
    "everywhere": OneOf((True, False)),
    "copies": Each(_COPY, COPIES),
}
"""The shape of a `Receipt`."""


def taken(content: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return the entries of `content` with these names; all others are left out."""
    return {name: content[name] for name in names}


def receipt_in(content: Any, splits: Container[str], cells: int) -> Receipt:
    """Return the receipt in a file, which has results on some splits of labyrinths of `cells`.

    Its figures cannot be recomputed without the policy; they are checked against one another.

    Raises:
        ValueError: Something is missing or has a value that is not allowed.
    """
    check_shape(content, MEMORISED, "it.memorised")
    parts = []
    for place in (content, content["own_way"]):
        given = taken(place, _EXCESS)
        found = Excess(**given | {name: tuple(given[name]) for name in ("interval", "controls")})
        rank = found.p * (1 + content["drawn"])
        low, high = found.interval
        if abs(rank - round(rank)) > 1e-6 or rank < 0.5:
            raise ValueError(f"it.memorised: p={found.p} is no rank among {content['drawn']}")
        if not low - 1e-3 <= found.excess <= high + 1e-3 or found.without_twin > found.states:
            raise ValueError("it.memorised: its figures contradict one another")
        parts.append(found)
    if content["split"] not in splits:
        raise ValueError(f"it.memorised.split is {content['split']}, which has no results")
    for each in content["copies"]:
        for cell in (each["agent"], *chain.from_iterable(each["passages"])):
            if cell >= cells:
                raise ValueError(f"it.memorised: a copy is in cell {cell} of {cells}")
    copies = tuple(
        Copy(
            **taken(each, _COPY)
            | {"passages": tuple(map(tuple, each["passages"]))}
            | {name: tuple(each[name]) for name in ("did", "shown", "consensus", "optimal")}
        )
        for each in content["copies"]
    )
    rest = taken(content, ("split", "drawn", "shared", "everywhere"))
    return Receipt(**vars(parts[0]), **rest, own_way=parts[1], copies=copies)


@dataclass(frozen=True)
class Rules:
    """The rules that all episodes of an evaluation obey."""

    cells: int
    """The number of cells of a labyrinth."""
    task: Task
    looks_up: bool
    """Whether the policy remembers nothing: an episode that revisits a state never ends."""
    episodes: int
    """The number of episodes in each labyrinth."""

    @property
    def states(self) -> int:
        """The largest number of states of a labyrinth: without the key, with it, and door open."""
        return self.cells * self.task.rules.phases


def rules_of(content: Any) -> Rules:
    """Return the rules for the episodes of a results file, after checking its form.

    Raises:
        ValueError: Something is missing or has a value that is not allowed.
    """
    check_shape(content, _SHAPE)
    evaluated = content["evaluated"]
    if (evaluated["observation"] == "image") != (evaluated["image_size"] is not None):
        raise ValueError(
            f"image_size={evaluated['image_size']}: observation={evaluated['observation']} has "
            f"{'one' if evaluated['observation'] == 'image' else 'none'}"
        )
    if "run" in content:
        check_shape(content["run"], RUN, "it.run")
        run = TrainedRun(**taken(content["run"], RUN))
        names = ("method.name", content["method"]["name"], run.name)
        for name, value, right in (names, ("evaluated.seed", evaluated["seed"], run.seed)):
            if value != right:
                raise ValueError(f"it.{name} is {value!r:.60}, but {right!r:.60} by it.run")
    if "judged" in content:
        check_shape(content["judged"], JUDGEMENT, "it.judged")
    if "policy" in content:
        check_shape(content["policy"], ORIGIN, "it.policy")
    config, episodes = content["dataset"]["config"], evaluated["episodes"]
    size, _, task = config.partition("-")
    height, width = parse_size(size)
    if size != f"{height}x{width}" or task not in ("", *map(str, Task)) or task == "navigation":
        raise ValueError(f"config={config}: there is no such config")
    looks_up = evaluated["way"] == "look-ups"
    if looks_up and episodes != 1:
        raise ValueError(f"episodes={episodes}: look-ups give one episode in each labyrinth")
    return Rules(height * width, Task(task or "navigation"), looks_up, episodes)


def scores_of(split: str, content: Mapping[str, Any], rules: Rules) -> Scores:
    """Return the scores that follow from the outcomes of a split in a file.

    Args:
        split: The name of the split.
        content: The split's part of the file, of the right shape.
        rules: The rules of its episodes.

    Raises:
        ValueError: An outcome is impossible, or a figure does not follow; the message names it.
    """
    refuse(split, _miscounted(content, rules.episodes))
    episodes = Episodes.of_letters(content["outcomes"], content["moves"], rules.cells)
    scores = Scores(
        episodes,
        np.array([int(each, 16) for each in content["labyrinth_ids"]], np.int64),
        np.array(content["distance"], np.int64),
        content["accuracy_on_demonstrations"],
        content["accuracy_elsewhere"],
        known_route=np.array([mark == "1" for mark in content["known_route"]]),
    )
    refuse(split, _impossible(content, scores, rules))
    refuse(split, _other_figures(content, scores))
    return scores


def refuse(split: str, problems: Iterator[str]) -> None:
    """Raise ValueError for the first problem, if any."""
    problem = next(problems, None)
    if problem is not None:
        raise ValueError(f"{split}: {problem}")


def _miscounted(content: Mapping[str, Any], episodes: int) -> Iterator[str]:
    """Yield each list of the wrong length, and a duplicate labyrinth."""
    ids = content["labyrinth_ids"]
    for name in ("outcomes", "moves"):
        if len(content[name]) != episodes:
            yield f"{name} are of {len(content[name])} episodes in each labyrinth, not {episodes}"
    parts = [(name, content[name]) for name in ("labyrinth_ids", "distance", "known_route")]
    parts += [(name, each) for name in ("outcomes", "moves") for each in content[name]]
    for name, part in parts:
        if len(part) != content["labyrinths"]:
            yield f"{name} are of {len(part)} labyrinths, not {content['labyrinths']}"
    if len(set(ids)) < len(ids):
        twice, _ = Counter(ids).most_common(1)[0]
        yield f"labyrinth {twice} is listed twice"


def _impossible(content: Mapping[str, Any], scores: Scores, rules: Rules) -> Iterator[str]:
    """Yield each outcome that is impossible for any policy."""
    episodes, distance = scores.episodes, scores.distance
    limit, moves, solved = episodes.step_limit, episodes.moves, episodes.solved
    if content["step_limit"] != limit:
        yield f"step_limit is {content['step_limit']}, not {limit}"
    iced = episodes.outcomes == "ice"
    ended, most = solved | iced, rules.states - 1
    for name in ACCURACIES:
        if content[name] is not None and not rules.looks_up:
            yield f"{name} is {content[name]}, which only look-ups can give"
    detour = moves - distance
    cases: list[tuple[NDArray[np.bool_], str]] = [
        (np.broadcast_to(distance > most, moves.shape), f"a shortest route of more than {most}"),
        (moves > limit, f"more moves than the limit of {limit}"),
        (solved & (moves < distance), "a solution of fewer moves than a shortest route"),
        (~ended & (moves != limit), f"a failure before the limit of {limit} moves"),
        (
            iced & ("ice" not in rules.task.rules.grounds),
            "an end on ice, which this task does not have",
        ),
        (ended & (moves > most) & rules.looks_up, f"more than {most} moves to an end by look-ups"),
        (solved & (detour % 2 == 1) & rules.looks_up, "a detour of an odd number of moves"),
    ]
    for wrong, what in cases:
        for episode, labyrinth in np.argwhere(wrong)[:1].tolist():
            of = f"episode {episode + 1}, " if len(episodes.moves) > 1 else ""
            yield (
                f"{of}labyrinth {scores.labyrinth_ids[labyrinth]:016x} has {what}: "
                f"{episodes.outcomes[episode, labyrinth]} after {moves[episode, labyrinth]} moves, "
                f"with a shortest route of {distance[labyrinth]}"
            )


def _other_figures(content: Mapping[str, Any], scores: Scores) -> Iterator[str]:
    """Yield each figure that does not follow from the outcomes."""
    figures = scores.figures()
    for name, right in figures.items():
        if name not in INTERVALS and not _equal(content[name], right):
            yield f"{name} is {content[name]!r:.60}, but {right} follows from the outcomes"
    for name, figure in INTERVALS.items():
        (low, high), right = content[name], figures[figure]
        if not low - _EXACT <= right <= high + _EXACT:
            yield f"{name} is {content[name]!r:.60}, but {figure} is {right}"


def _equal(one: Any, other: Any) -> bool:
    if isinstance(other, list):
        same = isinstance(one, list) and len(one) == len(other)
        return same and all(_equal(*pair) for pair in zip(one, other, strict=True))
    if type(one) in (int, float) and type(other) in (int, float):
        return bool(-1e15 < one < 1e15 and abs(one - other) <= _EXACT)
    return type(one) is type(other) and bool(one == other)
