"""The file that the stage `evaluate` leaves in the folder of a run, and what it has to hold.

The stages `results` and `report` read it. It may come from somebody else, so nothing in it is used
before it was checked.
"""

from __future__ import annotations

from typing import Any

from labyrinth_core.data.splits import SPLITS
from labyrinth_core.evaluation.baselines import BASELINES
from labyrinth_core.evaluation.following import OUTCOMES
from labyrinth_core.evaluation.references import REFERENCES
from labyrinth_core.evaluation.replanner import REPLANNERS
from labyrinth_core.evaluation.scores import EVALUATED_SPLITS
from pipeline.machinery.schema import COUNT, SHARE, Each, Maybe, Named, Newer, Number, Text, check

EVALUATION = "evaluation.json"
"""The name of the file."""
RESULTS = "results.json"
"""The name of the file that the stage leaves of a policy that `policy=` names."""
POLICY = "policy.safetensors"
"""The name of the file of the policy that was evaluated, in the same folder."""
FORMAT = 1

CONFIG = Text(r"\d{1,4}x\d{1,4}(-\w{1,99})?")
FINGERPRINT = Text(r"[0-9a-f]{64}")

_WORD = Text(r"\w[\w.-]{0,99}")
_RETURN = Number(-1e6, 1)
_DEVIATION = Number(0, 1e6)

FIGURES = {
    "labyrinths": Number(1, whole=True),
    "sr": SHARE,
    "sr_interval": (SHARE, SHARE),
    "aer": _RETURN,
    "aer_std": _DEVIATION,
    "sr_within_cells": Newer(SHARE),
    "spl": Newer(SHARE),
    "sr_known_route": Newer(Maybe(SHARE)),
    "sr_new_route": Newer(Maybe(SHARE)),
    "known_route": Newer(Maybe(Text("[01]*"))),
    "path_efficiency": Maybe(SHARE),
    "accuracy_on_demonstrations": Maybe(SHARE),
    "accuracy_elsewhere": Maybe(SHARE),
    "failures": Named(Text("|".join(OUTCOMES)), COUNT),
}
"""The shape of the figures of a policy on a split."""

_SCORES = FIGURES | {
    "by_distance": Named(Text(r"\d{1,9}"), (COUNT, COUNT)),
    "outcomes": Text(f"[{''.join(name[0] for name in OUTCOMES)}]*"),
    "moves": Each(COUNT),
    "failed": Each(Text(r"[0-9a-f]{16}")),
}
_FIGURES = {
    "sr": SHARE,
    "sr_within_cells": Newer(SHARE),
    "spl": Newer(SHARE),
    "aer": _RETURN,
    "aer_std": _DEVIATION,
}
_BASELINES = dict.fromkeys(BASELINES, _FIGURES) | dict.fromkeys(
    (*REFERENCES, *REPLANNERS), Newer(_FIGURES)
)

_SHAPE = {
    "format": FORMAT,
    "run": {
        "method": _WORD,
        "encoder": _WORD,
        "pool_stride": Number(1, 9, whole=True),
        "protocol": _WORD,
        "precision": Newer(_WORD),
        "seed": COUNT,
        "config": CONFIG,
        "fingerprint": FINGERPRINT,
        "settings": Named(_WORD, None),
    },
    "training": {
        "epochs": COUNT,
        "seconds": Number(0),
        "selected": {"epoch": COUNT},
        "computed": {"device": _WORD},
    },
    "splits": dict.fromkeys(EVALUATED_SPLITS, _SCORES),
    "baselines": dict.fromkeys(EVALUATED_SPLITS, _BASELINES),
}


def check_evaluation(content: Any) -> None:
    """Check that the content of the file is an evaluation.

    Raises:
        ValueError: It is none; the message says why.
    """
    check(content, _SHAPE)
    names = content["baselines"]["train"].keys()
    for split, baselines in content["baselines"].items():
        if not isinstance(baselines, dict) or baselines.keys() != names:
            raise ValueError(f"it.baselines.{split!s:.60} has not the names of it.baselines.train")
    for split, scores in content["splits"].items():
        if split not in SPLITS:
            raise ValueError(f"it.splits has {split!r:.60}, which is no split")
        check(scores, _SCORES, f"it.splits.{split}")
        counted = {
            "outcomes": len(scores["outcomes"]),
            "moves": len(scores["moves"]),
            "distances": sum(count for _, count in scores["by_distance"].values()),
        }
        if scores.get("known_route") is not None:
            counted["marks of known routes"] = len(scores["known_route"])
        for name, count in counted.items():
            if count != scores["labyrinths"]:
                raise ValueError(
                    f"{split} has {scores['labyrinths']} labyrinths, but {count} {name}"
                )
