"""eval.yaml: what makes a dataset on the Hub a benchmark, with a leaderboard for each task.

The form is that of https://huggingface.co/docs/hub/eval-results, "Registering a Benchmark". Its
field `evaluation_framework` is left out: it takes a name from a list of the Hub's, which has none
for this software, and the Hub finds fault with any other.
"""

from __future__ import annotations

from collections.abc import Sequence

import yaml

from labyrinth_core.data.manifest import Manifest
from labyrinth_core.evaluation.evaluate import NOT_EVALUATED
from pipeline.release.eval_tasks import evaluation_task

_DESCRIPTION = (
    "Grid labyrinths that tell memorising from generalising: an agent learns on the structures of "
    "train and is judged on those of test, and on shifts of both. The value of a task is the "
    "success rate (SR) in percent: the share of episodes that reach the goal within 40 steps a "
    "cell."
)


def eval_file(manifests: Sequence[Manifest], name: str) -> str:
    """Return the eval.yaml of a folder of datasets: a task for each split that is evaluated.

    Args:
        manifests: The manifests of all configs.
        name: What the benchmark is called.
    """
    tasks = [
        {"id": evaluation_task(config.name, split), "config": config.name, "split": split}
        for config in (manifest.config for manifest in manifests)
        for split in config.splits
        if split not in NOT_EVALUATED
    ]
    values = {"name": name, "description": _DESCRIPTION, "tasks": tasks}
    return yaml.safe_dump(values, sort_keys=False, allow_unicode=True, width=100)
