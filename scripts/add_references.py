"""Add to kept evaluations what newer versions evaluate, and nothing has to be trained again for.

    python run.py size=5 && python scripts/add_references.py docs/results --data-dir data/labyrinth

The references of `labyrinth_core.evaluation.references` and the success rates on known and on new
routes depend on the dataset and on the outcomes that a file has. Everything else that a file says
is computed again, too, and has to be the same. Evaluations on other datasets are left as they are.
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
from labyrinth_core.evaluation.references import TrainMemory
from labyrinth_core.evaluation.scores import Scores, episodes_of
from pipeline.machinery.evaluation_file import check_evaluation
from pipeline.machinery.schema import read_json
from pipeline.training.evaluate import as_text


def main() -> None:
    """Complete every evaluation on a dataset of a folder."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("results", type=Path, help="folder with runs/, such as docs/results")
    parser.add_argument("--data-dir", type=Path, required=True)
    given = parser.parse_args()
    for path in sorted(given.results.glob("runs/*/*.json")):
        content = read_json(path)
        check_evaluation(content)
        run = content["run"]
        try:
            found = Manifest.read(given.data_dir / run["config"]).fingerprint
        except DatasetError as error:
            raise SystemExit(str(error)) from error
        if found != run["fingerprint"]:
            print(f"{path}: of another dataset, left as it is")
            continue
        complete(path, content, given.data_dir)
        write_text(path, as_text(content))


def complete(path: Path, content: dict[str, Any], data_dir: Path) -> None:
    """Add to the content of an evaluation what it does not have."""
    run = content["run"]
    memory, train = memory_of(data_dir, run["config"], run.get("train_labyrinths"))
    for split, told in content["splits"].items():
        arrays = load(data_dir, run["config"], split, run.get("train_labyrinths"))
        known, references = memory.figures(arrays)
        scores = Scores(
            episodes_of(told, arrays.cells),
            arrays.labyrinth_ids,
            arrays.distance,
            told["accuracy_on_demonstrations"],
            told["accuracy_elsewhere"],
            known,
        ).to_json()
        require_same(f"{path}: {split}", told, scores)
        content["splits"][split] = scores
        baselines = compare(train, arrays) | references
        for name, figures in content["baselines"][split].items():
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
