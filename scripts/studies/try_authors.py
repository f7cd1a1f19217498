r"""Add to a run's results what its policy reaches by the rules of the trial in the authors' code.

    python scripts/studies/try_authors.py runs/3x3/sqil-cnn-seed0-authors data/labyrinth/3x3

The run is of `protocol=authors`, and its `results.json` of the stage `evaluate`. The figures are
`run.as_tried` in the file.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from labyrinth_core import Dataset, load_policy
from labyrinth_core.errors import DatasetError
from labyrinth_core.evaluation import Description, Evaluation, Results
from labyrinth_core.policies.load import RunRecord
from pipeline.machinery import Sums, leave
from pipeline.training.identity import find


def main() -> None:
    """Play the policy, add its figures and print its success rates."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("run", type=Path, help="the folder of the run")
    parser.add_argument("dataset", type=Path, help="the folder of the dataset with its config")
    asked = parser.parse_args()
    try:
        results = tried(asked.run, Dataset.at(asked.dataset))
    except DatasetError as error:
        raise SystemExit(str(error)) from error
    assert results.run is not None
    text = results.to_text(Description(results.run.name)).encode()
    leave(asked.run, {Results.FILE: text}, key=Sums.read(asked.run).key, overwrite=True)
    rates = (f"{split} {each['sr']:.0%}" for split, each in (results.run.as_tried or {}).items())
    print(f"As in the code of the authors: {', '.join(rates)}")


def tried(folder: Path, data: Dataset) -> Results:
    """Return the results of a run with the figures of its method's own trial."""
    results, record = Results.load(folder / Results.FILE), RunRecord.read(folder)
    made = record and record.content["run"]
    if made is None or results.run is None or made["protocol"] != "authors":
        raise DatasetError(f"{folder} holds no evaluated run of protocol=authors")
    method, _ = find(made["method"], made["settings"], "authors")
    policy = load_policy(folder)
    shown = Evaluation.of(policy, data, run=results.run)
    figures = {split: method.as_tried(policy, shown.load(split)) for split in results.splits}
    return replace(results, run=replace(results.run, as_tried=figures))


if __name__ == "__main__":
    main()
