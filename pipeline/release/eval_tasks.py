"""The tasks of a dataset on the Hub: its `eval.yaml` and the results of models name them alike."""

from __future__ import annotations


def evaluation_task(config: str, split: str) -> str:
    """Return the id of the task to solve the labyrinths of a split, such as `5x5-test`."""
    return f"{config}-{split}"
