"""The form of a results file: its fields and their allowed values."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import fields
from typing import Any

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.baselines import BASELINES, REFERENCES
from labyrinth_core.evaluation.description import (
    MOST_EPISODES,
    MOST_SEED,
    Description,
    TrainedRun,
)
from labyrinth_core.evaluation.outcomes import Rules
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.schema import (
    COUNT,
    SHARE,
    Each,
    Maybe,
    Named,
    Number,
    Text,
    check_shape,
)

KIND = "labyrinth-results"
FORMAT = 2

_WORD = Text(r"\w[\w.-]{0,99}")
_TEXT = Text(r"(?s).*")
_CONFIG = Text(r"\d{1,4}x\d{1,4}(-\w{1,99})?")
_HASH = Text(r"[0-9a-f]{64}")
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
    *("sr_known_route", "sr_new_route", "sr_interval", "aer_interval", "path_efficiency"),
    "failures",
)
"""The figures of a policy that are recomputed, whatever the file says."""

EVALUATED = {
    "observation": Text("image|vector|text"),
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
            "labyrinths": _COUNTED,
            "known_route": Text("[01]*"),
            "accuracy_on_demonstrations": Maybe(SHARE),
            "accuracy_elsewhere": Maybe(SHARE),
            "labyrinth_ids": Each(Text(r"[0-7][0-9a-f]{15}")),
            "distance": Each(_COUNTED),
            "step_limit": _COUNTED,
            "outcomes": Each(Text("[slwi]*"), MOST_EPISODES),
            "moves": Each(Each(_COUNTED), MOST_EPISODES),
        },
    ),
    "baselines": Named(Text("|".join((*BASELINES, *REFERENCES, *REPLANNERS))), None),
}

RUN = {
    "method": _WORD,
    "encoder": _WORD,
    "protocol": _WORD,
    "train_labyrinths": Maybe(_COUNTED),
    "seed": _SEED,
    "settings": Named(_WORD, None),
    "config": _CONFIG,
    "dataset": _TEXT,
    "revision": Maybe(_TEXT),
    "fingerprint": _HASH,
    "training": {
        "epochs": COUNT,
        "seconds": Number(0),
        "selected": {"epoch": COUNT},
        "computed": {"device": _WORD},
    },
    "evaluated": {"device": _WORD, "versions": Named(_TEXT, _TEXT), "weights": Maybe(_HASH)},
    "references_know": Maybe(_HASH),
    "as_tried": Maybe(Named(_SPLIT_NAME, Named(_WORD, Number()))),
}
"""The shape of a `TrainedRun`."""

JUDGEMENT = {
    "season": _WORD,
    "secret_sha256": _HASH,
    "submission": Text(r"(?s).{1,300}"),
    "commit": Maybe(Text(r"[0-9a-f]{40}")),
    "files": Named(_WORD, _HASH),
    "versions": Named(_WORD, Text(r".{1,100}")),
}
"""The shape of a `Judgement`."""


def taken(content: Mapping[str, Any], names: Iterable[str]) -> dict[str, Any]:
    """Return the entries of `content` with these names; all others are left out."""
    return {name: content[name] for name in names}


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
    return Rules.of(content["dataset"]["config"], evaluated["way"], evaluated["episodes"])
