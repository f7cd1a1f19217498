"""Add to kept evaluations what newer versions evaluate, and nothing has to be trained again for.

    python run.py size=5 && python scripts/add_references.py docs/results --data-dir data/labyrinth
    python scripts/add_references.py docs/results/goals/on_fixed --data-dir data/fixed \
        --trained-on data/varied

The references of `labyrinth_core.evaluation.references` and the success rates on known and on new
routes depend on the dataset and on the outcomes that a file has. Everything else that a file says
is computed again, too, and has to be the same. Evaluations on other datasets are left as they are.

With `--trained-on` those of `evaluate_on` are completed: their references remember the train of the
dataset that the policy has learnt from, in place of that which it is evaluated on.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from labyrinth_core.data.errors import DatasetError
from labyrinth_core.data.manifest import Manifest
from labyrinth_core.data.splits import is_of_train
from labyrinth_core.data.storage import write_text
from labyrinth_core.evaluation.baselines import compare
from labyrinth_core.evaluation.labyrinth_arrays import LabyrinthArrays, load_arrays
from labyrinth_core.evaluation.references import REFERENCES, TrainMemory
from labyrinth_core.evaluation.scores import Scores, episodes_of
from pipeline.machinery.evaluation_file import check_evaluation
from pipeline.machinery.schema import read_json
from pipeline.training.evaluate import as_text

KNOWN_ROUTES = {"known_route", "sr_known_route", "sr_new_route"}
"""What an evaluation says of routes that are remembered."""


def main() -> None:
    """Complete every evaluation on a dataset of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="folder with runs/, such as docs/results")
    parser.add_argument("--data-dir", type=Path, required=True)
    parser.add_argument("--trained-on", type=Path, help="another folder, that runs were trained on")
    given = parser.parse_args()
    for path in sorted(given.results.glob("runs/*/*.json")):
        content = read_json(path)
        check_evaluation(content)
        run, evaluated = content["run"], content["evaluated"]
        judged_on = given.data_dir / judged_config(content)
        expected = {judged_on: evaluated.get("fingerprint", run["fingerprint"])}
        if given.trained_on is not None:
            expected[given.trained_on / run["config"]] = run["fingerprint"]
        try:
            known = all(Manifest.read(place).fingerprint == expected[place] for place in expected)
        except DatasetError as error:
            raise SystemExit(str(error)) from error
        if not known:
            print(f"{path}: of another dataset, left as it is")
            continue
        complete(path, content, given.data_dir, given.trained_on)
        write_text(path, as_text(content))


def judged_config(content: Mapping[str, Any]) -> str:
    """Return the config that an evaluation is on, such as `5x5`."""
    on: str = content["evaluated"].get("on", content["run"]["config"])
    return on.rpartition("/")[2]


def complete(
    path: Path, content: dict[str, Any], data_dir: Path, trained_on: Path | None = None
) -> None:
    """Add to the content of an evaluation what it does not have.

    Args:
        path: The file of the evaluation.
        content: Its content, which is changed.
        data_dir: The folder with the dataset that it is on.
        trained_on: The folder with the dataset that references remember, if it is another one.
    """
    run = content["run"]
    place = data_dir, judged_config(content)
    some = run.get("train_labyrinths") if trained_on is None else None
    memory, train = memory_of(*place, some)
    if trained_on is not None:
        memory, _ = memory_of(trained_on, run["config"], run.get("train_labyrinths"))
        content["evaluated"]["references"] = "of the dataset that was trained on"
    for split, told in content["splits"].items():
        arrays = load(*place, split, some)
        known, references = memory.figures(arrays)
        scores = Scores(
            episodes_of(told, arrays.cells),
            arrays.labyrinth_ids,
            arrays.distance,
            told["accuracy_on_demonstrations"],
            told["accuracy_elsewhere"],
            known,
        ).to_json()
        same = told if trained_on is None else told.keys() - KNOWN_ROUTES
        require_same(f"{path}: {split}", {name: told[name] for name in same}, scores)
        content["splits"][split] = scores
        baselines = compare(train, arrays) | references
        for name, figures in content["baselines"][split].items():
            if name in REFERENCES and trained_on is not None:
                continue
            require_same(f"{path}: {name} on {split}", figures, baselines[name])
        content["baselines"][split] = baselines


@lru_cache
def load(data_dir: Path, config: str, split: str, labyrinths: int | None) -> LabyrinthArrays:
    """Return the labyrinths of a split; of those derived from train, some."""
    some = labyrinths if is_of_train(split) else None
    return load_arrays(data_dir, config, split, observation="vector", labyrinths=some)


@lru_cache
def memory_of(
    data_dir: Path, config: str, labyrinths: int | None
) -> tuple[TrainMemory, LabyrinthArrays]:
    """Return what is remembered of train, and train."""
    train = load(data_dir, config, "train", labyrinths)
    return TrainMemory.of(train), train


def require_same(place: str, told: Mapping[str, Any], found: Mapping[str, Any]) -> None:
    """End with status 1 unless what a file says is found again, up to rounding."""
    for name, value in told.items():
        numbers = np.asarray(value).dtype.kind in "if" and value is not None
        same = np.allclose(value, found[name], atol=1e-9) if numbers else value == found[name]
        if not same:
            raise SystemExit(
                f"{place}: {name} is {value!r:.60}, but follows as {found[name]!r:.60}"
            )


if __name__ == "__main__":
    main()
